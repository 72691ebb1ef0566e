"""Reduced runs of a trade, timed and sampled, and what their models cost once."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.reduction.online import ParticleModel, automatic_memory_length
from sphrom.reduction.polynomial_model import PolynomialModel, Runs, Schedule, steps_per_snapshot
from sphrom.reduction.projection import AdjointPetrovGalerkin
from sphrom.reduction.trial_basis import kept_modes, truncate
from sphrom.sph import state_equation
from sphrom.stages.fit_psi import read_splines, select, spline_columns
from sphrom.stages.pod import read_basis
from sphrom.stages.reference_runs import ReferenceModel, build_reference_model
from sphrom.stages.rom import SteppedModel, build_model
from sphrom.stages.sampling import Probes, Samples, expand, sampler
from sphrom.stages.trade_candidates import Candidate, basis_name
from sphrom.stages.trajectory import Clock, Steps, march
from sphrom.stages.workspace import Target, Workspace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """What one reduced run gave and took."""

    time_step: float
    """[s]."""
    seconds: float | None
    """Of the run [s], without writing; None where it became unstable."""
    samples: Samples | None
    """At the probes; None where it became unstable."""


class ReducedRuns:
    """Runs reduced models and samples them; keeps what several of them share."""

    def __init__(self, workspace: Workspace, probes: Probes) -> None:
        self._workspace = workspace
        self._probes = probes
        self._whole = read_basis(workspace, basis_name(workspace.case))
        self._splines = read_splines(workspace, basis_name(workspace.case))

    def reference_model(self, model: ReducedModelSection, point: ParameterPoint) -> ReferenceModel:
        """Return a model on the reference points at a parameter point."""
        return build_reference_model(self._workspace, model, point)

    def expanded(
        self, reduced: ReferenceModel, model: ReducedModelSection, times: Array, coordinates: Array
    ) -> Samples:
        """Sample coordinates (n_snapshots, n_modes) at the probes."""
        kept = spline_columns(self._whole, kept_modes(self._whole, model.n_modes))
        return expand(
            self._workspace.case,
            truncate(self._whole, model.n_modes),
            select(self._splines, kept),
            self._probes,
            times,
            coordinates,
            np.full(len(times), reduced.mean_density_fluctuation),
        )

    def training_norm(self, n_modes: int) -> float:
        """Return the largest norm of training snapshots' coordinates, as operators hold some."""
        name = basis_name(self._workspace.case)
        with self._workspace.open(self._workspace.operators()) as artifact:
            states = artifact.read(f"bases/{name}/states")[:, kept_modes(self._whole, n_modes)]
        return float(np.linalg.norm(states, axis=1).max())

    def run(self, candidate: Candidate, points: Sequence[ParameterPoint]) -> Iterator[Outcome]:
        """Run a candidate at parameter points."""
        on_particles = candidate.model.frame == "particles"
        run = self._run_on_particles if on_particles else self._run_on_reference
        for point in points:
            yield run(candidate, point)

    def _run_on_reference(self, candidate: Candidate, point: ParameterPoint) -> Outcome:
        case, model = self._workspace.case, candidate.model
        plan = step_plan(case)
        reduced = self.reference_model(model, point)
        every = steps_per_snapshot(plan.snapshot_interval, reduced.step_limit)
        every = max(1, round(every / candidate.step_factor))
        schedule = Schedule(
            plan.snapshot_interval, plan.n_snapshots, plan.start_time, reduced.largest_norm
        )
        runs, seconds = timed(reduced, schedule, every, case.trade.repeats)
        if not np.isnan(runs.diverged_at[0]):
            return Outcome(float(runs.time_step[0]), None, None)
        samples = self.expanded(reduced, model, runs.time, runs.coordinates[0])
        return Outcome(float(runs.time_step[0]), seconds, samples)

    def _run_on_particles(self, candidate: Candidate, point: ParameterPoint) -> Outcome:
        """Run on particles once: it takes long enough to be timed."""
        case = self._workspace.case
        plan = step_plan(case)
        every = max(1, round(plan.every / candidate.step_factor))
        time_step = plan.snapshot_interval / every
        n_steps = (plan.n_snapshots - 1) * every
        steps = Steps(time_step, n_steps, every, every, start_time=plan.start_time)
        reduced, state = build_model(self._workspace, candidate.model, point)
        sample, clock, kept = sampler(case, self._probes.all), Clock(), []
        text = f"{candidate.label}, {point.label}"
        with self._workspace.context.report.progress(text, n_steps) as advance:
            try:
                stepped = SteppedModel(_closed(reduced, candidate.model, state, plan.start_time))
                density = case.fluid.reference_density
                for _, now in march(stepped, state, steps, density, clock, advance):
                    snapshot = stepped.snapshot(now)
                    kept.append(
                        sample(
                            snapshot.position.T, snapshot.density_fluctuation, snapshot.velocity.T
                        )
                    )
            except (UnstableError, ValueError, np.linalg.LinAlgError):
                return Outcome(time_step, None, None)
        densities, velocities = (np.array(each) for each in zip(*kept, strict=True))
        times = np.array([steps.time(step) for step in range(0, n_steps + 1, every)])
        pressures = state_equation.pressure(densities, case.sound_speed)
        return Outcome(time_step, clock.seconds, Samples(times, velocities, pressures))


def timed(
    reduced: ReferenceModel, schedule: Schedule, every: int, repeats: int
) -> tuple[Runs, float]:
    """Run a model on the reference points, and return the median of what it took [s].

    The first run, which may have to compile, isn't timed.
    """
    system = PolynomialModel([reduced.polynomial])
    start = reduced.start[None]
    seconds = []
    for _ in range(repeats + 1):
        started = time.perf_counter()
        runs = system.run(start, schedule, [every], reduced.amplitude)
        seconds.append(time.perf_counter() - started)
    return runs, float(np.median(seconds[1:]))


def _closed(
    reduced: ParticleModel, model: ReducedModelSection, state: Array, start_time: float
) -> ParticleModel:
    """Return a model on particles with its closure, if it has one."""
    if model.projection == "galerkin":
        return reduced
    memory = automatic_memory_length(reduced, state, start_time)
    return ParticleModel(
        reduced.functional,
        reduced.modes,
        reduced.product,
        n_modes=reduced.n_modes,
        advection=reduced.advection,
        gauge=reduced.gauge,
        closure=AdjointPetrovGalerkin(memory, model.jacobian_step),
    )


def offline_seconds(workspace: Workspace, frame: str) -> tuple[float, float]:
    """Return what a reduced model costs once [s]: all of it, and the full runs it learns from."""
    points = workspace.case.bases[basis_name(workspace.case)]
    runs = {run.path: run for point in points for run in _with_starts(workspace, point)}
    training = sum(_wall_seconds(workspace, run) for run in runs.values())
    stages = [workspace.mapped(point) for point in points]
    stages += [workspace.basis(), workspace.splines()]
    if frame == "reference":
        stages.append(workspace.operators())
    return training + sum(_wall_seconds(workspace, stage) for stage in stages), training


def _with_starts(workspace: Workspace, point: ParameterPoint) -> list[Target]:
    """Return a full run, and what it starts from."""
    run = workspace.full_run(point)
    return [run, *run.parents.values()]


def _wall_seconds(workspace: Workspace, target: Target) -> float:
    with workspace.open(target) as artifact:
        return artifact.number("wall_seconds")
