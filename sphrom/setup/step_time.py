"""What a step of a full run takes on this machine, measured on a few."""

from __future__ import annotations

import time

import numpy as np

from sphrom.case.geometry import n_particles, nearest_fitting_resolution
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.errors import UnstableError
from sphrom.setup import assembly, particles
from sphrom.sph.full_model import FullModel
from sphrom.sph.time_loop import TimeSteps, watched_step

MOST_STEPS = 20
LONGEST = 2.0
"""No step is begun after so many seconds."""
MOST_PARTICLES = 20_000
"""Larger cases are timed coarser: a step's time is in proportion to the particles."""


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
    steps = TimeSteps(step_plan(timed).time_step, MOST_STEPS, 1)
    try:
        model.rates(state, 0.0)  # compiles
        started, taken, number = time.perf_counter(), 0.0, 0
        while number < MOST_STEPS and taken < LONGEST:
            number += 1
            state = watched_step(model.rates, state, steps, number)
            taken = time.perf_counter() - started
    except (UnstableError, ValueError):
        return None
    return taken / number * n_particles(case) / n_particles(timed)


def _coarser(case: Case) -> Case | None:
    """Return the case with so few particles that its steps are short, if walls fit them."""
    number = n_particles(case)
    if number <= MOST_PARTICLES:
        return case
    resolution = max(8, int(case.discretization.resolution * (MOST_PARTICLES / number) ** 0.5))
    coarse = _at_resolution(case, resolution)
    fitting = nearest_fitting_resolution(coarse)
    return None if fitting is None else _at_resolution(case, fitting)


def _at_resolution(case: Case, resolution: int) -> Case:
    section = case.discretization.model_copy(update={"resolution": resolution})
    free = case.time.model_copy(update={"step": "auto"})
    return case.model_copy(update={"discretization": section, "time": free})
