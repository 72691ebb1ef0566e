"""Particles that are carried along by a reduced run, and don't act on it.

Their velocity is that of the modes' splines between the reference points (Eq. 3.20), with
coordinates that are a cubic spline between the snapshots of the run; their paths are advanced by
Runge-Kutta steps (Eq. 2.18 and 3.23, without shifting).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sphrom.artifacts import ArtifactWriter
from sphrom.online.fast_model import FastRun
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.sph.domain import Domain
from sphrom.sph.time_loop import runge_kutta_step
from sphrom.store.starts import start

Array = NDArray[np.float64]
Flow = Callable[[Array, float], Array]
"""From positions (n_particles, 2) [m] and a time [s], the velocity there (n_particles, 2) [m/s]."""


def modal_flow(splines: ModeSplines, time: Array, coordinates: Array) -> Flow:
    """Return the flow of a reduced run.

    Parameters
    ----------
    splines : of the modes' first field and velocity, and last of the basis's mean if it has one.
    time : (n_snapshots,) of two snapshots at least [s].
    coordinates : (n_snapshots, n_modes).

    Raises ValueError when the splines are not those of the coordinates.
    """
    n_snapshots, n_modes = coordinates.shape
    n_splined = splines.n_columns // 3
    if splines.n_columns % 3 or n_splined - n_modes not in (0, 1):
        raise ValueError(f"{splines.n_columns} splines are not those of {n_modes} modes")
    factors = np.hstack((coordinates, np.ones((n_snapshots, n_splined - n_modes))))
    between = CubicSpline(time, factors)

    def flow(position: Array, at: float) -> Array:
        combined = np.zeros((n_splined, 3, 2))
        combined[:, 1, 0] = combined[:, 2, 1] = between(at)
        velocity = splines.combine(combined.reshape(-1, 2)).values(position)
        # There are no splines deep in solids, where a substep may look before it is held back.
        return np.nan_to_num(velocity, nan=0.0)

    return flow


def path_lines(
    flow: Flow, start: Array, time: Array, steps_per_snapshot: int, domain: Domain
) -> Iterator[Array]:
    """Yield positions (n_particles, 2) [m] of particles at all times (n_snapshots,) [s].

    A particle that a step would take through a wall is held back: it goes along the wall, as far as
    the other component of its step takes it, or stays where it is.
    """
    position = domain.wrap(start)
    yield position
    for begin, end in pairwise(time):
        step = (end - begin) / steps_per_snapshot
        for substep in range(steps_per_snapshot):
            ahead = runge_kutta_step(flow, position, float(begin + substep * step), float(step))
            position = domain.wrap(_held_back(position, ahead, domain))
        yield position


def _held_back(position: Array, ahead: Array, domain: Domain) -> Array:
    """Return where particles are after a step from a position, none of them in a wall."""
    out = ahead.copy()
    for stopped in (slice(1, 2), slice(0, 1), slice(0, 2)):
        crossed = np.flatnonzero(~domain.contains(out))
        if crossed.size == 0:
            break
        out[crossed] = ahead[crossed]
        out[crossed, stopped] = position[crossed, stopped]
    return out


def write_tracers(run: FastRun, artifact: ArtifactWriter) -> None:
    """Carry the full run's particles along, and write their positions at all snapshots."""
    began, workspace = time.perf_counter(), run.model.workspace
    begin = start(workspace, workspace.case.plan.start_point(run.point)).position
    positions = artifact.stream("position", begin.shape, len(run.time))
    with workspace.context.report.progress(f"tracers of {run.name}", len(run.time)) as advance:
        for position in _positions(run, begin):
            positions.append(position)
            advance(1)
    artifact.annotate("timing/tracers", time.perf_counter() - began)


def _positions(run: FastRun, begin: Array) -> Iterator[Array]:
    if len(run.time) == 1:
        return iter((begin,))
    case = run.model.workspace.case
    # In a step a particle goes as far as its neighbour, which is well within a spline's cell.
    spacings = case.plan.steps.snapshot_interval * case.fluid.reference_speed
    n_steps = max(1, math.ceil(spacings / case.plan.particle_spacing))
    flow = modal_flow(run.model.splines(run.point), run.time, run.coordinates)
    return path_lines(flow, begin, run.time, n_steps, case.scene.domain)
