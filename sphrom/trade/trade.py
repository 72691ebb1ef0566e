"""Stage `trade`: weigh the speed of models against their accuracy.

Fast models of several sizes, and full models at other steps and resolutions, are run, timed on this
machine, and compared with the case's own full runs. The folder `trade` gets tables and a figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.case.model_sections import PROJECTIONS, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import FULL
from sphrom.compare import costs
from sphrom.errors import CaseError
from sphrom.metrics.histories import EXACT, Errors, compare, errors_of
from sphrom.metrics.measures import Samples, since, variations, without_weight
from sphrom.metrics.measures import errors_of as relative_errors
from sphrom.metrics.quantities import parts
from sphrom.metrics.series import NO_OSCILLATION
from sphrom.models.contract import Model, model_of
from sphrom.models.fom import N_TIMED_STEPS
from sphrom.models.stable_ranges import TIME, StableRange, stable_ranges
from sphrom.plots.panels import Curve, Panel, draw_grid, save
from sphrom.plots.tables import UNKNOWN, format_figure, rows_of_columns, write_csv, write_json
from sphrom.reduction.polynomial_model import EXPONENTIAL
from sphrom.setup.assembly import role_of
from sphrom.setup.context import StageContext
from sphrom.store.stored_run import probes_of
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace
from sphrom.text import counted
from sphrom.trade import weighing
from sphrom.trade.candidates import (
    FOLDER,
    PICTURE_OF_ALL,
    REDUCED,
    candidates,
    first_model,
    make_runs,
    oscillating_points,
    prepared,
    sampled,
    trade_points,
    variant_of,
    variants,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = tuple[weighing.ModelRow, list[weighing.RunRow]]

MARGIN = 0.2
"""Margin around points for their names, relative to the axes."""
APART = (0.2, 0.05)
"""Least distance between the names of points, horizontal or vertical, relative to the axes."""
RIGHT = 0.7
"""Place relative to the axes beyond which names are on the left of their points."""
ON_FRONT = "*"
"""Mark of an error that no model reaches in less time."""
HEADINGS = ("offline [s]", "online [s]", "speed-up", "break-even", "no better than")


@dataclass(frozen=True)
class Results:
    """The rows of a trade."""

    rows: Sequence[weighing.ModelRow]
    """The rows of models, with the case's own full run first."""
    without: Sequence[weighing.Alternative]
    runs: Sequence[weighing.RunRow]
    measure: weighing.Measure


def run(context: StageContext, tolerance: str | None = None) -> None:
    """Compare the models that a case lists, and write tables and a plot into the folder `trade`.

    With a tolerance, such as `1%`, the cheapest model within it is recommended.

    Raises CaseError when the case has no reduced models, or the listed ones are impossible,
    ArtifactError when a full run, the basis, its splines or the operators are missing.
    """
    allowed = None if tolerance is None else weighing.Tolerance.of_text(tolerance)
    trade = _Trade(context)
    publish(trade.workspace, trade.results(), allowed)


class _Trade:
    """Runs all models one after the other, and compares them with the case's own full runs."""

    def __init__(self, context: StageContext) -> None:
        case = context.case
        self.workspace = Workspace(context)
        self.case = case
        points = context.chosen(trade_points(case))
        self.models = candidates(case, points, first_model(case).basis)
        self.wider = prepared(context, self.models)
        self.probes = probes_of(case)
        self.measured = case.trade.measure
        self.oscillating = case.plan.oscillations.get(self.measured or "")
        if self.oscillating is not None:
            self.measured = self.oscillating.measure
            points = oscillating_points(self.wider, points, context.report)
        self.full: dict[ParameterPoint, Samples] = {}
        for point in points:
            with self.workspace.open(self.workspace.full_run(point)) as trajectory:
                require_complete(trajectory)
            self.full[point] = self._sampled(self.workspace, point)

    def _sampled(self, workspace: Workspace, point: ParameterPoint) -> Samples:
        return sampled(workspace, point, self.probes, self.measured)

    def _full_seconds(self, workspace: Workspace, step: float) -> float:
        """Return the measured time of a full run on this machine [s], with a time step [s]."""
        timer = {FULL: costs.full_run_timer(workspace, next(iter(self.full)), step)}
        return float(costs.taking_turns(timer, self.case.trade.repeats)[FULL].min())

    def results(self) -> Results:
        """Run all models, and return their rows, with the case's own full run first."""
        first = next(iter(self.full))
        step = costs.largest_step(self.case)
        with self.workspace.open(self.workspace.full_run(first)) as artifact:
            imported = costs.is_imported(artifact)
        # Only times that were measured alike are divided, so its steps are timed now, too.
        full_seconds = None if imported else self._full_seconds(self.workspace, step)
        full = weighing.ModelRow(
            model="full, as in the case",
            family="full",
            kind="full",
            resolution=self.case.discretization.resolution,
            time_step=self.case.plan.steps.time_step if imported else step,
            online_seconds=full_seconds,
            errors={**EXACT, **self._measured_errors(first, self.full[first])},
        )
        report = self.workspace.context.report
        found = [self._full(label, other) for label, other in variants(self.case).items()]
        with report.stage(REDUCED), report.progress(REDUCED, len(self.models)) as advance:
            for section in self.models:
                found.append(self._reduced(section, full_seconds))
                advance(1)

        def trained(point: ParameterPoint) -> Samples:
            return self.full.get(point) or self._sampled(self.workspace, point)

        without = list(weighing.alternatives(self.case, self.full, trained, self._errors))
        measure = weighing.Measure.of_case(self.case)
        rows = weighing.weighed([full, *(row for row, _ in found)], without, measure)
        return Results(rows, without, [run for _, runs in found for run in runs], measure)

    def _full(self, label: str, variant: Case) -> Rows:
        with self.workspace.context.report.stage(label):
            made = variant_of(self.workspace.context, variant)
            unstable = make_runs(made, label, list(self.full))
            workspace = made.workspace
            step = variant.plan.steps.time_step
            seconds = None if unstable else self._full_seconds(workspace, step)
            described = {"model": label, "role": "full", "time_step": step, "seconds": seconds}
            runs = []
            for point in self.full:
                samples = None if point in unstable else self._sampled(workspace, point)
                runs.append(self._row(point, samples, **described))
        resolution = variant.discretization.resolution
        return weighing.ModelRow.of(runs, family="full", kind="full", resolution=resolution), runs

    def _reduced(self, section: ReducedModelSection, full_seconds: float | None) -> Rows:
        """Run a reduced model at all points; return its rows."""
        fast = model_of(self.wider, section)
        family = PROJECTIONS[section.projection]
        label = f"{family}, M = {section.size}"
        listed = section
        for model in self.case.rom:
            if model.model_copy(update={"name": section.name}) == section:
                label += f" ({model.name})"
                listed = model
                break
        keys = listed.model_dump(exclude_defaults=True).items()
        runs = [self._fast(fast, label, point) for point in self.full]
        offline, training = costs.offline_seconds(
            self.wider, section, list(self.full), full_seconds
        )
        row = weighing.ModelRow.of(
            runs,
            family=family,
            keys=f"{{{', '.join(f'{key}: {value}' for key, value in keys)}}}",
            kind="operators",
            n_modes=section.n_modes,
            resolution=self.case.discretization.resolution,
            offline_seconds=offline,
            training_seconds=training,
        )
        return row, runs

    def _fast(self, fast: Model[Any], label: str, point: ParameterPoint) -> weighing.RunRow:
        measure = self.measured
        run, seconds = fast.timed(point, self.case.trade.repeats)
        samples = None
        if run.failure is None:
            samples = run.sampled(self.probes.all)
            if measure is not None:
                samples = replace(samples, measured=run.measured[measure])
        row = self._row(
            point,
            samples,
            model=label,
            role=role_of(self.case, fast.basis_at(point), point),
            time_step=run.time_step,
            seconds=None if samples is None else seconds,
        )
        if measure is None or samples is None or self.oscillating is not None:
            return row
        first = f"{measure}_{next(iter(run.measured[measure]))}"
        estimate = run.measured_shares.get(first)
        return replace(row, errors={**row.errors, weighing.ESTIMATE: estimate})

    def _row(
        self, point: ParameterPoint, samples: Samples | None, **described: Any
    ) -> weighing.RunRow:
        """Return the row of a run; without samples, it became unstable."""
        return weighing.RunRow(
            parameters=point.label,
            status="unstable" if samples is None else "complete",
            errors=weighing.UNSTABLE if samples is None else self._errors(point, samples),
            **described,
        )

    def _errors(self, point: ParameterPoint, samples: Samples) -> Errors:
        run, full = samples, self.full[point]
        if (weight := self.case.plan.weight_at(point, self.probes.all)) is not None:
            run, full = without_weight(run, full, weight)
        history = compare(run, full, self.probes, self.case.compare.from_time)
        if not len(history.time):
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: the full run is constant "
                "over the probes at all snapshots"
            )
        return {**errors_of(history), **self._measured_errors(point, samples)}

    def _measured_errors(self, point: ParameterPoint, samples: Samples) -> Errors:
        errors = dict(weighing.NO_MEASURED)
        full = self.full[point]
        if (of := self.oscillating) is not None:
            figures = of.of(samples.time, samples.measured, full.measured)
            names = {
                f"measured_{name}_relative_l2": f"{name}_error" for name in weighing.OSCILLATION
            }
            return errors | {name: figures.get(error) for name, error in names.items()}
        compared = since(full.time, self.case.compare.from_time)
        compared &= self.case.plan.counted(self.measured or "", full.time)
        for quantity, reference in full.measured.items():
            exact = reference[compared]
            sizes = variations(quantity, exact, with_weight=self.case.plan.with_weight)
            found = parts(quantity, samples.measured[quantity][compared])
            expected = parts(quantity, exact)
            for part, size in sizes.items():
                overall, peak = relative_errors(part, found[part], expected[part], size)
                name = f"measured_{part}_relative_l2"
                errors |= {name: overall, f"{name}_peak": peak}
        return errors


def publish(workspace: Workspace, results: Results, tolerance: weighing.Tolerance | None) -> None:
    """Write tables and the plot, and show the table and its conclusions."""
    report = workspace.context.report
    folder = workspace.folder(FOLDER)
    rows = results.rows
    without = results.without
    measure = results.measure
    tables: dict[str, Sequence[Any]]
    tables = {"models": rows, "runs": results.runs, "doing_nothing": without}
    for name, table in tables.items():
        write_csv(folder / f"{name}.csv", table)
    words = "`--tolerance 1%` recommends the cheapest model within 1 %"
    if tolerance is not None:
        maps = {row.model: _mapped(workspace, row) for row in rows if row.kind != "full"}
        unstable = [name for name, ranges in maps.items() if any(r.is_unstable for r in ranges)]
        possible = [row for row in rows if row.model not in unstable]
        advice, words = weighing.recommend(possible, without, tolerance, measure)
        advice["unstable_by_maps"] = ", ".join(unstable)
        if ranges := "; ".join(found.words for found in maps.get(advice["model"], ())):
            words += f". Its maps of extremes: {ranges}"
        tables["recommendation"] = rows_of_columns(dict.fromkeys(advice), [advice])
    case = workspace.case
    seconds = timed_words(case)
    write_json(
        folder / "trade.json",
        tables,
        case.name,
        workspace.threads,
        seconds=seconds,
        judged_by=measure.words,
    )
    with report.stage(PICTURE_OF_ALL):
        save(draw_trade(results), folder / "trade.png")
    report.table(
        f"speed against accuracy: {measure.words} in %, overall / at the worst time, pressure "
        f"minus its mean{'; in brackets the estimated error' if measure.measured else ''}; "
        f"{ON_FRONT} marks the Pareto front of seconds and this error; `no better than` names an "
        f"alternative that is as fast and as accurate; dt is the case's time step; {seconds}",
        (
            "model",
            "step [s]",
            *(q.replace("_", " ") for q in (*measure.quantities, *measure.parts)),
            *HEADINGS,
        ),
        [
            _cells(rows[0], measure),
            *([e.name, "", *_errors(e.errors, measure), *[""] * len(HEADINGS)] for e in without),
            *(_cells(row, measure) for row in rows[1:]),
        ],
    )
    errors = [row.errors for row in rows] + [alternative.errors for alternative in without]
    oscillates = measure.quantities == weighing.OSCILLATION
    if oscillates and None in [measure.of(found, "frequency") for found in errors]:
        report.info(f"errors are missing where a run is unstable or has {NO_OSCILLATION}")
    report.prose(words)
    report.info(f"tables, trade.json and trade.png are in {folder}")


def _mapped(workspace: Workspace, row: weighing.ModelRow) -> list[StableRange]:
    """Return the stable ranges of a model with automatic steps, from maps of the extremes."""
    maps = (r for r in stable_ranges(workspace) if (r.kind, r.steps) == ("fast", EXPONENTIAL))
    varied = (*workspace.case.plan.parameter_names, TIME)
    return [
        r
        for r in maps
        if (PROJECTIONS[r.projection], r.n_modes) == (row.family, row.n_modes)
        and r.varied in varied
    ]


def timed_words(case: Case) -> str:
    """Describe the measurement of the seconds of a run."""
    spin_up = "; the spin-up counts only as offline time of training runs"
    return (
        f"online is the time of a run of {case.plan.recorded_time:g} s on one thread, without "
        f"reading and writing, the least of {counted(case.trade.repeats, 'time')}; full runs are "
        f"timed over {N_TIMED_STEPS} steps, and the case's own has its largest stable step"
        f"{spin_up if case.time.spin_up > 0.0 else ''}"
    )


def _cells(row: weighing.ModelRow, measure: weighing.Measure) -> list[str]:
    offline = pays = ""
    if row.kind != "full":
        offline = _known(row.offline_seconds)
        pays = "never" if row.break_even_runs is None else counted(row.break_even_runs, "run")
        if row.offline_seconds is None or row.speed_up is None:
            pays = UNKNOWN
    gains = ["unstable", "", "", ""]
    if row.stable:
        gains = [_known(row.online_seconds), _known(row.speed_up), pays, row.beaten_by or ""]
    errors = _errors(row.errors, measure, row)
    return [row.model, format_figure(row.time_step), *errors, offline, *gains]


def _errors(
    errors: Errors, measure: weighing.Measure, row: weighing.ModelRow | None = None
) -> list[str]:
    """Return the compared errors, overall / at the worst time, with a mark on the Pareto front."""
    cells = []
    for quantity in (*measure.quantities, *measure.parts):
        pair = (measure.of(errors, quantity, peak=peak) for peak in (False, True))
        fronts = {} if row is None or quantity in measure.parts else row.fronts
        mark = ON_FRONT if fronts.get(weighing.FRONTS.get(quantity, "")) else " "
        cells.append(" / ".join(map(format_figure, pair)) + mark)
    if (estimate := errors[weighing.ESTIMATE]) is not None:
        cells[0] += f" ({format_figure(estimate)})"
    return cells


def _known(figure: float | None) -> str:
    return UNKNOWN if figure is None else format_figure(figure)


def draw_trade(results: Results) -> Figure:
    """Draw errors over seconds of a run with their Pareto fronts, one panel per quantity.

    It shows the stable models except the reference run, and the alternatives without a model.
    Points of a front are named, starting from the last one, where names do not overlap.
    """
    quantities = results.measure.quantities
    panels = [_panel(results, quantity) for quantity in quantities]
    figure = draw_grid([panels], title=results.measure.words)
    for axes, quantity in zip(figure.axes, quantities, strict=True):
        shares = axes.transScale + axes.transLimits
        last = np.full(2, np.inf)
        for seconds, error, row in _front(results, quantity)[::-1]:
            at = shares.transform((seconds, error))
            if (np.abs(at - last) > APART).any():
                last = at
                name = row.model.removeprefix(f"{row.family}, ")
                where: Any = {"textcoords": "offset points", "fontsize": 7.5}
                # The name stays legible on lines.
                where["bbox"] = {"color": "white", "alpha": 0.8, "pad": 0.5}
                way, side = (-1, "right") if at[0] > RIGHT else (1, "left")
                axes.annotate(name, (seconds, error), (4 * way, 4), ha=side, **where)
    return figure


def _panel(results: Results, quantity: str) -> Panel:
    marks = _marks(results, quantity)
    full_seconds = results.rows[0].online_seconds
    curves = []
    for k, family in enumerate(dict.fromkeys(row.family for row in results.rows[1:])):
        of_family = [mark[:2] for mark in marks if mark[2].family == family]
        x, y = np.array(of_family, dtype=float).reshape(-1, 2).T
        curves.append(Curve(family, x, y, "reference", place=k))
    if front := _front(results, quantity):
        # The front is drawn in steps, because no model lies between two of its points.
        x, y = np.array([mark[:2] for mark in front]).T
        curves.append(Curve("Pareto front", np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], "level"))
    seconds = [mark[0] for mark in marks] + [full_seconds or 1.0]
    for alternative in results.without:
        error = np.full(2, results.measure.of(alternative.errors, quantity) or np.nan)
        ends = np.array([min(seconds), max(seconds)])
        curves.append(Curve(alternative.name, ends, error, "level"))
    if full_seconds is not None and marks:
        errors = [mark[1] for mark in marks]
        ends = np.array([min(errors), max(errors)])
        curves.append(Curve("the case's full run", np.full(2, full_seconds), ends, "full"))
    label = f"{quantity.replace('_', ' ')}, error [%]"
    # A quantity that is only noise has no errors, and a logarithmic axis needs some.
    has_errors = any(np.isfinite(curve.y).any() for curve in curves)
    scales: Any = "both logarithmic" if has_errors else "linear"
    return Panel("", "time of a run [s]", label, curves, scales, margin=MARGIN)


Mark = tuple[float, float, weighing.ModelRow]
"""Seconds, error and row of a model."""


def _marks(results: Results, quantity: str) -> list[Mark]:
    """Return seconds, error and row of the stable models with an error above zero."""
    return [
        (row.online_seconds, error, row)
        for row in results.rows[1:]
        if row.online_seconds is not None and (error := results.measure.of(row.errors, quantity))
    ]


def _front(results: Results, quantity: str) -> list[Mark]:
    name = weighing.FRONTS[quantity]
    on_front = [mark for mark in _marks(results, quantity) if mark[2].fronts[name]]
    return sorted(on_front, key=lambda mark: mark[:2])
