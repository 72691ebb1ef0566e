"""Stage `trade`: models weighed against each other, their errors against their cost."""

from __future__ import annotations

from dataclasses import replace

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.costs import is_imported, known_seconds, offline_seconds
from sphrom.errors import CaseError
from sphrom.metrics.histories import EXACT, Errors, compare, errors_of
from sphrom.metrics.measures import errors_of as relative_errors
from sphrom.metrics.measures import mean_square
from sphrom.metrics.samples import Samples
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.reduction import reference_model
from sphrom.setup.assembly import role_of
from sphrom.setup.context import StageContext
from sphrom.store.sampling import probes_of
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace
from sphrom.trade import models as trade_models
from sphrom.trade import report as trade_report
from sphrom.trade.advice import parse_tolerance
from sphrom.trade.models import Candidate, candidates, prepared, trade_points
from sphrom.trade.table import (
    NO_MEASURED,
    UNSTABLE,
    Measure,
    ModelRow,
    RunRow,
    alternatives,
    model_row,
    with_beaten,
    with_fronts,
    with_gains,
)

Rows = tuple[ModelRow, list[RunRow]]


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


class _Trade:
    """All models, run one after the other and compared with the case's own full runs."""

    def __init__(self, context: StageContext) -> None:
        self.workspace, self.case = Workspace(context), context.case
        points = context.chosen(trade_points(self.case))
        self.listed = candidates(self.case, points)
        models = {each.model.name: each.model for each in self.listed}
        self.wider = prepared(context, [*models.values()])
        self.probes = probes_of(self.case)
        self.full: dict[ParameterPoint, Samples] = {}
        for point in points:
            with self.workspace.open(self.workspace.full_run(point)) as trajectory:
                require_complete(trajectory)
            self.full[point] = self._sampled(self.workspace, point)

    def _sampled(self, workspace: Workspace, point: ParameterPoint) -> Samples:
        return trade_models.sampled(workspace, point, self.probes, self.case.trade.measure)

    def _full_seconds(self, workspace: Workspace) -> float:
        """Time some steps of the full model; the cost of a step doesn't depend on parameters."""
        repeats = self.case.trade.repeats
        return trade_models.seconds_of_run(workspace, next(iter(self.full)), repeats)

    def results(self) -> trade_report.Results:
        """Run everything, and return the rows of all models, the case's own full run first."""
        first = next(iter(self.full))
        with self.workspace.open(self.workspace.full_run(first)) as artifact:
            imported, own_seconds = is_imported(artifact), known_seconds(artifact)
        if not imported:  # Its steps are timed anew, as those of other full runs are.
            own_seconds = self._full_seconds(self.workspace)
        own = ModelRow(
            model="full, as in the case",
            family="full",
            kind="full",
            resolution=self.case.discretization.resolution,
            time_step=self.case.plan.steps.time_step,
            online_seconds=own_seconds,
            errors={**EXACT, **self._measured_errors(first, self.full[first])},
        )
        each = [self._full(*variant) for variant in trade_models.variants(self.case).items()]
        each += self._reduced()

        def trained(point: ParameterPoint) -> Samples:
            return self.full.get(point) or self._sampled(self.workspace, point)

        without = list(alternatives(self.case, self.full, trained, self._errors))
        measure = Measure.of_case(self.case)
        rows = with_gains([own, *(row for row, _ in each)], own_seconds)
        rows = with_fronts(with_beaten(rows, without, measure), measure)
        runs = [run for _, runs in each for run in runs]
        return trade_report.Results(rows, without, runs, measure, own_seconds)

    def _full(self, label: str, variant: Case) -> Rows:
        """Make the full runs of a variant, and return its rows."""
        workspace = trade_models.workspace_of(self.workspace, variant)
        problems = trade_models.make(workspace, list(self.full))
        for point, problem in problems.items():
            self.workspace.context.report.warn(f"{label}, {point.label}: {problem}")
        seconds = None if problems else self._full_seconds(workspace)
        runs, step = [], variant.plan.steps.time_step
        for point in self.full:
            samples = None if point in problems else self._sampled(workspace, point)
            runs.append(self._row(label, "full", point, step, seconds, samples))
        resolution = variant.discretization.resolution
        return model_row(runs, family="full", kind="full", resolution=resolution), runs

    def _reduced(self) -> list[Rows]:
        """Run all reduced models; where rounding gives several one step, keep the first."""
        found: dict[tuple[object, ...], Rows] = {}
        with self.workspace.context.report.progress("reduced models", len(self.listed)) as advance:
            for candidate in self.listed:
                rows = self._of(candidate)
                steps = tuple(run.time_step for run in rows[1])
                found.setdefault((candidate.model.name, steps), rows)
                advance(1)
        return list(found.values())

    def _of(self, candidate: Candidate) -> Rows:
        """Run a reduced model at all points, and return its rows."""
        section, fast = candidate.model, FastModel(self.wider, candidate.model)
        runs = [self._fast(fast, candidate, point) for point in self.full]
        offline, training = offline_seconds(self.wider, section, list(self.full))
        row = model_row(
            runs,
            family=candidate.family,
            kind=section.evaluation,
            basis=section.basis,
            projection=section.projection,
            calibrated=section.is_calibrated,
            n_modes=section.n_modes,
            resolution=self.case.discretization.resolution,
            offline_seconds=offline,
            training_seconds=training,
        )
        return row, runs

    def _fast(self, fast: FastModel, candidate: Candidate, point: ParameterPoint) -> RunRow:
        """Run and time a model at a point."""
        measure, role = self.case.trade.measure, role_of(self.case, fast.basis_at(point), point)
        reduced = fast.at(point)
        steps = reference_model.automatic(reduced).with_steps(candidate.step_factor)
        found, seconds = steps.timed(self.case.trade.repeats)
        run = FastRun(fast, point, reduced, found)
        if run.failure is not None:
            return self._row(candidate.label, role, point, run.time_step, None, None)
        samples = run.sampled(self.probes)
        if measure is not None:
            samples = replace(samples, measured=run.measured[measure])
        return self._row(candidate.label, role, point, run.time_step, seconds, samples)

    def _row(
        self,
        model: str,
        role: str,
        point: ParameterPoint,
        time_step: float,
        seconds: float | None,
        samples: Samples | None,
    ) -> RunRow:
        """Return the row of a run, which became unstable where there are no samples."""
        return RunRow(
            model=model,
            parameters=point.label,
            role=role,
            status="unstable" if samples is None else "complete",
            time_step=time_step,
            seconds=seconds,
            errors=UNSTABLE if samples is None else self._errors(point, samples),
        )

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
            given = values[counted], reference[counted]
            overall, peak = relative_errors(quantity, *given, mean_square(quantity, given[1]))
            name = f"measured_{quantity}_relative_l2"
            found |= {name: overall, f"{name}_peak": peak}
        return found
