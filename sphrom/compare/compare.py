"""Stage `compare`: reduced against full runs, full against exact ones, and the share of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.artifacts.records.comparison import Ranges
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.answer import tell_answer
from sphrom.compare.costs import reduced_timing, undisturbed_seconds
from sphrom.compare.default_figures import draw_all
from sphrom.compare.measured import FULL, FullMeasured, Measured
from sphrom.compare.references import compare_with_references, profiles_of
from sphrom.compare.results import Comparison, Excerpt, PointResults, write_results
from sphrom.compare.rows import best_name, error_row, estimate_row
from sphrom.compare.show import show
from sphrom.compare.tables import FILE, MADE_BY, Tables
from sphrom.errors import ArtifactError, CaseError
from sphrom.metrics.discrepancy import instantaneous_range
from sphrom.metrics.histories import compare
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.series import FieldSeries, flow_row
from sphrom.online.rebuilt_run import RebuiltRun, read_probes
from sphrom.setup.assembly import role_of
from sphrom.setup.context import StageContext
from sphrom.setup.particles import sampler
from sphrom.store.bases import read_modes
from sphrom.store.sampling import (
    expand,
    probes_of,
    sample_best,
    sample_exact,
    sample_mapped,
    sample_run,
)
from sphrom.store.trained_operators import sized
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


class StoredRun:
    """The fields of a trajectory."""

    def __init__(self, trajectory: Artifact) -> None:
        self.time = trajectory.read("time")
        self.mass = trajectory.number("mass")
        self._velocities = trajectory.dataset("velocity")
        self._pressures = trajectory.dataset("pressure")

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] of one snapshot."""
        return np.asarray(self._velocities[snapshot]), np.asarray(self._pressures[snapshot])


def bulk_velocity(case: Case, samples: Samples, probes: Probes) -> float | None:
    """Return the mean of u over the scene's channel, and over time [m/s]; None without one."""
    channel = case.scene.channel
    if channel is None or not len(samples.time):
        return None
    inside = channel.contains(probes.grid)
    # Points on the channel's floor are left out of the grid: fluid is at rest there.
    step = case.scene.domain.lengths[1] / probes.grid_shape[0]
    height = channel.height * len(np.unique(probes.grid[inside, 0]))
    flux = samples.velocity[:, probes.on_grid][:, inside, 0].sum(axis=1) * step
    return float(flux.mean()) / height


def run(context: StageContext) -> None:
    """Compare all runs of the case, and tell the answer."""
    tables = make(context)
    if tables is not None:
        tell_answer(Workspace(context), tables)


def make(context: StageContext) -> Tables | None:
    """Compare all runs of the case; write `compare.h5`, `compare.json`, tables and plots.

    Returns the tables, empty where there is nothing to compare; None where the artifact was made
    before but its tables are damaged.
    """
    workspace = Workspace(context)
    if not _anything_to_compare(context.case):
        context.report.info(
            "nothing to compare: no reduced models, and no solution to compare with"
        )
        return Tables()
    _tell_unseen(workspace)
    target = workspace.comparison()
    if workspace.must_make(target):
        probes = probes_of(context.case)
        with workspace.create(target) as artifact:
            results = [
                _PointComparison(workspace, point, probes).compare()
                for point in context.case.plan.points
            ]
            for result in results:
                write_results(artifact, result, probes)
            tables = Tables.of(workspace, results)
            tables.write(workspace)
            if context.case.compare.plots:
                draw_all(workspace, results, probes)
    else:
        try:
            tables, _ = Tables.read(workspace)
        except ArtifactError:
            # Other programs may have changed the file: nothing else protects it.
            context.report.warn(
                f"{workspace.out / FILE} is missing or damaged; `{MADE_BY} --force` writes it again"
            )
            return None
    show(context.report, tables, context.report.details)
    return tables


def _tell_unseen(workspace: Workspace) -> None:
    """Tell which reduced runs have no full run to compare with."""
    case = workspace.case
    for model in case.rom:
        if not case.plan.ends_with_case(model):
            workspace.context.report.info(
                f"{model.name}: no full run to compare with until {model.until:g} s"
            )
            continue
        known = case.plan.points
        unseen = [point.label for point in case.plan.rom_points(model) if point not in known]
        if unseen:
            workspace.context.report.info(
                f"{model.name}: no full run to compare with at {', '.join(unseen)}"
            )


def _anything_to_compare(case: Case) -> bool:
    """Whether there are reduced models, solutions to compare with, or walls."""
    exact = case.compare.exact and case.scene.has_exact_solution
    return bool(case.rom) or exact or case.scene.domain.has_walls


class _PointComparison:
    """The comparisons at one parameter point, in the order in which tables show them."""

    def __init__(self, workspace: Workspace, point: ParameterPoint, probes: Probes) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.point = point
        self.probes = probes
        self.sample = sampler(self.case, probes.all)
        self.describe_flow = self.case.scene.domain.has_walls
        self.models = [
            model
            for model in self.case.rom
            if point in self.case.plan.rom_points(model) and self.case.plan.ends_with_case(model)
        ]
        with workspace.open(workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
            self.full = self._sampled("the full run", trajectory)
            self.middle = len(self.full.time) // 2
            flow = self.case.plan.flow(point).exact if self.case.compare.exact else None
            self.exact = None if flow is None else sample_exact(flow, probes, self.full.time)
            self.found = PointResults(
                point=point,
                models=[model.name for model in self.models],
                full=self._excerpt(self.full),
                exact=None if self.exact is None else self._excerpt(self.exact),
                ranges=Ranges(
                    time=self.full.time,
                    speed=instantaneous_range(self.full.speed),
                    pressure=instantaneous_range(self.full.pressure),
                ),
            )
            self.full_seconds = undisturbed_seconds(trajectory, self.case.plan.steps.n_steps)
            self._compare_with_references(trajectory)
            self._describe_flow("full", StoredRun(trajectory), self.full)
            self.measured = FullMeasured.of(self.case, point, trajectory)
            self.found.measured += self.measured.compared(FULL, self.measured.full)

    def compare(self) -> PointResults:
        """Return all comparisons at this point."""
        if self.exact is not None:
            self._add(self.full, "full", against="exact")
        if self.models:
            self._compare_limits()
        for model in self.models:
            self._compare_model(model)
        return self.found

    def _compare_limits(self) -> None:
        """Compare the mapped snapshots, and the best state in each basis."""
        with self.workspace.open(self.workspace.mapped(self.point)) as mapped:
            self._add(sample_mapped(self.case, mapped, self.sample), "map")
            of_map = Measured.mapped(self.case, mapped)
            self.found.measured += self.measured.compared("map", of_map)
            used = {(self.case.plan.basis_for(m, self.point), self._size(m)) for m in self.models}
            for name, size in sorted(used):
                modes = read_modes(self.workspace, name, size)
                best = sample_best(self.case, mapped, *modes, self.probes)
                self._add(best, best_name(name, size), basis=name, n_modes=size)
                self.found.measured += self.measured.best(self.workspace, mapped, name, size)

    def _size(self, model: ReducedModelSection) -> int:
        return sized(self.workspace, model, self.point).size

    def _compare_model(self, model: ReducedModelSection) -> None:
        target = self.workspace.reduced_run(model, self.point)
        basis, size = self.case.plan.basis_for(model, self.point), self._size(model)
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
                estimate = estimate_row(
                    trajectory,
                    reduced,
                    self.full,
                    self.probes,
                    from_time=self.case.compare.from_time,
                    compared=model.name,
                    parameters=self.point.label,
                    role=role_of(self.case, basis, self.point),
                )
                if estimate is not None:
                    self.found.estimates.append(estimate)
                own = Measured.of(self.case, trajectory)
                self.found.measured += self.measured.compared(model.name, own, basis, size)
                self.found.timings.append(
                    reduced_timing(self.case, model, self.point, trajectory, self.full_seconds)
                )
        for against in ("full", "exact") if self.exact is not None else ("full",):
            self._add(reduced, model.name, against, basis, size, status)

    def _sampled(self, name: str, trajectory: Artifact) -> Samples:
        text = f"sample {name}, {self.point.label}"
        total = len(trajectory.dataset("time"))
        with self.workspace.context.report.details.progress(text, total) as advance:
            return sample_run(self.case, trajectory, self.sample, advance)

    def _compare_with_references(self, trajectory: Artifact) -> None:
        text = f"reference profiles, {self.point.label}"
        if total := len(profiles_of(self.case, self.point)):
            with self.workspace.context.report.details.progress(text, total) as advance:
                self.found.references += compare_with_references(
                    self.case, self.point, trajectory, self.probes, advance
                )

    def _expanded(self, model: ReducedModelSection, run: Artifact) -> Samples:
        """Sample a run on the reference points by its modes' splines, unless it did so itself."""
        run.require(probe=len(self.probes.all))
        if (kept := read_probes(run)) is not None:
            return kept
        name = self.case.plan.basis_for(model, self.point)
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
            self.found.flows.append(
                flow_row(name, self.point.label, run, samples, self.probes, bulk)
            )

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
            self.case.plan.longest_sound_period,
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
        self.found.comparisons.append(Comparison(self._excerpt(samples), history, described))

    def _excerpt(self, samples: Samples) -> Excerpt:
        return Excerpt.of(samples, self.probes, self.middle)
