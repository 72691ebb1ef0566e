"""Stage `trade`: models weighed against each other, their errors against what they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.stages import operators, trade_extremes, trade_full, trade_report
from sphrom.stages.context import StageContext
from sphrom.stages.figures_of_merit import compare
from sphrom.stages.sampling import Probes, Samples, probes_of
from sphrom.stages.trade_candidates import (
    Candidate,
    basis_name,
    candidates,
    trade_points,
    with_operators,
)
from sphrom.stages.trade_full import Variant
from sphrom.stages.trade_journal import Journal
from sphrom.stages.trade_runs import Outcome, ReducedRuns, offline_seconds
from sphrom.stages.trade_table import (
    NO_ERRORS,
    Errors,
    Measure,
    ModelRow,
    RunRow,
    break_even,
    combined,
    errors_of,
    parse_tolerance,
    with_fronts,
)
from sphrom.stages.trajectory import require_complete
from sphrom.stages.workspace import Workspace


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
    workspace = _prepared(context)
    if extremes:
        trade_extremes.run(workspace)
        return
    trade = _Trade(workspace)
    rows = trade.rows()
    trade_report.publish(workspace, rows, trade.runs, trade.measure, trade.own_seconds, allowed)
    trade.journal.remove()


def _prepared(context: StageContext) -> Workspace:
    """Return the workspace, with operators where the case itself has no use for them."""
    workspace = Workspace(context)
    for target in (workspace.basis(), workspace.splines()):
        workspace.require(target)
    case = with_operators(context.case)
    if case.reference_bases and not context.case.reference_bases:
        operators.run(replace(context, case=case, keep_valid=True))
    workspace = Workspace(replace(context, case=case))
    if any(candidate.model.frame == "reference" for candidate in candidates(case)):
        workspace.require(workspace.operators())
    return workspace


@dataclass(frozen=True)
class _Truth:
    """The case's own full run at one parameter point."""

    point: ParameterPoint
    samples: Samples


class _Trade:
    """All models, run one after the other and held against the case's own full runs."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.measure = Measure(self.case.trade.probes, self.case.trade.statistic)
        self.probes: Probes = probes_of(self.case)
        self.runs: list[RunRow] = []
        self.truths = [self._truth(point) for point in trade_points(self.case)]
        made_from = [workspace.full_run(truth.point) for truth in self.truths]
        made_from += [workspace.basis(), workspace.splines()]
        self.journal = Journal(workspace, workspace.folder(trade_report.FOLDER), made_from)
        self.own_seconds = self.journal.seconds("own", lambda: self._full_seconds(workspace))

    def _truth(self, point: ParameterPoint) -> _Truth:
        with self.workspace.open(self.workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
        return _Truth(point, trade_full.sampled(self.workspace, point, self.probes))

    def _full_seconds(self, workspace: Workspace) -> float:
        """Time some steps of the full model; what a step costs doesn't depend on parameters."""
        repeats = self.case.trade.repeats
        return trade_full.seconds_of_run(workspace, self.truths[0].point, repeats)

    def rows(self) -> list[ModelRow]:
        """Run everything, and return a row for each model."""
        full = [self._own(), *map(self._full, trade_full.variants(self.case))]
        fastest = min(
            r.online_seconds
            for r in full
            if r.resolution == self.case.discretization.resolution and r.online_seconds is not None
        )
        reduced = self._reduced()
        rows = [self._with_gains(r, fastest) for r in (*full, *reduced)]
        # The case's own full run is what the others are held against: it is in no contest.
        return [rows[0], *with_fronts(rows[1:], self.measure)]

    def _own(self) -> ModelRow:
        own = trade_full.own_run(self.case)
        exact = Errors(*[0.0] * len(asdict(NO_ERRORS)))
        return _full_row(own, "full, as in the case", exact, self.own_seconds)

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
        return _full_row(variant, variant.label, combined(rows), seconds), rows

    def _reduced(self) -> list[ModelRow]:
        """Run all reduced models; of those that a snapshot's interval gives one step, the first."""
        reduced_runs = ReducedRuns(self.workspace, self.probes)
        listed = candidates(self.case)
        found: dict[tuple[object, ...], ModelRow] = {}
        with self.workspace.context.report.progress("reduced models", len(listed)) as advance:
            for candidate in listed:
                row, rows = self.journal.rows(
                    candidate.label, partial(self._reduced_anew, reduced_runs, candidate)
                )
                steps = tuple(run.time_step for run in rows)
                if (candidate.model, steps) not in found:
                    found[candidate.model, steps] = row
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
            self._run_row(candidate.label, truth, outcome, self._role(truth.point))
            for truth, outcome in zip(self.truths, outcomes, strict=True)
        ]
        return rows, outcomes

    def _reduced_row(
        self, candidate: Candidate, rows: Sequence[RunRow], outcomes: Sequence[Outcome]
    ) -> ModelRow:
        seconds = [outcome.seconds for outcome in outcomes if outcome.seconds is not None]
        stable = len(seconds) == len(outcomes)
        return _model_row(
            candidate.label,
            combined(rows),
            kind=candidate.model.frame,
            projection=candidate.model.projection,
            n_modes=candidate.model.n_modes,
            resolution=self.case.discretization.resolution,
            time_step=min(outcome.time_step for outcome in outcomes),
            online_seconds=sum(seconds) / len(seconds) if stable else None,
            once=offline_seconds(self.workspace, candidate.model.frame),
        )

    def _role(self, point: ParameterPoint) -> str:
        trained = point in self.case.bases[basis_name(self.case)]
        return "trained" if trained else "predicted"

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

    def _with_gains(self, found: ModelRow, fastest: float) -> ModelRow:
        """Return a row with what a model gains over the full model."""
        seconds = found.online_seconds
        if seconds is None:
            return found
        gained = replace(
            found,
            speed_up=self.own_seconds / seconds,
            speed_up_largest_step=fastest / seconds,
        )
        if found.kind == "full":
            return gained
        runs = break_even(found.offline_seconds, self.own_seconds, seconds)
        return replace(gained, break_even_runs=runs)


def _full_row(variant: Variant, label: str, errors: Errors, seconds: float | None) -> ModelRow:
    return _model_row(
        label,
        errors,
        kind="full",
        resolution=variant.case.discretization.resolution,
        time_step=variant.time_step,
        online_seconds=seconds,
    )


def _model_row(
    label: str,
    errors: Errors,
    *,
    kind: str,
    resolution: int,
    time_step: float,
    online_seconds: float | None,
    projection: str | None = None,
    n_modes: int | None = None,
    once: tuple[float, float] = (0.0, 0.0),
) -> ModelRow:
    """Return a row without gains; `once` is what the model costs before its first run."""
    return ModelRow(
        model=label,
        kind=kind,
        projection=projection,
        n_modes=n_modes,
        resolution=resolution,
        time_step=time_step,
        stable=online_seconds is not None,
        offline_seconds=once[0],
        training_seconds=once[1],
        online_seconds=online_seconds,
        speed_up=None,
        speed_up_largest_step=None,
        break_even_runs=None,
        velocity_front=False,
        pressure_front=False,
        **asdict(errors),
    )
