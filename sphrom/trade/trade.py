"""Stage `trade`: models weighed against each other, their errors against their cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.costs import is_imported, known_seconds, offline_seconds
from sphrom.errors import ArtifactError, CaseError
from sphrom.kernels.jit import source_hash
from sphrom.metrics.effectivity import effectivity
from sphrom.metrics.histories import EXACT, Errors, compare, errors_of
from sphrom.metrics.measures import quantity_errors
from sphrom.metrics.samples import Samples
from sphrom.reduction.error_calibration import LEFT_OUT
from sphrom.setup.assembly import role_of
from sphrom.setup.context import StageContext
from sphrom.store.journal import digest_of, read_journal, write_journal
from sphrom.store.sampling import probes_of
from sphrom.store.targets import Target
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace
from sphrom.trade import full as trade_full
from sphrom.trade import report as trade_report
from sphrom.trade.advice import parse_tolerance
from sphrom.trade.candidates import Candidate, candidates, trade_points
from sphrom.trade.full import Variant
from sphrom.trade.runs import Outcome, prepared, reduced_runs
from sphrom.trade.table import (
    ESTIMATES,
    NO_ESTIMATES,
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
from sphrom.whole_files import remove_whole

PROGRESS = "progress.json"
"""The file of the rows of a trade that is not complete."""
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
    trade.journal.remove()


class _Trade:
    """All models, run one after the other and compared with the case's own full runs."""

    def __init__(self, context: StageContext) -> None:
        self.workspace = Workspace(context)
        self.case = context.case
        points = context.chosen(trade_points(self.case))
        self.listed = candidates(self.case, points)
        models: dict[str, dict[str, ReducedModelSection]] = {}
        for each in self.listed:
            models.setdefault(each.method.inner_product, {})[each.model.name] = each.model
        self.workspaces = {
            inner_product: prepared(context, inner_product, [*some.values()])
            for inner_product, some in models.items()
        }
        self.probes = probes_of(self.case)
        self.full = {point: self._own_samples(point) for point in points}
        made_from = [(self.workspace, self.workspace.full_run(point)) for point in self.full]
        for workspace in self.workspaces.values():
            made_from += [(workspace, workspace.basis()), (workspace, workspace.splines())]
        self.journal = Journal(self.workspace, made_from)

    def _own_samples(self, point: ParameterPoint) -> Samples:
        with self.workspace.open(self.workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
        return self._sampled(self.workspace, point)

    def _sampled(self, workspace: Workspace, point: ParameterPoint) -> Samples:
        return trade_full.sampled(workspace, point, self.probes, self.case.trade.measure)

    def _full_seconds(self, workspace: Workspace) -> float:
        """Time some steps of the full model; the cost of a step doesn't depend on parameters."""
        return trade_full.seconds_of_run(workspace, next(iter(self.full)), self.case.trade.repeats)

    def results(self) -> trade_report.Results:
        """Run everything, and return the rows of all models, the case's own full run first."""
        first = next(iter(self.full))
        with self.workspace.open(self.workspace.full_run(first)) as artifact:
            imported, own_seconds = is_imported(artifact), known_seconds(artifact)
        if not imported:  # Its steps are timed anew, as those of other full runs are.
            own_seconds = self.journal.seconds("own", lambda: self._full_seconds(self.workspace))
        own = ModelRow(
            model="full, as in the case",
            family="full",
            kind="full",
            resolution=self.case.discretization.resolution,
            time_step=self.case.plan.steps.time_step,
            online_seconds=own_seconds,
            errors={**EXACT, **self._measured_errors(first, self.full[first])},
        )
        each = [
            self.journal.rows(variant.label, partial(self._full, variant))
            for variant in trade_full.variants(self.case)
        ]
        each += self._reduced()

        def trained(point: ParameterPoint) -> Samples:
            return self.full.get(point) or self._sampled(self.workspace, point)

        without = list(alternatives(self.case, self.full, trained, self._errors))
        measure = Measure.of_case(self.case)
        rows = with_gains([own, *(row for row, _ in each)], own_seconds)
        rows = with_fronts(with_beaten(rows, without, measure), measure)
        runs = [run for _, runs in each for run in runs]
        return trade_report.Results(rows, without, runs, measure, own_seconds)

    def _full(self, variant: Variant) -> Rows:
        """Make the full runs of a variant, and return its rows."""
        workspace = trade_full.workspace_of(self.workspace, variant)
        problems = trade_full.make(workspace, list(self.full))
        for point, problem in problems.items():
            self.workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        seconds = None if problems else self._full_seconds(workspace)
        runs = []
        for point in self.full:
            samples = None if point in problems else self._sampled(workspace, point)
            outcome = Outcome(variant.time_step, seconds, samples)
            runs.append(self._row(variant.label, "full", point, outcome))
        resolution = variant.case.discretization.resolution
        return model_row(runs, family="full", kind="full", resolution=resolution), runs

    def _reduced(self) -> list[Rows]:
        """Run all reduced models; where rounding gives several one step, keep the first."""
        found: dict[tuple[object, ...], Rows] = {}
        with self.workspace.context.report.progress("reduced models", len(self.listed)) as advance:
            for candidate in self.listed:
                name = f"{candidate.label}: {candidate.method}"
                rows = self.journal.rows(name, partial(self._of, candidate))
                steps = tuple(run.time_step for run in rows[1])
                found.setdefault((candidate.method, candidate.n_modes, steps), rows)
                advance(1)
        return list(found.values())

    def _of(self, candidate: Candidate) -> Rows:
        """Run a reduced model at all points, and return its rows."""
        method = candidate.method
        workspace, points = self.workspaces[method.inner_product], list(self.full)
        runs = []
        outcomes = reduced_runs(workspace, candidate, points, self.probes)
        for point, outcome in zip(points, outcomes, strict=True):
            role = role_of(self.case, self.case.plan.basis_for(candidate.model, point), point)
            runs.append(self._row(candidate.label, role, point, outcome))
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

    def _row(self, model: str, role: str, point: ParameterPoint, outcome: Outcome) -> RunRow:
        samples = outcome.samples
        return RunRow(
            model=model,
            parameters=point.label,
            role=role,
            status="unstable" if samples is None else "complete",
            time_step=outcome.time_step,
            seconds=outcome.seconds,
            errors=UNSTABLE if samples is None else self._errors(point, samples),
            estimates=self._estimates(point, outcome),
        )

    def _estimates(self, point: ParameterPoint, outcome: Outcome) -> Errors:
        """Return the estimated and the true errors of a run, where it estimates them."""
        if outcome.samples is None or outcome.estimates is None:
            return NO_ESTIMATES
        figures = effectivity(
            outcome.estimates,
            outcome.samples,
            self.full[point],
            self.probes,
            from_time=self.case.compare.from_time,
            left_out=LEFT_OUT,
        )
        if figures is None:
            return NO_ESTIMATES
        return {name: figures[figure] for name, figure in ESTIMATES.items()}

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


class Journal:
    """The rows of a trade that is not complete, kept after each model, so that it can go on.

    Times are measured: a trade that goes on keeps those that it has, and doesn't measure again.
    """

    def __init__(self, workspace: Workspace, made_from: Sequence[tuple[Workspace, Target]]) -> None:
        """Find the rows that a stopped trade of the same case and artifacts left.

        Raises ArtifactError when there are some, but neither `resume` nor `force` is asked for.
        """
        self._path = workspace.folder(trade_report.FOLDER) / PROGRESS
        parts = [workspace.case_text, source_hash(), str(workspace.threads)]
        for place, target in made_from:
            with place.open(target) as artifact:
                parts.append(artifact.content_sha256)
        self._key = digest_of(parts)
        self._rows: dict[str, Any] = {}
        context = workspace.context
        known = read_journal(self._path)
        if known is None:
            return
        if known.get("key") != self._key or not isinstance(known["rows"], dict):
            context.report.warn(f"{self._path} is of another case or damaged: not used")
        elif context.resume:
            self._rows = known["rows"]
            context.report.info(f"trade: {len(self._rows)} rows are kept of the one that stopped")
        elif not context.force:
            raise ArtifactError(
                f"a trade was stopped after {len(known['rows'])} rows: `--resume` keeps them, "
                "`--force` starts anew"
            )

    def seconds(self, name: str, measure: Callable[[], float]) -> float:
        """Return the seconds that were measured before, or measure them."""
        if name not in self._rows:
            self._keep(name, measure())
        return float(self._rows[name])

    def rows(self, label: str, make: Callable[[], Rows]) -> Rows:
        """Return the rows that were made of a model before, or make them."""
        if label not in self._rows:
            row, runs = make()
            self._keep(label, {"model": asdict(row), "runs": [asdict(run) for run in runs]})
        known = self._rows[label]
        return ModelRow(**known["model"]), [RunRow(**run) for run in known["runs"]]

    def remove(self) -> None:
        """Remove it: the trade is complete."""
        remove_whole(self._path)

    def _keep(self, name: str, value: Any) -> None:
        self._rows[name] = value
        write_journal(self._path, self._key, self._rows)
