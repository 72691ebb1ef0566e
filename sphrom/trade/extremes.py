"""Stage `trade --extremes`: where models on the reference points are stable, and accurate.

Models of several sizes run at several values of each property of `AXES`. Time steps are varied at
Reynolds numbers in and out of training, the other properties at the greatest trained one. Some are
properties of the full model: a reduced model has them from the runs that it learns from. So each of
their values has full runs, bases and operators of its own, in a folder of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sphrom.case.checks import case_problems, coarser_resolution
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint, ParameterSection
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.case.studies import trained_at
from sphrom.errors import CaseError, ResourceError, UnstableError
from sphrom.metrics.histories import compare, errors_of
from sphrom.metrics.samples import Samples
from sphrom.offline import fit_psi, fom, operators, pod
from sphrom.offline import map as mapping
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.plots.canvas import save
from sphrom.plots.panels import Curve, Panel, draw_grid
from sphrom.plots.tables import format_figure, write_csv, write_json
from sphrom.reduction.reference_model import Integrator, runge_kutta
from sphrom.setup.context import StageContext
from sphrom.store.sampling import probes_of
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.candidates import (
    FOLDER,
    MOST_CLOSED_MODES,
    extreme_points,
    global_basis,
    make,
    models_of_sizes,
    prepared,
    sampled,
    with_steps,
    workspace_of,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Axis:
    """A property that is varied."""

    label: str
    """In pictures."""
    values: tuple[float, ...]
    of_full_model: tuple[str, str] | None = None
    """Section and key of a property of the full model."""


TIME_STEP, MEMORY = "time step", "memory length"
AXES = {
    TIME_STEP: Axis("step over its limit [–]", (0.25, 0.5, 0.9, 1.0, 1.1, 1.5, 2.0, 4.0)),
    MEMORY: Axis(
        "memory length over automatic [–]", (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
    ),
    "Mach number": Axis("Mach number [–]", (0.02, 0.05, 0.1, 0.2, 0.3), ("fluid", "mach_number")),
    "h/dx": Axis(
        "h/dx [–]", (1.3, 1.5, 2.0, 3.0, 4.0), ("discretization", "smoothing_length_ratio")
    ),
}
INACCURATE = 10.0
"""The velocity error from which a run counts as inaccurate [%]."""
MOST_GROWTH = 2.0
"""How far the coordinates of a run without a full one may exceed training's, to be accurate."""
FULL_UNSTABLE, REFUSED = "full unstable", "refused"
"""States of models that can't be made: a full run to learn from is unstable, or refused."""
STATES = (REFUSED, "unstable", "stable", FULL_UNSTABLE, "inaccurate")
"""In the order of colours of pictures: stable is green, unstable red, inaccurate orange."""
MARKER = 8.0
IN_A_ROW = 3


@dataclass(frozen=True, kw_only=True)
class ExtremeRow:
    """One run at the extremes."""

    parameters: str
    varied: str
    """A key of AXES."""
    value: float
    """Of the varied property; time steps over the limit, memory lengths over the automatic one."""
    n_modes: int
    projection: str
    calibrated: bool
    step_factor: float | None = None
    """Ratio of the time step to the limit of Runge-Kutta steps; None where there was no run."""
    time_step: float | None = field(default=None, metadata={"unit": "s"})
    memory_length: float | None = field(default=None, metadata={"unit": "s"})
    state: Literal["refused", "unstable", "stable", "full unstable", "inaccurate"]
    velocity_error: float | None = field(default=None, metadata={"unit": "%"})
    """None where the run was unstable, or there is no full run to compare with."""
    growth: float | None = None
    """Largest norm of the coordinates, over that of training snapshots."""
    compared_with: str = ""
    detail: str = ""
    """Why a full run was unstable, or a run refused."""


@dataclass(frozen=True)
class Beside:
    """A parameter point, and the full run there that models are compared with."""

    point: ParameterPoint
    full_run: str = ""
    """Its name; empty without one."""
    samples: Samples | None = None


def run(context: StageContext) -> None:
    """Run models at their extremes, and write a table and a map of their stability.

    Raises CaseError when the case has no reduced models, ArtifactError when the basis, its splines
    or the operators are missing.
    """
    case = context.case
    models, closed = _models(case, "galerkin"), []
    if not case.plan.driving:
        closed = [model for model in _models(case, "apg") if model.size <= MOST_CLOSED_MODES]
    workspace = prepared(context, [*models, *closed])
    points, notes = context.chosen(extreme_points(case)), []
    rows = list(_of_case(workspace, points, models, closed))
    if _top(case) in points:
        if _may_run(case):
            rows += _of_full_models(workspace, models)
        else:
            why = "a spin-up" if case.time.spin_up > 0.0 else "trade.full_runs: false"
            notes = [f"with {why}, Mach number and h/dx are not varied: they need full runs"]
    publish(workspace, rows, notes)


def _models(case: Case, projection: Literal["galerkin", "apg"]) -> list[ReducedModelSection]:
    """Return models of all sizes, calibrated where the case has such models."""
    calibrated, basis = any(model.is_calibrated for model in case.rom), global_basis(case)
    keys = {"calibrated": calibrated and "auto", "corrected": False}
    return models_of_sizes(case, projection, basis, case.plan.basis_size(basis), **keys)


def _top(case: Case) -> ParameterPoint:
    """Return where more than steps is varied: the greatest trained value."""
    return max(case.plan.bases[global_basis(case)])


def _may_run(case: Case) -> bool:
    """Whether full runs may be made that the case doesn't have."""
    return case.time.spin_up == 0.0 and case.trade.full_runs


def _of_case(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    models: Sequence[ReducedModelSection],
    closed: Sequence[ReducedModelSection],
) -> Iterator[ExtremeRow]:
    """Yield the rows of models that are made from the case's artifacts."""
    fast = [FastModel(workspace, model) for model in models]
    with workspace.context.report.progress("extremes", len(points) * len(models)) as advance:
        for point in points:
            beside = _full_run(workspace, point)
            for model in fast:
                yield from (_row(model, beside, TIME_STEP, v) for v in AXES[TIME_STEP].values)
                advance(1)
            for section in closed if point == _top(workspace.case) else ():
                automatic = FastModel(workspace, section).at(point).memory_length or 0.0
                for factor in AXES[MEMORY].values:
                    length = {"memory_length": factor * automatic}
                    model = FastModel(workspace, section.model_copy(update=length))
                    yield _row(model, beside, MEMORY, factor)


def _full_run(workspace: Workspace, point: ParameterPoint) -> Beside:
    """Return a full run to compare with: the case's, or a coarser one, where there is one."""
    case = workspace.case
    if point in case.plan.points:
        return Beside(point, "full run", sampled(workspace, point, probes_of(case)))
    if not _may_run(case):
        return Beside(point)
    # Its own step: viscosity may allow less than at the case's values.
    made = workspace_of(workspace, coarser(case, (point,), point.file_label, {}))
    return Beside(point) if make(made, made.case.name, [point]) else _beside(made, point)


def _beside(made: Workspace, point: ParameterPoint) -> Beside:
    samples = sampled(made, point, probes_of(made.case))
    return Beside(point, f"full run, {made.case.discretization.resolution} across", samples)


def _of_full_models(
    workspace: Workspace, models: Sequence[ReducedModelSection]
) -> Iterator[ExtremeRow]:
    """Yield the rows of the models of varied full models; one that fails stops nothing."""
    point, variants = _top(workspace.case), varied_models(workspace.case, models)
    with workspace.context.report.progress("other full models", len(variants)) as advance:
        for (varied, value), variant in variants.items():
            try:
                own = learnt(workspace, variant, f"{varied} {exact(value)}")
                beside = _beside(own, point)
                yield from [_row(FastModel(own, m), beside, varied, value) for m in variant.rom]
            except (UnstableError, CaseError, ResourceError) as error:
                state = FULL_UNSTABLE if isinstance(error, UnstableError) else REFUSED
                found = {"varied": varied, "value": value, "state": state, "detail": str(error)}
                yield from [_described(model, point, **found) for model in variant.rom]
            advance(1)


def varied_models(
    case: Case, models: Sequence[ReducedModelSection]
) -> dict[tuple[str, float], Case]:
    """Return the full model at every value of its properties, with reduced models to make of it.

    It learns at the trained points. Its only basis is of all of its runs.
    """
    asked = tuple(model.model_copy(update={"basis": ALL}) for model in models)
    points, found = case.plan.bases[global_basis(case)], {}
    for varied, axis in AXES.items():
        if axis.of_full_model is not None:
            section, key = axis.of_full_model
            for value in axis.values:
                changed = {section: getattr(case, section).model_copy(update={key: value})}
                variant = coarser(case, points, f"{key}-{exact(value)}", changed)
                found[varied, value] = variant.model_copy(update={"rom": asked})
    return found


def coarser(
    case: Case, points: Sequence[ParameterPoint], name: str, changed: dict[str, Any]
) -> Case:
    """Return the full model at half the resolution where the case fits that, with other sections.

    It has runs at some points and no others, one basis, and the case's snapshots.
    """
    changes: dict[str, Any] = {
        "parameters": ParameterSection(train=trained_at(case, points).parameters.train),
        "basis": case.basis.model_copy(update={"subsets": {}, "lagrangian": False}),
        "operators": case.operators.model_copy(update={"error_estimate": False}),
        "compare": case.compare.model_copy(update={"figures": ()}),
        # Sections of other studies, which ask for models that it doesn't have.
        **{name: type(getattr(case, name))() for name in ("sweep", "fit", "training")},
    }
    other = case.model_copy(update=changes | changed)
    resolution = coarser_resolution(case) or case.discretization.resolution
    variant = with_steps(other, resolution, case.time.courant_number, case.plan.steps)
    return variant.model_copy(update={"name": f"extreme-{resolution}-{name}"})


def learnt(workspace: Workspace, variant: Case, label: str) -> Workspace:
    """Make a variant's full runs and the artifacts of its reduced models; return their workspace.

    Raises UnstableError when one of its full runs is unstable, CaseError when the case can't have
    that value, ResourceError when a run would not fit this machine.
    """
    for problem in case_problems(variant):
        raise CaseError(str(problem))
    report = workspace.context.report.brief(label=label)
    wider = Workspace(replace(workspace.context, report=report, only=None))
    own = workspace_of(wider, variant)
    for stage in (fom, mapping, pod, fit_psi, operators):
        stage.run(own.context)
    return own


def _row(model: FastModel, beside: Beside, varied: str, value: float) -> ExtremeRow:
    """Run a model in its own steps, or where these are varied in steps over its limit.

    Steps over the limit are of Runge and Kutta; a whole number of them makes the run.
    """
    reduced, integrator = model.at(beside.point), None
    if varied == TIME_STEP:
        n_steps = max(1, round(reduced.output_times.duration / (value * reduced.step_limit)))
        integrator = Integrator(reduced, runge_kutta(reduced, n_steps))
    found: dict[str, Any] = {"varied": varied, "value": value, "compared_with": beside.full_run}
    found["memory_length"] = reduced.memory_length
    state = "unstable"
    try:
        run = model.run(beside.point, reduced, integrator)
    except CaseError as refused:  # Its steps are too many for any run to end.
        return _described(model.section, beside.point, **found, state=REFUSED, detail=str(refused))
    found |= {"time_step": run.time_step, "step_factor": run.time_step / reduced.step_limit}
    if run.failure is None:
        trained = np.linalg.norm(model.at_point(beside.point).states, axis=1).max()
        growth = float(np.linalg.norm(run.coordinates, axis=1).max() / trained)
        error = _velocity_error(run, beside.samples)
        found |= {"velocity_error": error, "growth": growth}
        state = state_of(error, growth)
    return _described(model.section, beside.point, **found, state=state)


def _velocity_error(run: FastRun, full: Samples | None) -> float | None:
    """Return the velocity error [%] of a run, None without a full run to compare with."""
    case = run.model.workspace.case
    if full is None:
        return None
    probes = probes_of(case)
    history = compare(run.sampled(probes.all), full, probes, case.compare.from_time)
    name = f"velocity_{case.trade.probes}_relative_l2"
    return errors_of(history)[name] if len(history.time) else None


def state_of(error: float | None, growth: float) -> str:
    """Return the state of a run from its velocity error [%], without one from its growth."""
    inaccurate = growth > MOST_GROWTH if error is None else error > INACCURATE
    return "inaccurate" if inaccurate else "stable"


def _described(model: ReducedModelSection, point: ParameterPoint, **found: Any) -> ExtremeRow:
    return ExtremeRow(
        parameters=point.label,
        n_modes=model.size,
        projection=model.projection,
        calibrated=model.is_calibrated,
        **found,
    )


def publish(workspace: Workspace, rows: Sequence[ExtremeRow], notes: Sequence[str]) -> None:
    """Write the tables and the maps of stability, and show them with some notes."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "extremes.csv", rows)
    path, name = folder / "extremes.json", workspace.case.name
    write_json(path, {"extremes": rows}, name, workspace.threads)
    save(draw_extremes(rows), folder / "extremes.png")
    for title, some in _maps(rows).items():
        cells = {(row.n_modes, row.value): _cell(row) for row in some}
        values = sorted({row.value for row in some})
        against = some[0].compared_with or f"no full run: inaccurate above {MOST_GROWTH:g} growth"
        report.table(
            f"{title} ({against}): velocity error [%] by {AXES[some[0].varied].label}, ~ where "
            f"above {format_figure(INACCURATE)} %",
            ("M", *map(exact, values)),
            [
                (str(n), *(cells[n, value] for value in values))
                for n in dict.fromkeys(row.n_modes for row in some)
            ],
        )
    failed = (f"{r.varied} {exact(r.value)}, {r.state}: {r.detail}" for r in rows if r.detail)
    for note in (*notes, *dict.fromkeys(failed)):
        report.info(note)
    report.info(f"extremes.csv, extremes.json and extremes.png are in {folder}")


def _cell(row: ExtremeRow) -> str:
    """Return the velocity error of a run, or its state alone."""
    if row.velocity_error is None:
        return row.state
    return format_figure(row.velocity_error) + (" ~" if row.state == "inaccurate" else "")


def _maps(rows: Sequence[ExtremeRow]) -> dict[str, list[ExtremeRow]]:
    """Return the rows of each map by its title."""
    maps: dict[str, list[ExtremeRow]] = {}
    for row in rows:
        maps.setdefault(f"{row.varied}, {row.parameters}", []).append(row)
    return maps


def draw_extremes(rows: Sequence[ExtremeRow]) -> Figure:
    """Draw where models are stable: the number of modes against each varied quantity."""
    panels = []
    for title, some in _maps(rows).items():
        curves = []
        for k, state in enumerate(STATES):
            places = [(row.value, row.n_modes) for row in some if row.state == state]
            values, modes = np.array(places, dtype=float).reshape(-1, 2).T
            curves.append(Curve(state, values, modes, "reference", place=k))
        label = AXES[some[0].varied].label
        panels.append(Panel(title, label, "modes M [–]", curves, "both logarithmic"))
    figure = draw_grid([panels[k : k + IN_A_ROW] for k in range(0, len(panels), IN_A_ROW)])
    for axes in figure.axes:
        for line in axes.get_lines():
            line.set(markersize=MARKER, markevery=1)
        axes.margins(0.1)
    return figure
