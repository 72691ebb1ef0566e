"""Stage `trade --extremes`: where models on the reference points are stable, and accurate.

Time steps are varied at Reynolds numbers in and out of training. At the greatest trained one the
memory length of models with the closure is varied too, and so are the full model's Mach number and
smoothing length. Both are properties of the full model: a reduced model has them from the runs that
it learns from. So each of their values has full runs, bases and operators of its own, in a folder
of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.case.checks import case_problems
from sphrom.case.messages import show_path
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.errors import CaseError, ResourceError, UnstableError
from sphrom.metrics.histories import compare, errors_of
from sphrom.metrics.samples import Probes, Samples
from sphrom.offline import fit_psi, fom, operators, pod
from sphrom.offline import map as mapping
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.plots.canvas import new_figure, save, styled
from sphrom.plots.tables import about, format_figure, write_csv, write_json
from sphrom.reduction.polynomial_model import SAFETY, Run
from sphrom.reduction.reference_model import ReferenceModel, automatic_runge_kutta, runge_kutta
from sphrom.setup.context import StageContext
from sphrom.store.sampling import probes_of
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade import models as trade_models
from sphrom.trade.models import (
    FOLDER,
    MACH,
    MOST_CLOSED_MODES,
    SMOOTHING,
    Projection,
    coarser,
    extreme_points,
    global_basis,
    models_of_sizes,
    prepared,
    projections,
    varied_models,
)
from sphrom.trade.table import Measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZES = (2, 3, 5, 8, 12, 20, 30, 50)
"""Default numbers of modes, as far as the basis has as many."""
STEP_FACTORS = (0.25, 0.5, 0.9, 1.0, 1.1, 1.5, 2.0, 4.0)
"""Time steps over the model's limit."""
MEMORY_FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Memory lengths over the automatic one."""
INACCURATE = 10.0
"""The velocity error from which a run counts as inaccurate [%]."""
MOST_GROWTH = 2.0
"""How far the coordinates of a run without a full one may exceed training's, to be accurate."""
MOST_STEPS = 1_000_000
"""Steps of a reduced run beyond which it isn't made: a closure may need ever smaller ones."""
ROUNDING = 1e-9
"""Slack for numbers of steps that are whole but for rounding."""
FULL_UNSTABLE, REFUSED = "full unstable", "refused"
"""States of models that can't be made: a full run to learn from is unstable, or refused."""
TIME_STEP, MEMORY = "time step", "memory length"
AXES = {
    TIME_STEP: "step over its limit [–]",
    MEMORY: "memory length over automatic [–]",
    MACH: "Mach number [–]",
    SMOOTHING: "h/dx [–]",
}
"""The varied properties, and their labels in pictures."""
STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    FULL_UNSTABLE: ("#999999", "×"),
    REFUSED: ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
PANEL = 3.3
"""Width and height of a map [inch]."""
IN_A_ROW = 4


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
    """Ratio of the time step to the model's limit; None where no model could be made."""
    time_step: float | None = field(default=None, metadata={"unit": "s"})
    memory_length: float | None = field(default=None, metadata={"unit": "s"})
    state: str
    """`stable`, `unstable`, `inaccurate`, `full unstable` or `refused`."""
    velocity_error: float | None = field(default=None, metadata={"unit": "%"})
    """None where the run was unstable, or there is no full run to compare with."""
    growth: float | None = None
    """Largest norm of the coordinates, over that of training snapshots."""
    compared_with: str = ""
    detail: str = ""
    """Why a full run was unstable, or a run refused."""


@dataclass(frozen=True)
class Extremes:
    """Models at one parameter point, beside the full run there."""

    point: ParameterPoint
    probes: Probes
    full_run: str = ""
    """The name of the full run that they are compared with; empty without one."""
    full_samples: Samples | None = None

    def row(
        self, model: FastModel, varied: str, value: float, factor: float | None = None
    ) -> ExtremeRow:
        """Run a model in steps over its limit, or automatic ones, and return its row."""
        reduced = model.at(self.point)
        limit, duration = reduced.step_limit, reduced.output_times.duration
        row = replace(
            _refused(model.section, self.point, varied, value),
            memory_length=reduced.memory_length,
            compared_with=self.full_run,
        )
        if duration > MOST_STEPS * (factor or SAFETY) * limit:
            detail = f"steps within {limit:.3g} s are too many"
            return replace(row, step_factor=factor, detail=detail)
        if factor is None:
            time_step = duration / automatic_runge_kutta(reduced).n_steps
        else:
            time_step = min(factor * limit, duration)
        run = FastRun(model, self.point, reduced, run_in_steps(reduced, time_step))
        error, growth = None, None
        if run.failure is None:
            growth = _largest(run.coordinates) / _largest(model.at_point(self.point).states)
            error = self._error(run)
        return replace(
            row,
            step_factor=factor or (time_step / limit if math.isfinite(limit) else None),
            time_step=time_step,
            state=state_of(error, growth),
            velocity_error=error,
            growth=growth,
        )

    def _error(self, run: FastRun) -> float | None:
        """Return the velocity error [%] of a run, None without a full run to compare with."""
        if self.full_samples is None:
            return None
        case = run.model.workspace.case
        samples, from_time = run.sampled(self.probes), case.compare.from_time
        history = compare(samples, self.full_samples, self.probes, from_time)
        # Of the fields, whatever the case measures.
        measure = Measure(case.trade.probes)
        return measure.of(errors_of(history), "velocity") if len(history.time) else None


def _refused(
    model: ReducedModelSection,
    point: ParameterPoint,
    varied: str,
    value: float,
    state: str = REFUSED,
    detail: str = "",
) -> ExtremeRow:
    """Return the row of a model at a parameter point that wasn't run."""
    return ExtremeRow(
        parameters=point.label,
        varied=varied,
        value=value,
        n_modes=model.size,
        projection=model.projection,
        calibrated=model.is_calibrated,
        state=state,
        detail=detail,
    )


def run_in_steps(reduced: ReferenceModel, time_step: float) -> Run:
    """Run in steps [s] that need not divide the run, by Eq. 2.18; return its snapshots.

    Between steps they are those of the cubic of the states and rates at both ends.
    """
    from scipy.interpolate import CubicHermiteSpline  # it takes long to load

    own = reduced.output_times
    n_steps = max(1, math.ceil(own.duration / time_step * (1.0 - ROUNDING)))
    # The last step may end after the run.
    each = replace(own, interval=time_step, n_snapshots=n_steps + 1)
    run = runge_kutta(replace(reduced, output_times=each), n_steps).run()
    if not math.isnan(run.diverged_at):
        return run
    amplitudes = np.zeros(n_steps + 1)
    if reduced.amplitude is not None:
        amplitudes = reduced.amplitude(run.time)
    rates = reduced.polynomial.along(run.coordinates, amplitudes)
    states = CubicHermiteSpline(run.time, run.coordinates, rates)(own.time)
    return replace(run, time=own.time, coordinates=states)


def _largest(coordinates: NDArray[np.float64]) -> float:
    """Return the largest norm of coordinates (n_states, n_modes)."""
    return float(np.linalg.norm(coordinates, axis=1).max())


def state_of(error: float | None, growth: float | None) -> str:
    """Return the state of a run, from its velocity error [%] where that is known, else its growth.

    A run that has no growth diverged.
    """
    if growth is None:
        return "unstable"
    inaccurate = growth > MOST_GROWTH if error is None else error > INACCURATE
    return "inaccurate" if inaccurate else "stable"


def run(context: StageContext) -> None:
    """Run models at their extremes, and write a table and a map of their stability.

    Raises
    ------
    CaseError
        When the case has no reduced models, or none with operators are listed.
    ArtifactError
        When the basis, its splines or the operators are missing.
    """
    case = context.case
    if not case.rom:
        raise CaseError("rom: the case has no reduced models, so there is nothing to weigh")
    models, closed = _models(case, "galerkin"), []
    if "apg" in projections(case) and not case.plan.driving:
        closed = [model for model in _models(case, "apg") if model.size <= MOST_CLOSED_MODES]
    workspace = prepared(context, [*models, *closed])
    points, notes = context.chosen(extreme_points(case)), []
    rows = list(_of_case(workspace, points, models, closed))
    # The only basis of a variant learns from all of its runs.
    asked = [model.model_copy(update={"basis": ALL}) for model in models]
    if _top(case) in points and (variants := varied_models(case, asked)):
        if _may_run(case):
            rows += _of_variants(workspace, variants)
        else:
            why = "a spin-up" if case.time.spin_up > 0.0 else "trade.extremes.full_runs: false"
            notes = [f"with {why}, Mach number and h/dx are not varied: they need full runs"]
    publish(workspace, rows, notes)


def _models(case: Case, projection: Projection) -> list[ReducedModelSection]:
    """Return models of all sizes, calibrated where the case has such models."""
    calibrated, basis = any(model.is_calibrated for model in case.rom), global_basis(case)
    available, keys = case.plan.basis_size(basis), {"calibrated": calibrated, "corrected": False}
    return models_of_sizes(case, projection, basis, available, SIZES, **keys)


def _top(case: Case) -> ParameterPoint:
    """Return where more than steps is varied: the greatest trained value."""
    return max(case.plan.bases[global_basis(case)], key=lambda point: point.reynolds)


def _may_run(case: Case) -> bool:
    """Whether full runs may be made that the case doesn't have."""
    return case.time.spin_up == 0.0 and case.trade.extremes.full_runs


def _of_case(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    models: Sequence[ReducedModelSection],
    closed: Sequence[ReducedModelSection],
) -> Iterator[ExtremeRow]:
    """Yield the rows of models that are made from the case's artifacts."""
    case, probes = workspace.case, probes_of(workspace.case)
    fast = [FastModel(workspace, model) for model in models]
    with workspace.context.report.progress("extremes", len(points) * len(models)) as advance:
        for point in points:
            extremes = Extremes(point, probes, *_full_run(workspace, point, probes))
            for model in fast:
                for factor in STEP_FACTORS:
                    yield extremes.row(model, TIME_STEP, factor, factor)
                advance(1)
            for section in closed if point == _top(case) else ():
                automatic = FastModel(workspace, section).at(point).memory_length
                assert automatic is not None  # The closure has one.
                for factor in MEMORY_FACTORS:
                    change = {"memory_length": factor * automatic}
                    model = FastModel(workspace, section.model_copy(update=change))
                    yield extremes.row(model, MEMORY, factor)


def _full_run(
    workspace: Workspace, point: ParameterPoint, probes: Probes
) -> tuple[str, Samples | None]:
    """Return the name and the samples of a full run to compare with: the case's, or a coarser one.

    No name and no samples where there is none.
    """
    case = workspace.case
    if point in case.plan.points:
        return "full run", trade_models.sampled(workspace, point, probes)
    if not _may_run(case):
        return "", None
    # Its own step: viscosity may allow less than at the case's values.
    variant = coarser(case, (point,), point.file_label, {})
    made = trade_models.workspace_of(workspace, variant)
    if (problem := trade_models.make(made, [point]).get(point)) is not None:
        workspace.context.report.warn(f"{variant.name}, {point.label}: {problem}")
        return "", None
    return _sampled(made, point, probes)


def _sampled(made: Workspace, point: ParameterPoint, probes: Probes) -> tuple[str, Samples]:
    """Return the name and the samples of the full run of a variant."""
    name = f"full run, {trade_models.across(made.case)}"
    return name, trade_models.sampled(made, point, probes)


def _of_variants(
    workspace: Workspace, variants: Mapping[tuple[str, float], Case]
) -> Iterator[ExtremeRow]:
    """Yield the rows of the models of varied full models; a variant that fails stops nothing."""
    point, text = _top(workspace.case), "Mach numbers and smoothing lengths"
    with workspace.context.report.progress(text, len(variants)) as advance:
        for (what, value), variant in variants.items():
            try:
                own = learnt(workspace, variant, f"{what} {exact(value)}")
                probes = probes_of(variant)
                extremes = Extremes(point, probes, *_sampled(own, point, probes))
                yield from [
                    extremes.row(FastModel(own, model), what, value) for model in variant.rom
                ]
            except (UnstableError, CaseError, ResourceError) as error:
                state = FULL_UNSTABLE if isinstance(error, UnstableError) else REFUSED
                for model in variant.rom:
                    yield _refused(model, point, what, value, state, str(error))
            advance(1)


def learnt(workspace: Workspace, variant: Case, label: str) -> Workspace:
    """Make a variant's full runs and the artifacts of its reduced models; return their workspace.

    Raises
    ------
    UnstableError
        When one of its full runs is unstable.
    CaseError
        When the case can't have that value.
    ResourceError
        When a run would not fit this machine.
    """
    if problems := case_problems(variant):
        where = show_path(problems[0].path)
        raise CaseError(f"{where}: {problems[0].reason}" if where else problems[0].reason)
    report = workspace.context.report.brief(label=label)
    wider = Workspace(replace(workspace.context, report=report, only=None))
    own = trade_models.workspace_of(wider, variant)
    for stage in (fom, mapping, pod, fit_psi, operators):
        stage.run(own.context)
    return own


def publish(workspace: Workspace, rows: Sequence[ExtremeRow], notes: Sequence[str]) -> None:
    """Write the tables and the maps of stability, and show them with some notes."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "extremes.csv", rows)
    origin = about(workspace.case.name, workspace.threads)
    write_json(folder / "extremes.json", {"extremes": rows}, origin)
    tables: dict[tuple[str, str], list[ExtremeRow]] = {}
    for row in sorted(rows, key=lambda row: list(AXES).index(row.varied)):
        tables.setdefault((row.varied, row.parameters), []).append(row)
    maps = list(map(StabilityMap, tables.values()))
    save(draw_stability(maps), folder / "extremes.png")
    for drawn in maps:
        names = dict.fromkeys(row.compared_with for row in drawn.rows if row.compared_with)
        against = f", against {', '.join(names)}" if names else ""
        cells = {(row.n_modes, row.value): cell(row) for row in drawn.rows}
        report.table(
            f"{drawn.title}{against}: velocity error [%] by {drawn.axis}, ~ where above "
            f"{format_figure(INACCURATE)} %",
            ("M", *map(exact, drawn.values)),
            [(str(n), *(cells[n, value] for value in drawn.values)) for n in drawn.n_modes],
        )
    if not all(row.compared_with or row.detail for row in rows):
        report.info(
            "where there is no full run to compare with, a stable run counts as accurate while its "
            f"coordinates stay below {MOST_GROWTH:g} times those of training"
        )
    failed = (
        f"{row.varied} {exact(row.value)}, {row.state}: {row.detail}" for row in rows if row.detail
    )
    for note in (*notes, *dict.fromkeys(failed)):
        report.info(note)
    report.info(f"extremes.csv, extremes.json and extremes.png are in {folder}")


def cell(row: ExtremeRow) -> str:
    """Return the velocity error of a run with the sign of its state, or its state alone."""
    if row.velocity_error is None:
        return row.state
    return f"{format_figure(row.velocity_error)} {STATES[row.state][1]}".strip()


class StabilityMap:
    """The runs of models by modes and the values of a varied property."""

    def __init__(self, rows: Sequence[ExtremeRow]) -> None:
        self.rows, first = rows, rows[0]
        closed = "APG, " if first.projection == "apg" else ""
        alone = " (no full run)" if first.varied == TIME_STEP and not first.compared_with else ""
        self.title = f"{closed}{first.parameters}{alone}"
        self.axis = AXES[first.varied]
        self.n_modes = sorted({row.n_modes for row in rows})
        self.values = sorted({row.value for row in rows})


def draw_stability(maps: Sequence[StabilityMap]) -> Figure:
    """Return maps of the models that are stable, and of those that are accurate."""
    from matplotlib.patches import Patch

    n_rows, n_columns = -(-len(maps) // IN_A_ROW), min(len(maps), IN_A_ROW)
    with styled():
        figure = new_figure(PANEL * n_columns, PANEL * n_rows + 0.5)
        panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
        for axes, each in zip(panels, maps, strict=False):
            _draw_map(axes, each)
        for axes in panels[len(maps) :]:
            axes.set_axis_off()
        shown = {row.state for each in maps for row in each.rows}
        handles = [
            Patch(facecolor=colour, label=f"{state} {sign}".strip())
            for state, (colour, sign) in STATES.items()
            if state in shown
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
        return figure


def _draw_map(axes: Axes, drawn: StabilityMap) -> None:
    from matplotlib.patches import Rectangle

    for row in drawn.rows:
        colour, sign = STATES[row.state]
        x, y = drawn.values.index(row.value), drawn.n_modes.index(row.n_modes)
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="white"))
        axes.text(x, y, sign, ha="center", va="center", fontsize=9.0)
    axes.set_xlim(-0.5, len(drawn.values) - 0.5)
    axes.set_ylim(-0.5, len(drawn.n_modes) - 0.5)
    axes.set_xticks(range(len(drawn.values)), [exact(v) for v in drawn.values], rotation=90)
    axes.set_yticks(range(len(drawn.n_modes)), [str(m) for m in drawn.n_modes])
    axes.set(title=drawn.title, xlabel=drawn.axis, ylabel="modes M [–]")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
