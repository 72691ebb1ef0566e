"""How long stages take on this machine, from some steps of a full run that are timed here.

What a stage takes in steps was measured on the three demo cases. It is right within a factor of two
or so, as far as the stage's time is in proportion to the number of particles.
"""

from __future__ import annotations

import time

import numpy as np

from sphrom.case.geometry import n_particles, nearest_fitting_resolution
from sphrom.case.models import Case
from sphrom.case.plan import step_plan, substeps
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.errors import UnstableError
from sphrom.setup import assembly, particles
from sphrom.sph.functional import FullModel
from sphrom.sph.time_loop import TimeSteps, watched_step

TIMED_STEPS, TIMED_SECONDS, TIMED_PARTICLES = 20, 2.0, 20_000
"""At most. Larger cases are timed coarser: a step's time is in proportion to the particles."""
SNAPSHOT_STEPS, BASIS_STEPS, MODE_STEPS, REDUCED_STEPS = 0.25, 20.0, 5.0, 2.0
"""Steps of the full model that it takes to map or sample a snapshot, to make a basis with its
splines, to project a mode's operators, and to evaluate a reduced model's rates."""
FAST_SECONDS, SWEPT_SECONDS = 0.1, 5e-3
"""A run from operators with its file, and one in a sweep [s]."""
FIGURES_SECONDS = 4.0
"""Drawing the figures of a parameter point [s]."""


def seconds_per_step(case: Case) -> float | None:
    """Return the time that a step of the case's first full run takes [s].

    None where the first steps are unstable, or no coarser grid fits a case that is too large.
    """
    timed = _coarser(case)
    if timed is None:
        return None
    point = timed.points[0]
    position = assembly.domain(timed).fill(timed.particle_spacing)
    fluctuation, velocity = assembly.initial_fields(timed, point, position)
    state = np.vstack((position.T, fluctuation, velocity.T))
    model = FullModel(particles.functional(timed, point))
    steps = TimeSteps(step_plan(timed).time_step, TIMED_STEPS, 1)
    try:
        model.rates(state, 0.0)  # compiles
        started, taken, number = time.perf_counter(), 0.0, 0
        while number < TIMED_STEPS and taken < TIMED_SECONDS:
            number += 1
            state = watched_step(model.rates, state, steps, number)
            taken = time.perf_counter() - started
    except (UnstableError, ValueError):
        return None
    return taken / number * n_particles(case) / n_particles(timed)


def _coarser(case: Case) -> Case | None:
    """Return the case with so few particles that its steps are short, if walls fit them."""
    number = n_particles(case)
    if number <= TIMED_PARTICLES:
        return case
    resolution = max(8, int(case.discretization.resolution * (TIMED_PARTICLES / number) ** 0.5))
    fitting = nearest_fitting_resolution(_at_resolution(case, resolution))
    return None if fitting is None else _at_resolution(case, fitting)


def _at_resolution(case: Case, resolution: int) -> Case:
    section = case.discretization.model_copy(update={"resolution": resolution})
    free = case.time.model_copy(update={"step": "auto"})
    return case.model_copy(update={"discretization": section, "time": free})


def full_seconds(case: Case, step: float, n_runs: int) -> float:
    """Return how long full runs take [s], a step taking `step` [s]."""
    plan = step_plan(case)
    return step * (plan.n_steps + plan.n_spin_up_steps) * n_runs


def wall_times(case: Case, step: float) -> dict[str, float]:
    """Return how long each stage takes [s] by its name, a step of the full model `step` [s]."""
    snapshot, n_points = SNAPSHOT_STEPS * step * step_plan(case).n_snapshots, len(case.points)
    times = {"fom": full_seconds(case, step, n_points)}
    if case.rom:
        most = max((_n_modes(case, model) for model in case.rom if model.from_operators), default=0)
        times |= {
            "map": snapshot * n_points,
            "pod": BASIS_STEPS * step * len(case.bases),
            "operators": MODE_STEPS * step * most * len(case.reference_bases),
            "rom": sum(
                _reduced_seconds(case, model, step) * len(case.rom_points(model))
                for model in case.rom
            ),
        }
    # The full run, the exact flow and the best of a basis are sampled beside the reduced runs.
    n_runs = sum(len(case.rom_points(model)) for model in case.rom)
    times["compare"] = snapshot * (n_runs + (3 if case.rom else 1) * n_points)
    times["compare"] += FIGURES_SECONDS * n_points * case.compare.plots
    return times


def _n_modes(case: Case, model: ReducedModelSection) -> int:
    """Return the modes of a model, as many as it may have where training runs choose."""
    return case.n_modes if model.n_modes == AUTO else model.size


def _reduced_seconds(case: Case, model: ReducedModelSection, step: float) -> float:
    """Return how long a run of a reduced model takes [s]."""
    if model.from_operators:
        return FAST_SECONDS
    n_steps = substeps(case, model.time_step) * (step_plan(case).n_snapshots - 1)
    return REDUCED_STEPS * step * n_steps


def sweep_seconds(case: Case, step: float) -> float:
    """Return how long the runs of a case's sweep take one after the other [s]."""
    model, number = sweep_model(case), len(sweep_points(case))
    if model is None:
        return full_seconds(case, step, number)
    each = SWEPT_SECONDS if model.from_operators else _reduced_seconds(case, model, step)
    return each * number
