"""Reduced runs of a trade, timed and sampled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.online import evaluated_runs
from sphrom.online.error_estimates import estimated_errors
from sphrom.online.reference_model import ReferenceModel, ReferenceModels, build_reference_model
from sphrom.online.reference_runs import estimated_run
from sphrom.online.rom import build_model
from sphrom.online.stepping import (
    automatic_stepping,
    automatic_steps,
    runge_kutta,
    schedule_of,
    timed,
    whole_steps,
)
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.online import ParticleModel, automatic_memory_length
from sphrom.reduction.particle_run import SteppedModel, with_closure
from sphrom.reduction.polynomial_model import Runs, Schedule
from sphrom.reduction.trial_basis import TrialBasis, kept_modes
from sphrom.sph import state_equation
from sphrom.sph.time_loop import Clock, Steps, march
from sphrom.store.basis import read_basis
from sphrom.store.sampling import expand, sampler
from sphrom.store.splines import read_splines
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import Candidate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """One reduced run; a run that became unstable has its time step alone."""

    time_step: float
    """[s]."""
    seconds: float | None = None
    """Of the run [s], without writing."""
    samples: Samples | None = None
    """At the probes."""
    estimates: Array | None = None
    """(n_snapshots, 2) of its errors, root mean squares [m/s] and [Pa], where there are any."""


class ReducedRuns:
    """Runs reduced models and samples them; keeps the bases that they share."""

    def __init__(self, workspace: Workspace, probes: Probes) -> None:
        self._workspace = workspace
        self._probes = probes
        self._bases: dict[str, tuple[TrialBasis, ModeSplines]] = {}

    def _basis(self, name: str) -> tuple[TrialBasis, ModeSplines]:
        if name not in self._bases:
            read = read_basis(self._workspace, name), read_splines(self._workspace, name)
            self._bases[name] = read
        return self._bases[name]

    def expanded(
        self, reduced: ReferenceModel, basis: str, times: Array, coordinates: Array
    ) -> Samples:
        """Sample coordinates (n_snapshots, n_modes) in a basis at the probes."""
        whole, splines = self._basis(basis)
        n_modes = reduced.basis.n_modes // len(reduced.basis.singular_values)
        return expand(
            self._workspace.case,
            reduced.basis,
            first_modes(splines, whole, n_modes),
            self._probes,
            times,
            coordinates,
            np.full(len(times), reduced.mean_density_fluctuation),
        )

    def training_norm(self, basis: str, n_modes: int) -> float:
        """Return the largest norm of training snapshots' coordinates, as operators have some."""
        modes = kept_modes(self._basis(basis)[0], n_modes)
        with self._workspace.open(self._workspace.operators()) as artifact:
            states = artifact.read(f"bases/{basis}/states")[:, modes]
        return float(np.linalg.norm(states, axis=1).max())

    def run(self, candidate: Candidate, points: Sequence[ParameterPoint]) -> Iterator[Outcome]:
        """Run a candidate at parameter points."""
        on_particles = candidate.model.on_particles
        run = self._run_on_particles if on_particles else self._run_on_reference
        for point in points:
            yield run(candidate, point)

    def _run_on_reference(self, candidate: Candidate, point: ParameterPoint) -> Outcome:
        case, model = self._workspace.case, candidate.model
        plan = step_plan(case)
        reduced = build_reference_model(self._workspace, model, point)
        with_operators = model.evaluation == "operators"
        stepping = (
            automatic_stepping(reduced, plan)
            if with_operators
            else runge_kutta(reduced, automatic_steps(reduced, plan))
        )
        n_steps = max(1, round(stepping.n_steps / candidate.step_factor))
        schedule = schedule_of(reduced, plan)
        if with_operators:
            runs, seconds = timed(reduced, schedule, stepping.system, n_steps, case.trade.repeats)
        else:
            runs, seconds = self._evaluated(candidate, point, reduced, schedule, n_steps)
        time_step = float(runs.time_step[0])
        if not np.isnan(runs.diverged_at[0]):
            return Outcome(time_step)
        name = case.basis_for(model, point)
        samples = self.expanded(reduced, name, runs.time, runs.coordinates[0])
        estimates = None
        if with_operators:
            # From training runs in steps as much smaller or larger as this run's.
            models = ReferenceModels(self._workspace, model)
            factor = candidate.step_factor
            run = estimated_run(self._workspace, models, point, reduced, runs, factor)
            estimates = estimated_errors(self._workspace, run)
        return Outcome(time_step, seconds, samples, estimates)

    def _evaluated(
        self,
        candidate: Candidate,
        point: ParameterPoint,
        reduced: ReferenceModel,
        schedule: Schedule,
        n_steps: int,
    ) -> tuple[Runs, float]:
        """Run with rates from all points, again where that is short."""
        evaluation = evaluated_runs.evaluation(
            self._workspace, candidate.model, point, reduced.basis, reduced.amplitude
        )
        if evaluation is None:
            raise ValueError("a model with operators alone has no evaluation")
        text, total = f"{candidate.label}, {point.label}", schedule.n_snapshots - 1
        every = whole_steps(n_steps, schedule.n_snapshots) // max(1, total)
        with self._workspace.context.report.progress(text, total) as advance:
            return evaluated_runs.timed(evaluation, reduced.start, schedule, every, advance)

    def _run_on_particles(self, candidate: Candidate, point: ParameterPoint) -> Outcome:
        """Run on particles once: its steps are many enough to be timed."""
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
                    fields = (snapshot.density_fluctuation, snapshot.velocity.T)
                    kept.append(sample(snapshot.position.T, *fields))
            except (UnstableError, ValueError, np.linalg.LinAlgError):
                return Outcome(time_step)
        densities, velocities = (np.array(each) for each in zip(*kept, strict=True))
        times = np.array([steps.time(step) for step in range(0, n_steps + 1, every)])
        pressures = state_equation.pressure(densities, case.sound_speed)
        return Outcome(time_step, clock.undisturbed(n_steps), Samples(times, velocities, pressures))


def _closed(
    reduced: ParticleModel, model: ReducedModelSection, state: Array, start_time: float
) -> ParticleModel:
    """Return a model on particles with its closure, if it has one."""
    if model.projection == "galerkin":
        return reduced
    memory = automatic_memory_length(reduced, state, start_time)
    return with_closure(reduced, memory, model.jacobian_step)
