"""Reduced runs of a trade, timed and sampled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.online.particle_runs import build_model, closed
from sphrom.reduction import integrators
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.particle_run import SteppedModel
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis, kept_modes
from sphrom.setup.measured_fields import sampler
from sphrom.sph import state_equation
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.basis import read_basis
from sphrom.store.splines import read_splines
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import Candidate
from sphrom.trade.measured_states import MeasuredStates

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

    def splines(self, reduced: ReferenceModel, basis: str) -> ModeSplines:
        """Return the splines of a model's modes, of which bases are read once."""
        whole, splines = self._basis(basis)
        n_modes = reduced.basis.n_modes // len(reduced.basis.singular_values)
        return first_modes(splines, whole, n_modes)

    def training_norm(self, basis: str, n_modes: int) -> float:
        """Return the largest norm of training snapshots' coordinates, as operators have some."""
        modes = kept_modes(self._basis(basis)[0], n_modes)
        with self._workspace.open(self._workspace.operators()) as artifact:
            states = artifact.read(f"bases/{basis}/states")[:, modes]
        return float(np.linalg.norm(states, axis=1).max())

    def run(self, candidate: Candidate, points: Sequence[ParameterPoint]) -> Iterator[Outcome]:
        """Run a candidate at parameter points."""
        if candidate.model.on_particles:
            yield from (self._run_on_particles(candidate, point) for point in points)
            return
        model = FastModel(self._workspace, candidate.model)
        yield from (self._run_from_operators(model, candidate, point) for point in points)

    def _run_from_operators(
        self, model: FastModel, candidate: Candidate, point: ParameterPoint
    ) -> Outcome:
        trade, reduced = self._workspace.case.trade, model.at(point)
        steps = integrators.automatic(reduced).with_steps(candidate.step_factor)
        runs, seconds = steps.timed(trade.repeats)
        # Errors are estimated from training runs in steps as much smaller or larger as this run's.
        run = FastRun(model, point, reduced, runs, candidate.step_factor)
        if run.failure is not None:
            return Outcome(run.time_step)
        splines = self.splines(reduced, model.basis_at(point))
        samples = run.sampled(self._probes, splines)
        if trade.measure is not None:
            samples = replace(samples, measured=run.measured[trade.measure])
        estimates = None if run.estimate is None else run.estimate.velocity_and_pressure
        return Outcome(run.time_step, seconds, samples, estimates)

    def _run_on_particles(self, candidate: Candidate, point: ParameterPoint) -> Outcome:
        """Run on particles once: its steps are many enough to be timed."""
        case = self._workspace.case
        plan = step_plan(case)
        every = max(1, round(plan.every / candidate.step_factor))
        time_step = plan.snapshot_interval / every
        n_steps = (plan.n_snapshots - 1) * every
        steps = TimeSteps(time_step, n_steps, every, plan.start_time, check_every=every)
        reduced, state = build_model(self._workspace, candidate.model, point)
        sample, clock, kept = sampler(case, self._probes.all), Clock(), []
        measuring = MeasuredStates.of(case, point, reduced.functional, case.trade.measure)
        text = f"{candidate.label}, {point.label}"
        with self._workspace.context.report.progress(text, n_steps) as advance:
            try:
                ready = closed(case, candidate.model, reduced, state, plan.start_time)
                stepped = SteppedModel(ready)
                density = case.fluid.reference_density
                for step, now in march(stepped, state, steps, density, clock, advance):
                    snapshot = stepped.snapshot(now)
                    measuring.add(snapshot, steps.time(step))
                    fields = (snapshot.density_fluctuation, snapshot.velocity.T)
                    kept.append(sample(snapshot.position.T, *fields))
            except (UnstableError, ValueError, np.linalg.LinAlgError):
                return Outcome(time_step)
        densities, velocities = (np.array(each) for each in zip(*kept, strict=True))
        times = np.array([steps.time(step) for step in range(0, n_steps + 1, every)])
        pressures = state_equation.pressure(densities, case.sound_speed)
        samples = Samples(times, velocities, pressures, measuring.over_time())
        return Outcome(time_step, clock.undisturbed(n_steps), samples)
