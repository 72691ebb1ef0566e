"""Stage `trade`: models weighed against each other, their errors against what they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.effectivity import effectivity
from sphrom.compare.error_rows import EXACT, NO_ERRORS, Errors, errors_of
from sphrom.compare.figures_of_merit import compare
from sphrom.compare.timings import known_seconds
from sphrom.errors import CaseError
from sphrom.exchange.import_ import STAGE as IMPORT
from sphrom.setup.context import StageContext
from sphrom.setup.places import role_of
from sphrom.store.sampling import Probes, Samples, probes_of
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Target, Workspace
from sphrom.trade import extremes as trade_extremes
from sphrom.trade import full as trade_full
from sphrom.trade import report as trade_report
from sphrom.trade.candidates import Candidate, candidates, trade_points
from sphrom.trade.full import Variant
from sphrom.trade.journal import Journal
from sphrom.trade.models import offline_seconds, prepared
from sphrom.trade.nothing import NothingRow, alternatives, nothing_rows, with_beaten
from sphrom.trade.rows import full_row, reduced_row, with_gains
from sphrom.trade.runs import Outcome, ReducedRuns
from sphrom.trade.table import (
    NO_ESTIMATES,
    Estimates,
    Measure,
    ModelRow,
    RunRow,
    combined,
    parse_tolerance,
    with_fronts,
)


def run(context: StageContext, tolerance: str | None = None, extremes: bool = False) -> None:
    """Weigh the models that a case lists, and write tables and a plot into its folder `trade`.

    Parameters
    ----------
    tolerance : the errors allowed, such as `1%`: the cheapest model within them is named.
    extremes : map where models on the reference points are stable, instead.

    Raises
    ------
    CaseError
        When the case has no reduced models, or can't have those that it lists.
    ArtifactError
        When a full run, the basis, its splines or the operators are missing.
    """
    if tolerance is not None and extremes:
        raise CaseError("--tolerance: is not for --extremes, which weighs no models")
    allowed = None if tolerance is None else parse_tolerance(tolerance)
    if not context.case.rom:
        raise CaseError("rom: the case has no reduced models, so there is nothing to weigh")
    if extremes:
        trade_extremes.run(context)
        return
    trade = _Trade(context)
    rows, nothing = trade.rows()
    found = trade_report.Found(rows, nothing, trade.runs, trade.measure, trade.own_seconds)
    trade_report.publish(trade.workspace, found, allowed)
    trade.journal.remove()


@dataclass(frozen=True)
class _Truth:
    """The case's own full run at one parameter point."""

    point: ParameterPoint
    samples: Samples


class _Trade:
    """All models, run one after the other and held against the case's own full runs."""

    def __init__(self, context: StageContext) -> None:
        self.workspace = Workspace(context)
        self.case = context.case
        points = context.chosen(trade_points(self.case))
        self.listed = candidates(self.case, points)
        self.workspaces = self._prepared(context)
        self.measure = Measure(self.case.trade.probes, self.case.trade.statistic)
        self.probes: Probes = probes_of(self.case)
        self.runs: list[RunRow] = []
        self.truths = [self._truth(point) for point in points]
        self.journal = Journal(self.workspace, trade_report.FOLDER, self._made_from())
        self.own_seconds = self._own_seconds()

    def _made_from(self) -> list[tuple[Workspace, Target]]:
        """Return what the rows depend on."""
        full = [(self.workspace, self.workspace.full_run(truth.point)) for truth in self.truths]
        bases = [(each, each.basis()) for each in self.workspaces.values()]
        return full + bases + [(each, each.splines()) for each in self.workspaces.values()]

    def _prepared(self, context: StageContext) -> dict[str, Workspace]:
        """Return workspaces that reduced models can be made from, by inner product."""
        models: dict[str, list[ReducedModelSection]] = {}
        for candidate in self.listed:
            models.setdefault(candidate.method.inner_product, []).append(candidate.model)
        return {
            inner_product: prepared(context, inner_product, list(dict.fromkeys(some)))
            for inner_product, some in models.items()
        }

    def _truth(self, point: ParameterPoint) -> _Truth:
        with self.workspace.open(self.workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
        return _Truth(point, trade_full.sampled(self.workspace, point, self.probes))

    def _full_seconds(self, workspace: Workspace) -> float:
        """Time some steps of the full model; what a step costs doesn't depend on parameters."""
        repeats = self.case.trade.repeats
        return trade_full.seconds_of_run(workspace, self.truths[0].point, repeats)

    def _own_seconds(self) -> float | None:
        """Return what the case's own full run takes [s], None where it is of a program unknown."""
        with self.workspace.open(self.workspace.full_run(self.truths[0].point)) as run:
            if run.text("stage") == IMPORT:
                return known_seconds(run)
        return self.journal.seconds("own", lambda: self._full_seconds(self.workspace))

    def rows(self) -> tuple[list[ModelRow], list[NothingRow]]:
        """Run everything, and return a row for each model, and what there is without one."""
        full = [self._own(), *map(self._full, trade_full.variants(self.case))]
        resolution = self.case.discretization.resolution
        steps = [r.online_seconds for r in full if r.resolution == resolution]
        fastest = min((seconds for seconds in steps if seconds is not None), default=None)
        reduced = self._reduced()
        rows = [with_gains(r, self.own_seconds, fastest) for r in (*full, *reduced)]
        nothing = self._nothing()
        others = alternatives(rows[: len(full)], nothing)
        # The case's own full run is what the others are compared with: it is in no contest.
        marked = with_fronts(with_beaten(rows[1:], others, self.measure), self.measure)
        return [rows[0], *marked], nothing

    def _nothing(self) -> list[NothingRow]:
        """Return the errors that a user has without a model."""
        truths = {truth.point: truth for truth in self.truths}

        def sampled(point: ParameterPoint) -> Samples:
            if point in truths:
                return truths[point].samples
            return trade_full.sampled(self.workspace, point, self.probes)

        return list(
            nothing_rows(
                {point: truth.samples for point, truth in truths.items()},
                self.case.train_points,
                sampled,
                lambda point, samples: self._errors(truths[point], samples),
            )
        )

    def _own(self) -> ModelRow:
        own = trade_full.own_run(self.case)
        return full_row(own, "full, as in the case", EXACT, self.own_seconds)

    def _full(self, variant: Variant) -> ModelRow:
        row, rows = self.journal.rows(variant.label, lambda: self._full_anew(variant))
        self.runs += rows
        return row

    def _full_anew(self, variant: Variant) -> tuple[ModelRow, list[RunRow]]:
        workspace = trade_full.workspace_of(self.workspace, variant)
        points = [truth.point for truth in self.truths]
        problems = trade_full.make(workspace, points)
        for point, problem in problems.items():
            if problem is not None:
                self.workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        stable = not any(problems.values())
        seconds = self._full_seconds(workspace) if stable else None
        rows = []
        for truth in self.truths:
            unstable = problems[truth.point] is not None
            samples = None if unstable else trade_full.sampled(workspace, truth.point, self.probes)
            outcome = Outcome(variant.time_step, seconds, samples)
            rows.append(self._run_row(variant.label, truth, outcome, "full"))
        return full_row(variant, variant.label, combined(rows), seconds, stable=stable), rows

    def _reduced(self) -> list[ModelRow]:
        """Run all reduced models; of those that a snapshot's interval gives one step, the first."""
        runs = {name: ReducedRuns(each, self.probes) for name, each in self.workspaces.items()}
        found: dict[tuple[object, ...], ModelRow] = {}
        with self.workspace.context.report.progress("reduced models", len(self.listed)) as advance:
            for candidate in self.listed:
                row, rows = self.journal.rows(
                    f"{candidate.label}: {candidate.method}",
                    partial(self._reduced_anew, runs[candidate.method.inner_product], candidate),
                )
                steps = tuple(run.time_step for run in rows)
                model = (candidate.method, candidate.n_modes, steps)
                if model not in found:
                    found[model] = row
                    self.runs += rows
                advance(1)
        return list(found.values())

    def _reduced_anew(
        self, reduced_runs: ReducedRuns, candidate: Candidate
    ) -> tuple[ModelRow, list[RunRow]]:
        rows, outcomes = self._runs(reduced_runs, candidate)
        return self._reduced_row(candidate, rows, outcomes), rows

    def _runs(
        self, reduced_runs: ReducedRuns, candidate: Candidate
    ) -> tuple[list[RunRow], list[Outcome]]:
        outcomes = list(reduced_runs.run(candidate, [truth.point for truth in self.truths]))
        rows = [
            self._run_row(candidate.label, truth, outcome, self._role(candidate, truth.point))
            for truth, outcome in zip(self.truths, outcomes, strict=True)
        ]
        return rows, outcomes

    def _reduced_row(
        self, candidate: Candidate, rows: Sequence[RunRow], outcomes: Sequence[Outcome]
    ) -> ModelRow:
        workspace = self.workspaces[candidate.method.inner_product]
        once = offline_seconds(workspace, candidate.model, candidate.points)
        resolution = self.case.discretization.resolution
        return reduced_row(candidate, rows, outcomes, once, resolution)

    def _role(self, candidate: Candidate, point: ParameterPoint) -> str:
        return role_of(self.case, self.case.basis_for(candidate.model, point), point)

    def _run_row(self, label: str, truth: _Truth, outcome: Outcome, role: str) -> RunRow:
        unstable = outcome.samples is None
        return RunRow(
            model=label,
            parameters=truth.point.label,
            role=role,
            status="unstable" if unstable else "complete",
            time_step=outcome.time_step,
            seconds=outcome.seconds,
            **asdict(self._errors(truth, outcome.samples)),
            **asdict(self._estimates(truth, outcome)),
        )

    def _estimates(self, truth: _Truth, outcome: Outcome) -> Estimates:
        """Return what a run estimates its errors to be, and what they are."""
        if outcome.samples is None or outcome.estimates is None:
            return NO_ESTIMATES
        figures = effectivity(
            outcome.estimates,
            outcome.samples,
            truth.samples,
            self.probes,
            from_time=self.case.compare.from_time,
        )
        if figures is None:
            return NO_ESTIMATES
        return Estimates(
            velocity_estimate=figures["velocity_estimate"],
            velocity_rms_error=figures["velocity_error"],
            pressure_estimate=figures["pressure_estimate"],
            pressure_rms_error=figures["pressure_error"],
        )

    def _errors(self, truth: _Truth, samples: Samples | None) -> Errors:
        if samples is None:
            return NO_ERRORS
        history = compare(samples, truth.samples, self.probes, self.case.compare.from_time)
        if not len(history.time):
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: there is no snapshot in "
                "which the full run varies over the probes"
            )
        return errors_of(history)
