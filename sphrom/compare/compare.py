"""Stage `compare`: reduced against full runs, full against exact ones, and the share of the map."""

from __future__ import annotations

import numpy as np

from sphrom.artifacts import Artifact
from sphrom.artifacts.records.comparison import Ranges
from sphrom.case.models import Case
from sphrom.case.plan import ends_with_case, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare import report as comparison_report
from sphrom.compare.answer import tell_answer
from sphrom.compare.artifact import write_results
from sphrom.compare.flow import StoredRun, bulk_velocity
from sphrom.compare.forces import ComparedForce, FullForces, best_results, run_results
from sphrom.compare.measures import (
    ComparedMeasure,
    FullMeasures,
    best_measures,
    map_measures,
    run_measures,
)
from sphrom.compare.point_results import Comparison, Excerpt, PointResults
from sphrom.compare.reference_errors import ProfileComparison, compare_with_references, profiles_of
from sphrom.compare.rows import EstimateRow, error_row, estimate_row
from sphrom.compare.timings import RunTiming, reduced_timing, undisturbed_seconds
from sphrom.errors import CaseError
from sphrom.metrics.discrepancy import instantaneous_range
from sphrom.metrics.flow import FieldSeries, FlowRow, flow_row
from sphrom.metrics.histories import compare
from sphrom.metrics.samples import Probes, Samples
from sphrom.online.rebuilt_run import RebuiltRun, read_probes
from sphrom.setup import assembly
from sphrom.setup.check import require_room
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import sampler
from sphrom.setup.places import role_of
from sphrom.store.operators import sized
from sphrom.store.sampling import (
    expand,
    probes_of,
    sample_best,
    sample_exact,
    sample_mapped,
    sample_run,
)
from sphrom.store.splines import read_modes
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace


def run(context: StageContext) -> None:
    """Compare all runs of the case, and tell the answer."""
    make(context)
    tell_answer(Workspace(context))


def make(context: StageContext) -> None:
    """Compare all runs of the case; write `compare.h5`, `compare.json`, tables and plots."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, None, "compare")
    if not _anything_to_compare(context.case):
        context.report.info(
            "nothing to compare: no reduced models, and no solution to compare with"
        )
        return
    _tell_unseen(workspace)
    target = workspace.comparison()
    if not workspace.must_make(target):
        comparison_report.show_stored(workspace)
        return
    probes = probes_of(context.case)
    with workspace.create(target) as artifact:
        results = [
            _PointComparison(workspace, point, probes).results() for point in context.case.points
        ]
        for result in results:
            write_results(artifact, result, probes)
        comparison_report.publish(workspace, results, probes)


def _tell_unseen(workspace: Workspace) -> None:
    """Tell which reduced runs have no full run to compare with."""
    case = workspace.case
    for model in case.rom:
        if not ends_with_case(case, model):
            workspace.context.report.info(
                f"{model.name}: no full run to compare with until {model.until:g} s"
            )
            continue
        unseen = [point.label for point in case.rom_points(model) if point not in case.points]
        if unseen:
            workspace.context.report.info(
                f"{model.name}: no full run to compare with at {', '.join(unseen)}"
            )


def _anything_to_compare(case: Case) -> bool:
    """Whether there are reduced models, solutions to compare with, or walls."""
    exact = case.compare.exact and case.has_exact_solution
    return bool(case.rom) or exact or assembly.domain(case).has_walls


class _PointComparison:
    """The comparisons at one parameter point, in the order in which tables show them."""

    def __init__(self, workspace: Workspace, point: ParameterPoint, probes: Probes) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.point = point
        self.probes = probes
        self.sample = sampler(self.case, probes.all)
        self.describe_flow = assembly.domain(self.case).has_walls
        self.models = [
            model
            for model in self.case.rom
            if point in self.case.rom_points(model) and ends_with_case(self.case, model)
        ]
        self.comparisons: list[Comparison] = []
        self.timings: list[RunTiming] = []
        self.flows: list[FlowRow] = []
        self.estimates: list[EstimateRow] = []
        self.references: list[ProfileComparison] = []
        self.forces: list[ComparedForce] = []
        self.measures: list[ComparedMeasure] = []
        with workspace.open(workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
            n_steps = step_plan(self.case).n_steps
            self.full_seconds = undisturbed_seconds(trajectory, n_steps)
            self.full = self._sampled("the full run", trajectory)
            self.references = self._compare_with_references(trajectory)
            self._describe_flow("full", StoredRun(trajectory), self.full)
            self.full_forces = FullForces.of(self.case, point, trajectory)
            self.forces += self.full_forces.compared("full", self.full_forces.parts)
            self.full_measures = FullMeasures.of(self.case, point, trajectory)
            self.measures += self.full_measures.compared("full", self.full_measures.measured)
        self.middle = len(self.full.time) // 2
        flow = assembly.exact_flow(self.case, point) if self.case.compare.exact else None
        self.exact = sample_exact(flow, probes, self.full.time) if flow is not None else None

    def results(self) -> PointResults:
        """Return all comparisons at this point."""
        if self.exact is not None:
            self._add(self.full, "full", against="exact")
        if self.models:
            self._compare_limits()
        for model in self.models:
            self._compare_model(model)
        return PointResults(
            point=self.point,
            full=self._excerpt(self.full),
            ranges=Ranges(
                time=self.full.time,
                speed=instantaneous_range(self.full.speed),
                pressure=instantaneous_range(self.full.pressure),
            ),
            exact=self._excerpt(self.exact) if self.exact is not None else None,
            models=[model.name for model in self.models],
            comparisons=self.comparisons,
            timings=self.timings,
            references=self.references,
            flows=self.flows,
            estimates=self.estimates,
            forces=self.forces,
            measures=self.measures,
        )

    def _compare_limits(self) -> None:
        """Compare the mapped snapshots, and the best state in each basis."""
        with self.workspace.open(self.workspace.mapped(self.point)) as mapped:
            self._add(sample_mapped(self.case, mapped, self.sample), "map")
            self.measures += map_measures(self.full_measures, mapped)
            for name, size in self._bases():
                best = _best(self.workspace, mapped, name, size, self.probes)
                self._add(best, f"best possible, {name} M={size}", basis=name, n_modes=size)
                about = mapped, name, size
                self.forces += best_results(self.workspace, self.full_forces, *about)
                self.measures += best_measures(self.workspace, self.full_measures, *about)

    def _bases(self) -> list[tuple[str, int]]:
        """Return each basis and size that some model uses here, once."""
        used = {(self.case.basis_for(m, self.point), self._size(m)) for m in self.models}
        return sorted(used)

    def _size(self, model: ReducedModelSection) -> int:
        return sized(self.workspace, model, self.point).size

    def _compare_model(self, model: ReducedModelSection) -> None:
        target = self.workspace.reduced_run(model, self.point)
        with self.workspace.open(target) as trajectory:
            status = trajectory.text("status")
            if model.on_particles:
                reduced = self._sampled(model.name, trajectory)
                self._describe_flow(model.name, StoredRun(trajectory), reduced)
            else:
                reduced = self._expanded(model, trajectory)
                fields = RebuiltRun.of(self.workspace, trajectory, model, self.point)
                self._describe_flow(model.name, fields, reduced)
            if status == "complete":  # a run that stopped early has no estimates, and no speed-up
                self._add_estimate(model, trajectory, reduced)
                about = self.case.basis_for(model, self.point), self._size(model)
                self.forces += run_results(self.full_forces, model.name, trajectory, *about)
                self.measures += run_measures(self.full_measures, model.name, trajectory, *about)
                self.timings.append(
                    reduced_timing(self.case, model, self.point, trajectory, self.full_seconds)
                )
        basis = self.case.basis_for(model, self.point)
        for against in ("full", "exact") if self.exact is not None else ("full",):
            self._add(reduced, model.name, against, basis, self._size(model), status)

    def _add_estimate(self, model: ReducedModelSection, run: Artifact, samples: Samples) -> None:
        found = estimate_row(
            run,
            samples,
            self.full,
            self.probes,
            from_time=self.case.compare.from_time,
            compared=model.name,
            parameters=self.point.label,
            role=role_of(self.case, self.case.basis_for(model, self.point), self.point),
        )
        if found is not None:
            self.estimates.append(found)

    def _sampled(self, name: str, trajectory: Artifact) -> Samples:
        text = f"sample {name}, {self.point.label}"
        total = len(trajectory.dataset("time"))
        with self.workspace.context.report.details.progress(text, total) as advance:
            return sample_run(self.case, trajectory, self.sample, advance)

    def _compare_with_references(self, trajectory: Artifact) -> list[ProfileComparison]:
        text = f"reference profiles, {self.point.label}"
        total = len(profiles_of(self.case, self.point))
        if not total:
            return []
        with self.workspace.context.report.details.progress(text, total) as advance:
            return compare_with_references(self.case, self.point, trajectory, self.probes, advance)

    def _expanded(self, model: ReducedModelSection, run: Artifact) -> Samples:
        """Sample a run on the reference points by its modes' splines, unless it did so itself."""
        run.require(probe=len(self.probes.all))
        if (kept := read_probes(run)) is not None:
            return kept
        name = self.case.basis_for(model, self.point)
        basis, splines = read_modes(self.workspace, name, self._size(model))
        run.require(mode=basis.n_modes)
        times = run.read("time")
        mean = np.full(len(times), run.number("mean_density_fluctuation"))
        coordinates = run.read("generalized_coordinates")
        return expand(self.case, basis, splines, self.probes, times, coordinates, mean)

    def _describe_flow(self, name: str, run: FieldSeries, samples: Samples) -> None:
        """Describe the flow of a run in a scene with walls; one that failed at once has none."""
        if self.describe_flow and len(samples.time):
            bulk = bulk_velocity(self.case, samples, self.probes)
            self.flows.append(flow_row(name, self.point.label, run, samples, self.probes, bulk))

    def _add(
        self,
        samples: Samples,
        compared: str,
        against: str = "full",
        basis: str | None = None,
        n_modes: int | None = None,
        status: str = "complete",
    ) -> None:
        reference = self.exact if against == "exact" else self.full
        if reference is None:
            raise ValueError(f"there is no {against} solution to compare with")
        history = compare(
            samples,
            reference,
            self.probes,
            self.case.compare.from_time,
            assembly.longest_sound_period(self.case),
        )
        if status == "complete" and len(history.time) == 0:
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: there is no snapshot in "
                f"which the {against} solution varies over the probes"
            )
        described = error_row(
            history,
            compared=compared,
            against=against,
            parameters=self.point.label,
            role=role_of(self.case, basis, self.point) if basis is not None else "",
            n_modes=n_modes,
            status=status,
        )
        self.comparisons.append(Comparison(self._excerpt(samples), history, described))

    def _excerpt(self, samples: Samples) -> Excerpt:
        return Excerpt.of(samples, self.probes, self.middle)


def _best(workspace: Workspace, mapped: Artifact, name: str, size: int, probes: Probes) -> Samples:
    return sample_best(workspace.case, mapped, *read_modes(workspace, name, size), probes)
