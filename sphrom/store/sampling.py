"""Fields of runs at fixed probes: a line and a grid, on which runs are compared, and stations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.kernels.support import SUPPORT_RATIO
from sphrom.metrics.probes import grid_points, vertical_line
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.trial_basis import TrialBasis, mean_density_fluctuation, project
from sphrom.scenes.scene import ExactFlow
from sphrom.setup import assembly
from sphrom.sph import state_equation
from sphrom.sph.domain import Domain
from sphrom.store.trajectory import snapshot_fields

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ON_WALL = 1e-6
"""Points nearer to a wall than this part of the spacing are on it."""
ROUNDING = 1e-9
"""Slack for what is equal but for rounding."""
SAMPLING_RATIO = 2.0
"""Smoothing length of the moving least squares that sample particles, over the spacing."""


@dataclass(frozen=True)
class Probes:
    """Where runs are compared [m]: all of it in the fluid."""

    line: Array
    """(n_line, 2), a vertical line, the centreline unless the case chooses another."""
    grid: Array
    """(n_grid, 2), those points of a regular grid that are in the fluid, row by row."""
    grid_shape: tuple[int, int]
    """Rows and columns of the whole grid."""
    in_fluid: Mask | None = None
    """(n_rows n_columns,) which points of the whole grid are in the fluid; None is all."""
    near_walls: Mask | None = None
    """(n_grid,) which points are nearer to a wall than a support radius; None without walls."""
    stations: Array = field(default_factory=lambda: np.empty((0, 2)))
    """(n_stations, 2), where histories are kept; none in most scenes."""

    @property
    def all(self) -> Array:
        """The line's points, then the grid's, then the stations."""
        return np.concatenate((self.line, self.grid, self.stations))

    @property
    def on_line(self) -> slice:
        """Where the line's points are among all."""
        return slice(0, len(self.line))

    @property
    def on_grid(self) -> slice:
        """Where the grid's points are among all."""
        return slice(len(self.line), len(self.line) + len(self.grid))

    @property
    def at_stations(self) -> slice:
        """Where the stations are among all."""
        return slice(len(self.line) + len(self.grid), None)

    def picture(self, values: Array) -> Array:
        """Return values (n_grid,) as a picture (n_rows, n_columns), NaN outside of the fluid."""
        if self.in_fluid is None:
            return values.reshape(self.grid_shape)
        whole = np.full(self.in_fluid.size, np.nan)
        whole[self.in_fluid] = values
        return whole.reshape(self.grid_shape)


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
    """Return where the runs of a case are compared.

    Raises CaseError when no fluid is on the line.
    """
    domain = assembly.domain(case)
    x = case.probe_line
    spans = domain.sections(x)
    if not spans:
        raise CaseError(f"compare.line: there is no fluid at x = {x:g} m")
    shape = _grid_shape(domain, case.compare.grid)
    points = grid_points(domain.lower, domain.upper, shape)
    in_fluid, near_walls = None, None
    if domain.has_walls:
        # A point on a wall, as a grid can have on edges within the box, is of no fluid.
        distance = domain.wall_distance(points)
        in_fluid = distance > ON_WALL * case.particle_spacing
        near_walls = distance[in_fluid] < SUPPORT_RATIO * case.smoothing_length
    return Probes(
        line=vertical_line(x, spans, case.compare.line_points),
        grid=points if in_fluid is None else points[in_fluid],
        grid_shape=shape,
        in_fluid=in_fluid,
        near_walls=near_walls,
        stations=case.scene.stations(case.probe_line),
    )


def _grid_shape(domain: Domain, n_points: int) -> tuple[int, int]:
    """Return rows and columns of a grid with so many points along the longer side of the box."""
    longer = max(domain.lengths)
    columns, rows = (max(2, round(n_points * length / longer)) for length in domain.lengths)
    return rows, columns


def sampler(case: Case, points: Array) -> ReferenceMap:
    """Return the interpolation that samples particles at points (n_points, 2) [m].

    It is the accurate one, whatever the case maps with.
    """
    return ReferenceMap(
        points,
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
            velocities[snapshot], pressures[snapshot] = sample_snapshot(
                case, trajectory, sample, snapshot
            )
        except ValueError:
            if trajectory.text("status") == "complete":
                raise
            return Samples(times[:snapshot], velocities[:snapshot], pressures[:snapshot])
        advance(1)
    return Samples(times, velocities, pressures)


def sample_snapshot(
    case: Case, trajectory: Artifact, sample: ReferenceMap, snapshot: int
) -> tuple[Array, Array]:
    """Return velocity (n_points, 2) [m/s] and pressure (n_points,) [Pa] of one snapshot."""
    density, velocity = sample(*snapshot_fields(trajectory, snapshot))
    return velocity, state_equation.pressure(density, case.sound_speed)


def sample_exact(flow: ExactFlow, probes: Probes, times: Array) -> Samples:
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
    case: Case, mapped: Artifact, basis: TrialBasis, splines: ModeSplines, probes: Probes
) -> Samples:
    """Sample the projection of mapped snapshots onto a basis: the best that it can do."""
    densities, velocities = mapped.dataset("density_fluctuation"), mapped.dataset("velocity")
    coordinates, means = [], []
    for snapshot in range(len(densities)):
        coordinates.append(project(basis, densities[snapshot], velocities[snapshot]))
        means.append(mean_density_fluctuation(basis, densities[snapshot]))
    times = mapped.read("time")
    return expand(case, basis, splines, probes, times, np.array(coordinates), np.array(means))


def expand(
    case: Case,
    basis: TrialBasis,
    splines: ModeSplines,
    probes: Probes,
    times: Array,
    coordinates: Array,
    mean_density: Array,
) -> Samples:
    """Sample the states of coordinates (n_snapshots, n_modes) by the modes' splines.

    `mean_density` (n_snapshots,) [kg/m3] is what the basis has carried apart, else zero.
    """
    values = splines.values(probes.all).reshape(len(probes.all), -1, 3)
    if basis.offset is not None:
        coordinates = np.append(coordinates, np.ones((len(coordinates), 1)), axis=1)
    fields = np.einsum("pmf,sm->spf", values, coordinates, optimize=True)
    density = basis.inner_product.density_fluctuation(fields[..., 0]) + mean_density[:, None]
    return Samples(times, fields[..., 1:], state_equation.pressure(density, case.sound_speed))
