"""Stage `trade`: models weighed against each other, their errors against their cost."""

from __future__ import annotations

from functools import partial

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.costs import is_imported, known_seconds, offline_seconds
from sphrom.errors import CaseError
from sphrom.metrics.effectivity import effectivity
from sphrom.metrics.histories import EXACT, Errors, compare, errors_of
from sphrom.metrics.measures import quantity_errors
from sphrom.metrics.samples import Samples
from sphrom.reduction.error_calibration import LEFT_OUT
from sphrom.setup.context import StageContext
from sphrom.setup.places import places_of, role_of
from sphrom.store.sampling import probes_of
from sphrom.store.targets import Target
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace
from sphrom.trade import full as trade_full
from sphrom.trade import report as trade_report
from sphrom.trade.advice import parse_tolerance
from sphrom.trade.candidates import Candidate, candidates, trade_points
from sphrom.trade.full import Variant
from sphrom.trade.journal import Journal, Rows
from sphrom.trade.models import prepared
from sphrom.trade.nothing import nothing_rows
from sphrom.trade.runs import Outcome, ReducedRuns
from sphrom.trade.table import (
    ESTIMATES,
    NO_ESTIMATES,
    NO_MEASURED,
    Measure,
    ModelRow,
    RunRow,
    model_row,
    run_row,
    with_beaten,
    with_fronts,
    with_gains,
)


def run(context: StageContext, tolerance: str | None = None) -> None:
    """Weigh the models that a case lists, and write tables and a plot into its folder `trade`.

    With the errors allowed, such as `1%`, the cheapest model within them is named.

    Raises
    ------
    CaseError
        When the case has no reduced models, or can't have the listed ones.
    ArtifactError
        When a full run, the basis, its splines or the operators are missing.
    """
    allowed = None if tolerance is None else parse_tolerance(tolerance)
    if not context.case.rom:
        raise CaseError("rom: the case has no reduced models, so there is nothing to weigh")
    trade = _Trade(context)
    trade_report.publish(trade.workspace, trade.results(), allowed)
    trade.journal.remove()


class _Trade:
    """All models, run one after the other and compared with the case's own full runs."""

    def __init__(self, context: StageContext) -> None:
        self.workspace = Workspace(context)
        self.case = context.case
        points = context.chosen(trade_points(self.case))
        self.listed = candidates(self.case, points)
        self.workspaces = self._prepared(context)
        self.probes = probes_of(self.case)
        self.full = {point: self._own_samples(point) for point in points}
        self.journal = Journal(self.workspace, trade_report.FOLDER, self._made_from())

    def _made_from(self) -> list[tuple[Workspace, Target]]:
        """Return the artifacts that the rows depend on."""
        full = [(self.workspace, self.workspace.full_run(point)) for point in self.full]
        bases = [(each, each.basis()) for each in self.workspaces.values()]
        return full + bases + [(each, each.splines()) for each in self.workspaces.values()]

    def _prepared(self, context: StageContext) -> dict[str, Workspace]:
        """Return workspaces that reduced models can be made from, by inner product."""
        models: dict[str, dict[str, ReducedModelSection]] = {}
        for model, method in ((each.model, each.method) for each in self.listed):
            models.setdefault(method.inner_product, {})[model.name] = model
        return {
            inner_product: prepared(context, inner_product, [*some.values()])
            for inner_product, some in models.items()
        }

    def _own_samples(self, point: ParameterPoint) -> Samples:
        with self.workspace.open(self.workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
        return trade_full.sampled(self.workspace, point, self.probes, self.case.trade.measure)

    def _full_seconds(self, workspace: Workspace) -> float:
        """Time some steps of the full model; the cost of a step doesn't depend on parameters."""
        return trade_full.seconds_of_run(workspace, next(iter(self.full)), self.case.trade.repeats)

    def _own_seconds(self) -> float | None:
        """Return how long the case's own full run takes [s], None where that is unknown."""
        with self.workspace.open(self.workspace.full_run(next(iter(self.full)))) as run:
            if is_imported(run):
                return known_seconds(run)
        return self.journal.seconds("own", lambda: self._full_seconds(self.workspace))

    def results(self) -> trade_report.Results:
        """Run everything, and return the rows of all models, the case's own full run first."""
        own_seconds = self._own_seconds()
        own = self._own(own_seconds)
        full = [
            self.journal.rows(variant.label, partial(self._full, variant))
            for variant in trade_full.variants(self.case)
        ]
        each = [*full, *self._reduced()]
        known = self.full, self.case.train_points, self._sampled, self._errors
        nothing = list(nothing_rows(*known, partial(places_of, self.case)))
        measure = Measure.of_case(self.case)
        rows = with_gains([own, *(row for row, _ in each)], own_seconds)
        rows = with_fronts(with_beaten(rows, nothing, measure), measure)
        runs = [run for _, runs in each for run in runs]
        return trade_report.Results(rows, nothing, runs, measure, own_seconds)

    def _own(self, seconds: float | None) -> ModelRow:
        first = next(iter(self.full))
        return ModelRow(
            model="full, as in the case",
            family="full",
            kind="full",
            resolution=self.case.discretization.resolution,
            time_step=trade_full.own_run(self.case).time_step,
            online_seconds=seconds,
            errors={**EXACT, **self._measured_errors(first, self.full[first])},
        )

    def _full(self, variant: Variant) -> Rows:
        """Make the full runs of a variant, and return its rows."""
        workspace = trade_full.workspace_of(self.workspace, variant)
        problems = trade_full.make(workspace, list(self.full))
        for point, problem in problems.items():
            self.workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        seconds = None if problems else self._full_seconds(workspace)
        runs = []
        for point in self.full:
            errors = None
            if point not in problems:
                samples = trade_full.sampled(workspace, point, self.probes, self.case.trade.measure)
                errors = self._errors(point, samples)
            step = variant.time_step
            runs.append(run_row(variant.label, point.label, "full", step, seconds, errors))
        resolution = variant.case.discretization.resolution
        return model_row(runs, family="full", kind="full", resolution=resolution), runs

    def _reduced(self) -> list[Rows]:
        """Run all reduced models; where rounding gives several one step, keep the first."""
        runs = {name: ReducedRuns(each, self.probes) for name, each in self.workspaces.items()}
        found: dict[tuple[object, ...], Rows] = {}
        with self.workspace.context.report.progress("reduced models", len(self.listed)) as advance:
            for candidate in self.listed:
                rows = self.journal.rows(
                    f"{candidate.label}: {candidate.method}",
                    partial(self._of, candidate, runs[candidate.method.inner_product]),
                )
                steps = tuple(run.time_step for run in rows[1])
                found.setdefault((candidate.method, candidate.n_modes, steps), rows)
                advance(1)
        return list(found.values())

    def _of(self, candidate: Candidate, reduced: ReducedRuns) -> Rows:
        """Run a reduced model at all points, and return its rows."""
        outcomes = zip(self.full, reduced.run(candidate, list(self.full)), strict=True)
        runs = [self._run_row(candidate, point, outcome) for point, outcome in outcomes]
        method = candidate.method
        workspace = self.workspaces[method.inner_product]
        offline, training = offline_seconds(workspace, candidate.model, candidate.points)
        row = model_row(
            runs,
            family=candidate.family,
            kind=method.evaluation,
            inner_product=method.inner_product,
            basis=method.basis,
            projection=method.projection,
            calibrated=method.calibrated,
            n_modes=candidate.n_modes,
            resolution=self.case.discretization.resolution,
            offline_seconds=offline,
            training_seconds=training,
        )
        return row, runs

    def _run_row(self, candidate: Candidate, point: ParameterPoint, outcome: Outcome) -> RunRow:
        errors, estimates = None, NO_ESTIMATES
        if outcome.samples is not None:
            errors = self._errors(point, outcome.samples)
            estimates = self._estimates(point, outcome) or estimates
        role = role_of(self.case, self.case.basis_for(candidate.model, point), point)
        return run_row(
            candidate.label,
            point.label,
            role,
            outcome.time_step,
            outcome.seconds,
            errors,
            estimates,
        )

    def _estimates(self, point: ParameterPoint, outcome: Outcome) -> Errors | None:
        """Return the estimated and the true errors of a run, where it estimates them."""
        if outcome.samples is None or outcome.estimates is None:
            return None
        figures = effectivity(
            outcome.estimates,
            outcome.samples,
            self.full[point],
            self.probes,
            from_time=self.case.compare.from_time,
            left_out=LEFT_OUT,
        )
        if figures is None:
            return None
        return {name: figures[figure] for name, figure in ESTIMATES.items()}

    def _sampled(self, point: ParameterPoint) -> Samples:
        """Sample a full run of the case, which need not be one that models are compared with."""
        if point in self.full:
            return self.full[point]
        return trade_full.sampled(self.workspace, point, self.probes, self.case.trade.measure)

    def _errors(self, point: ParameterPoint, samples: Samples) -> Errors:
        history = compare(samples, self.full[point], self.probes, self.case.compare.from_time)
        if not len(history.time):
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: there is no snapshot in "
                "which the full run varies over the probes"
            )
        return {**errors_of(history), **self._measured_errors(point, samples)}

    def _measured_errors(self, point: ParameterPoint, samples: Samples) -> Errors:
        """Return the errors of the measurement that models are judged by, if there is one."""
        found = dict(NO_MEASURED)
        counted = self.full[point].time >= self.case.compare.from_time
        for quantity, reference in self.full[point].measured.items():
            values = samples.measured[quantity]
            overall, peak = quantity_errors(values[counted], reference[counted])
            name = f"measured_{quantity}_relative_l2"
            found |= {name: overall, f"{name}_peak": peak}
        return found
