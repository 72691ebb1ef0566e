"""Fields of runs at fixed probes: the centreline and a grid, on which runs are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.metrics.probes import grid_points, vertical_centreline
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.spline import LocalSplines
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.scenes.taylor_green import TaylorGreen
from sphrom.sph import state_equation
from sphrom.stages import assembly
from sphrom.stages.map import snapshot_fields

Array = NDArray[np.float64]

SAMPLING_RATIO = 2.0
"""Smoothing length of the moving least squares that sample particles, over the spacing."""


@dataclass(frozen=True)
class Probes:
    """Where runs are compared [m]."""

    line: Array
    """(n_line, 2), the vertical centreline."""
    grid: Array
    """(n_grid, 2), row by row."""
    grid_shape: tuple[int, int]

    @property
    def all(self) -> Array:
        """The line's points, then the grid's."""
        return np.concatenate((self.line, self.grid))


@dataclass(frozen=True)
class Samples:
    """Velocity and pressure at the probes over time."""

    time: Array
    """(n_snapshots,) [s]."""
    velocity: Array
    """(n_snapshots, n_probes, 2) [m/s]."""
    pressure: Array
    """(n_snapshots, n_probes) [Pa]."""

    @property
    def speed(self) -> Array:
        """The velocity's magnitude [m/s]."""
        return np.asarray(np.linalg.norm(self.velocity, axis=2))

    def until(self, n_snapshots: int) -> Samples:
        """Return the first snapshots."""
        return Samples(
            self.time[:n_snapshots], self.velocity[:n_snapshots], self.pressure[:n_snapshots]
        )


def probes_of(case: Case) -> Probes:
    """Return where the runs of a case are compared."""
    box = assembly.domain(case)
    shape = (case.compare.grid, case.compare.grid)
    return Probes(
        line=vertical_centreline(box.lower, box.upper, case.compare.line_points),
        grid=grid_points(box.lower, box.upper, shape),
        grid_shape=shape,
    )


def sampler(case: Case, probes: Probes) -> ReferenceMap:
    """Return the interpolation that samples particles: the accurate one, whatever the case maps."""
    return ReferenceMap(
        probes.all,
        assembly.domain(case),
        particle_spacing=case.particle_spacing,
        smoothing_length=SAMPLING_RATIO * case.particle_spacing,
    )


def sample_run(
    case: Case, trajectory: Artifact, sample: ReferenceMap, advance: Callable[[int], None]
) -> Samples:
    """Sample a trajectory, full or reduced; one that became unstable as far as that can be done."""
    times = trajectory.read("time")
    velocities = np.empty((len(times), sample.n_points, 2))
    pressures = np.empty((len(times), sample.n_points))
    for snapshot in range(len(times)):
        try:
            density, velocities[snapshot] = sample(*snapshot_fields(trajectory, snapshot))
        except ValueError:
            if trajectory.text("status") == "complete":
                raise
            return Samples(times[:snapshot], velocities[:snapshot], pressures[:snapshot])
        pressures[snapshot] = state_equation.pressure(density, case.sound_speed)
        advance(1)
    return Samples(times, velocities, pressures)


def sample_exact(flow: TaylorGreen, probes: Probes, times: Array) -> Samples:
    """Evaluate an exact solution."""
    return Samples(
        times,
        np.array([flow.velocity(probes.all, float(t)) for t in times]),
        np.array([flow.pressure(probes.all, float(t)) for t in times]),
    )


def sample_mapped(case: Case, mapped: Artifact, sample: ReferenceMap) -> Samples:
    """Sample mapped snapshots: what the map alone costs."""
    position = mapped.read("reference_position")
    velocities, pressures = [], []
    densities, fields = mapped.dataset("density_fluctuation"), mapped.dataset("velocity")
    for snapshot in range(len(densities)):
        density, velocity = sample(position, densities[snapshot], fields[snapshot])
        velocities.append(velocity)
        pressures.append(state_equation.pressure(density, case.sound_speed))
    return Samples(mapped.read("time"), np.array(velocities), np.array(pressures))


def sample_best(
    case: Case, mapped: Artifact, basis: TrialBasis, splines: LocalSplines, probes: Probes
) -> Samples:
    """Sample the projection of mapped snapshots onto a basis: the best that it can do."""
    densities, velocities = mapped.dataset("density_fluctuation"), mapped.dataset("velocity")
    values = splines.values(probes.all).reshape(len(probes.all), -1, 3)
    sampled = []
    for snapshot in range(len(densities)):
        coordinates = project(basis, densities[snapshot], velocities[snapshot])
        if basis.offset is not None:
            coordinates = np.append(coordinates, 1.0)
        sampled.append(np.einsum("pmf,m->pf", values, coordinates))
    fields = np.array(sampled)
    density = basis.inner_product.density_fluctuation(fields[..., 0])
    return Samples(
        mapped.read("time"), fields[..., 1:], state_equation.pressure(density, case.sound_speed)
    )
