"""Reduced runs of a trade, timed and sampled, and the artifacts that they are made from.

A trade may weigh models that the case has no operators for, or none in that inner product. Their
artifacts lie in the trade's own folder, and are kept there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.metrics.measures import Quantities
from sphrom.metrics.samples import Probes, Samples
from sphrom.offline import fit_psi, operators, pod
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.online.particle_runs import build_model, closed
from sphrom.reduction import reference_model
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import MeasuredFields, sampler
from sphrom.sph import state_equation
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import Clock, Snapshot, TimeSteps, march
from sphrom.store.measured_quantities import totals
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import Candidate
from sphrom.trade.full import own_context
from sphrom.trade.report import FOLDER

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """One run, full or reduced; a run that became unstable has its time step alone."""

    time_step: float
    """[s]."""
    seconds: float | None = None
    """Of the run [s], without writing."""
    samples: Samples | None = None
    """At the probes."""
    estimates: Array | None = None
    """(n_snapshots, 2) of its errors, root mean squares [m/s] and [Pa], where there are any."""


def prepared(
    context: StageContext, inner_product: str, models: Sequence[ReducedModelSection]
) -> Workspace:
    """Return a workspace whose artifacts reduced models of a case can be made from.

    The workspace's case includes these models. Operators are projected where the case's lack some,
    and bases are made where the inner product is another.

    Raises ArtifactError when artifacts of the case are missing.
    """
    own = context.case
    case = own.model_copy(update={"rom": (*own.rom, *models)})
    if inner_product != own.basis.inner_product:
        section = case.basis.model_copy(update={"inner_product": inner_product})
        case = case.model_copy(update={"basis": section})
        place = context.out / FOLDER / inner_product
        folders: dict[str, Path] = dict.fromkeys(("basis", "spline", "operators"), place)
        wider = replace(context, case=case, folders=folders)
        for stage in (pod, fit_psi, operators):
            stage.run(own_context(wider))
        return Workspace(wider)
    workspace = Workspace(context)
    for target in (workspace.basis(), workspace.splines()):
        workspace.require(target)
    wider = replace(context, case=case)
    if not any(model.from_operators for model in models):
        return Workspace(wider)
    parts = ("reference_bases", "memory_models", "taught_bases")
    if any(getattr(case, part) != getattr(own, part) for part in parts):
        wider = replace(wider, folders={"operators": context.out / FOLDER})
        operators.run(own_context(wider))
    workspace = Workspace(wider)
    workspace.require(workspace.operators())
    return workspace


def reduced_runs(
    workspace: Workspace, candidate: Candidate, points: Sequence[ParameterPoint], probes: Probes
) -> Iterator[Outcome]:
    """Run a candidate at parameter points."""
    if candidate.model.on_particles:
        yield from (_run_on_particles(workspace, candidate, point, probes) for point in points)
    else:
        model = FastModel(workspace, candidate.model)
        yield from (_run_fast(model, candidate, point, probes) for point in points)


def _run_fast(
    model: FastModel, candidate: Candidate, point: ParameterPoint, probes: Probes
) -> Outcome:
    trade, reduced = model.workspace.case.trade, model.at(point)
    steps = reference_model.automatic(reduced).with_steps(candidate.step_factor)
    runs, seconds = steps.timed(trade.repeats)
    # Errors are estimated from training runs in steps as much smaller or larger as this run's.
    run = FastRun(model, point, reduced, runs, candidate.step_factor)
    if run.failure is not None:
        return Outcome(run.time_step)
    samples = run.sampled(probes)
    if trade.measure is not None:
        samples = replace(samples, measured=run.measured[trade.measure])
    estimate = run.estimate
    estimates = None if estimate is None else estimate.velocity_and_pressure
    return Outcome(run.time_step, seconds, samples, estimates)


def _run_on_particles(
    workspace: Workspace, candidate: Candidate, point: ParameterPoint, probes: Probes
) -> Outcome:
    """Run on particles once: its steps are many enough to be timed."""
    case = workspace.case
    plan = step_plan(case)
    every = max(1, round(plan.every / candidate.step_factor))
    time_step = plan.snapshot_interval / every
    n_steps = (plan.n_snapshots - 1) * every
    steps = TimeSteps(time_step, n_steps, every, plan.start_time, check_every=every)
    reduced, state = build_model(workspace, candidate.model, point)
    sample, clock = sampler(case, probes.all), Clock()
    measure = measuring(case, point, reduced.functional, case.trade.measure)
    fields: list[tuple[Array, Array]] = []
    measured: list[Quantities] = []
    text = f"{candidate.label}, {point.label}"
    with workspace.context.report.progress(text, n_steps) as advance:
        try:
            stepped = closed(case, candidate.model, reduced, state, plan.start_time)
            density = case.fluid.reference_density
            for step, now in march(stepped, state, steps, density, clock, advance):
                found = stepped.snapshot(now)
                measured.append(measure(found, steps.time(step)))
                kept = (found.density_fluctuation, found.velocity.T)
                fields.append(sample(found.position.T, *kept))
        except (UnstableError, ValueError, np.linalg.LinAlgError):
            return Outcome(time_step)
    densities, velocities = (np.array(each) for each in zip(*fields, strict=True))
    times = np.array([steps.time(step) for step in range(0, n_steps + 1, every)])
    pressures = state_equation.pressure(densities, case.sound_speed)
    over_time = {name: np.array([each[name] for each in measured]) for name in measured[0]}
    samples = Samples(times, velocities, pressures, over_time)
    return Outcome(time_step, clock.undisturbed(n_steps), samples)


def measuring(
    case: Case, point: ParameterPoint, functional: Functional, name: str | None
) -> Callable[[Snapshot, float], Quantities]:
    """Return a function that measures a snapshot at a time [s]; without a name it gives {}.

    It raises UnstableError where too few particles are near a place.
    """
    forces, fields = particles.wall_forces(case, point, functional), MeasuredFields.of(case)

    def measure(snapshot: Snapshot, time: float) -> Quantities:
        if name is None:
            return {}
        if forces is not None and name in case.scene.measured_walls:
            state = np.vstack((snapshot.position, snapshot.density_fluctuation, snapshot.velocity))
            loads = forces(state, time)[name]
            return {quantity: values[0] for quantity, values in totals(loads[None]).items()}
        assert fields is not None  # The case measures by that name.
        found = (snapshot.position.T, snapshot.density_fluctuation, snapshot.velocity.T)
        return fields(*found)[name]

    return measure
