"""Stage `compare`: compare reduced with full runs, full runs with exact solutions, and the map."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import chain

from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import FULL
from sphrom.compare.answer import tell_answer
from sphrom.compare.basis_figures import spectrum_rows
from sphrom.compare.comparison_figures import draw_comparison, exact_samples, remove_figures
from sphrom.compare.comparison_tables import (
    DecayRow,
    Tables,
    error_row,
    estimate_row,
    show,
)
from sphrom.compare.costs import run_timings, stage_timings
from sphrom.compare.measured import (
    Measured,
    MeasureRow,
    flow_row,
    measure_rows,
    measured_estimates,
    oscillation_rows,
)
from sphrom.compare.references import compare_with_references
from sphrom.compare.stored_comparison import ComparisonWriter
from sphrom.errors import CaseError
from sphrom.metrics.histories import compare
from sphrom.metrics.measures import Samples, without_weight
from sphrom.metrics.series import exponential_rate
from sphrom.models.contract import Limit, basis_used, family_of, model_of
from sphrom.models.stored_run import StoredRun
from sphrom.scenes.flows import TaylorGreen
from sphrom.setup.assembly import role_of, sound_averages
from sphrom.setup.context import StageContext
from sphrom.store.stored_run import probes_of
from sphrom.store.trajectory import measured_of, require_complete
from sphrom.store.workspace import Workspace

FEW = 4
"""Number of figures that are drawn unless a case asks for all of them."""


def run(context: StageContext) -> None:
    """Compare all runs of the case, write artifact, tables and plots, and report the answer.

    Raises ArtifactError when a run is missing, or existing tables are damaged.
    """
    workspace = Workspace(context)
    case = context.case
    if not (case.rom or case.scene.domain.has_walls or _exact_flows(case)):
        tell_answer(workspace, Tables())
        return
    _tell_unseen(workspace)
    target = workspace.comparison()
    is_new = workspace.must_make(target)
    if is_new:
        tables = Tables()
        probes = probes_of(case)
        remove_figures(workspace)
        with workspace.create(target) as artifact:
            for point in case.plan.points:
                writer = ComparisonWriter(artifact, point, probes)
                _PointComparison(workspace, writer, tables).compare()
            tables.decay.extend(
                _decay(workspace, point, flow) for point, flow in _exact_flows(case)
            )
            tables.singular_values.extend(spectrum_rows(workspace))
            tables.timings.extend(run_timings(workspace))
            tables.stages.extend(stage_timings(workspace))
            tables.write(workspace)
    else:
        tables, _ = Tables.read(workspace)
    show(context.report, tables)
    tell_answer(workspace, tables)
    if case.compare.plots is not False:
        most = None if case.compare.plots else FEW
        draw_comparison(workspace, tables, most)


def _exact_flows(case: Case) -> list[tuple[ParameterPoint, TaylorGreen]]:
    flows = ((point, case.plan.flow(point).exact) for point in case.plan.points)
    return [(point, flow) for point, flow in flows if flow is not None and case.compare.exact]


def _decay(workspace: Workspace, point: ParameterPoint, flow: TaylorGreen) -> DecayRow:
    exact = flow.energy_decay_rate
    with StoredRun.opened(workspace, point) as run:
        fitted = exponential_rate(run.time, run.kinetic_energy)
    return DecayRow(point.label, fitted, exact, fitted / exact)


def _tell_unseen(workspace: Workspace) -> None:
    plan = workspace.case.plan
    for model in workspace.case.rom:
        unseen = [point.label for point in plan.rom_points(model) if point not in plan.points]
        where = f"at {', '.join(unseen)}" if unseen else ""
        if not plan.ends_with_case(model):
            where = f"until {model.until:g} s"
        if where:
            workspace.context.report.info(f"{model.name}: no full run to compare with {where}")


class _PointComparison:
    """The comparisons at one parameter point, in the order of the tables."""

    def __init__(self, workspace: Workspace, writer: ComparisonWriter, tables: Tables) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.writer = writer
        self.tables = tables
        self.point = point = writer.point
        self.probes = probes = writer.probes
        plan = self.case.plan
        self.models = plan.compared_at(point)
        with workspace.open(workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
            run = StoredRun.of(workspace, trajectory, point)
            self.full = self._sampled(run)
            writer.full_run(self.full)
            for row, profile in compare_with_references(self.case, point, trajectory, probes):
                tables.reference.append(row)
                writer.profile(row, profile)
            self._describe_flow(run, self.full)
            self.measured = measured_of(self.case, trajectory)
        self.family = family_of(self.case)
        if self.models:
            self.measured |= self.family.part("measured_at")(workspace, point)
        self.references = {FULL: self.full}
        if (flow := plan.flow(point).exact) is not None and self.case.compare.exact:
            self.references["exact"] = exact_samples(flow, probes.all, self.full.time)
        self.measures = defaultdict[tuple[str, str], list[MeasureRow]](list)

    def compare(self) -> None:
        """Add all comparisons at this point to the artifact and the tables."""
        full = Limit(FULL, self.full, measured=self.measured)
        self._measure(full)
        if "exact" in self.references:
            self._add(full, "exact")
        if self.models:
            self._compare_limits()
        for model in self.models:
            self._compare_model(model)
        self.tables.measures.extend(chain.from_iterable(self.measures.values()))

    def _compare_limits(self) -> None:
        """Compare the best that models can be, and simpler models."""
        limits = self.family.part("limits")
        for best in limits(self.workspace, self.models, self.point, self.probes):
            self._add(best)
            self._measure(best)

    def _compare_model(self, model: ReducedModelSection) -> None:
        workspace = self.workspace
        case = self.case
        basis, size = basis_used(workspace, model, self.point)
        with workspace.open(workspace.reduced_run(model, self.point)) as trajectory:
            status = trajectory.text("status")
            run = StoredRun.of(workspace, trajectory, self.point, model)
            compared = Limit(model.name, self._sampled(run), basis, size, status=status)
            self._describe_flow(run, compared.samples)
            if status == "complete":  # a run that stopped early has no estimates and no speed-up
                samples, full = self._without_weight(compared.samples, self.full)
                estimate = estimate_row(
                    trajectory,
                    samples,
                    full,
                    self.probes,
                    case.compare.from_time,
                    **self._described(compared),
                )
                self.tables.estimates.extend(filter(None, [estimate]))
                measured = {**measured_of(case, trajectory), **run.whole}
                regime = model_of(workspace, model).regime(self.point)
                self._measure(
                    replace(compared, measured=measured, regime=regime),
                    measured_estimates(case, trajectory),
                )
        for against in self.references:
            self._add(compared, against)

    def _sampled(self, run: StoredRun) -> Samples:
        name = "the full run" if run.name == FULL else run.name
        text = f"sample {name}, {self.point.label}"
        with self.workspace.context.report.details.progress(text, len(run.time)) as advance:
            return run.sampled(self.probes.all, advance=advance)

    def _describe_flow(self, run: StoredRun, samples: Samples) -> None:
        """Describe the flow of a run in a scene with walls, unless the run has no snapshots."""
        if self.case.scene.domain.has_walls and len(samples.time):
            row = flow_row(self.case, self.point, run, samples, self.probes)
            self.tables.flow.append(row)

    def _measure(self, run: Limit, estimates: Measured | None = None) -> None:
        """Add the rows of a run's measurements, if it has any, grouped by quantity."""
        if run.measured is None:
            return
        since = self.case.compare.from_time
        plan = self.case.plan
        for row in measure_rows(
            run.measured,
            self.measured,
            self.full.time,
            lambda name: max(since, plan.means_from.get(name, plan.settled_from)),
            estimates or {},
            with_weight=plan.with_weight,
            averages=sound_averages(self.case),
            n_dim=self.case.scene.domain.n_dim,
            n_modes=run.n_modes,
            **self._described(run),
        ):
            self.measures[row.measured, row.quantity].append(row)
        self.tables.oscillations.extend(
            oscillation_rows(
                self.case,
                self.full.time,
                run.measured,
                self.measured,
                compared=run.name,
                parameters=self.point.label,
                regime=run.regime,
                estimates=estimates,
            )
        )

    def _described(self, run: Limit) -> dict[str, str]:
        role = "" if run.basis is None else role_of(self.case, run.basis, self.point)
        return {"compared": run.name, "parameters": self.point.label, "role": role}

    def _without_weight(self, samples: Samples, reference: Samples) -> tuple[Samples, Samples]:
        """Return samples of two runs; with a free surface, without the weight of fluid at rest."""
        weight = self.case.plan.weight_at(self.point, self.probes.all)
        return (
            (samples, reference) if weight is None else without_weight(samples, reference, weight)
        )

    def _add(self, run: Limit, against: str = FULL) -> None:
        """Add the errors of a run, and its samples."""
        samples, reference = self._without_weight(run.samples, self.references[against])
        plan = self.case.plan
        begin = self.case.compare.from_time
        history = compare(samples, reference, self.probes, begin, plan.longest_sound_period)
        if run.status == "complete" and len(history.time) == 0:
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: the "
                f"{against} solution is constant over the probes at all snapshots"
            )
        row = error_row(history, run.status, run.n_modes, against=against, **self._described(run))
        self.tables.errors.append(row)
        self.writer.run(row, history, run.samples)
