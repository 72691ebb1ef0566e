"""Full runs at places: the probes of a case, samples of particles, and the inflow of a run.

Particles are sampled by moving least squares. Measurements of runs at places have the same values.
Within a spacing of walls they include the walls' velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.metrics.grids import Slices, grid_points, midpoints, spread
from sphrom.metrics.measures import Probes, Samples
from sphrom.sph.fluid import pressure_of
from sphrom.store.trajectory import snapshot_fields

ON_WALL = 1e-6
"""Points closer to a wall than this share of the spacing are on it."""
MISSED_INFLOW, WRONG_INFLOW = 0.02, 0.2
"""Relative differences from the target inflow that cause a warning, and that make a run fail."""


def probes_of(case: Case) -> Probes:
    """Return the probes at which the runs of a case are compared.

    Raises CaseError if there is no fluid on the line.
    """
    domain = case.scene.domain
    x = case.plan.probe_line
    if domain.n_dim > 2:
        return _probes_in_space(case, x)
    spans = domain.sections(x)
    if not spans:
        raise CaseError(f"compare.line: there is no fluid at x = {x:g} m")
    n_line = case.compare.line_points
    longer = max(domain.lengths)
    n_columns, n_rows = (max(2, round(case.compare.grid * s / longer)) for s in domain.lengths)
    shape = n_rows, n_columns
    points = grid_points(domain.lower, domain.upper, shape)
    # A grid inside the box may have points exactly on walls; they are not in the fluid.
    in_fluid = domain.wall_distance(points) > ON_WALL * case.plan.particle_spacing
    if (strip := case.plan.strip) is not None:  # the flow in it is artificial
        in_fluid &= ~strip.contains(points.T)
    return Probes(
        line=np.stack((np.full(n_line, float(x)), spread(spans, n_line)), axis=1),
        grid=points[in_fluid],
        grid_shape=shape,
        in_fluid=in_fluid,
        stations=case.scene.stations(case.plan.probe_line),
    )


def _probes_in_space(case: Case, x: float) -> Probes:
    """Return the probes of a box in space: a line along y, a grid, and the slices of pictures.

    The grid has about as many points as that of a square.
    """
    domain = case.scene.domain
    line = np.tile(0.5 * np.add(domain.lower, domain.upper), (case.compare.line_points, 1))
    line[:, 0] = x
    line[:, 1] = midpoints(domain.lower[1], domain.upper[1], len(line))
    edges = np.array(domain.lengths)
    n_longest = case.compare.grid ** (2.0 / len(edges))
    shape = np.maximum(2, np.round(n_longest * edges[::-1] / edges.max())).astype(int)
    slices = Slices(domain.lower, domain.upper)
    left, right, bottom, top = slices.extent
    sides = np.array([top - bottom, right - left])
    n_rows, n_columns = np.round(case.compare.grid * sides / edges.max()).astype(int).tolist()
    pictured = slices.places(grid_points((left, bottom), (right, top), (n_rows, n_columns)))
    in_fluid: Mask = np.isfinite(pictured[:, 0])
    return Probes(
        line=line,
        grid=grid_points(domain.lower, domain.upper, shape.tolist()),
        grid_shape=(n_rows, n_columns),
        in_fluid=in_fluid,
        stations=np.empty((0, len(edges))),
        on_slices=pictured[in_fluid],
    )


def sample_run(
    case: Case,
    trajectory: Artifact,
    points: Array,
    advance: Callable[[int], None] = lambda done: None,
    snapshots: Sequence[int] | None = None,
) -> Samples:
    """Sample the particles of a run at points (n_points, n_dim) [m], at some or all snapshots.

    A run that became unstable is sampled as long as there are particles near all points.
    """
    from sphrom.setup.particles import sampler  # it loads kernels

    times = trajectory.read("time")
    sample = sampler(case, points)
    chosen = range(len(times)) if snapshots is None else snapshots
    velocities = np.empty((len(chosen), *points.shape))
    pressures = np.empty((len(chosen), len(points)))
    for i, snapshot in enumerate(chosen):
        try:
            density, velocities[i] = sample(*snapshot_fields(trajectory, snapshot))
        except ValueError as error:
            if trajectory.text("status") == "complete":
                raise ArtifactError(f"{trajectory.path}, snapshot {snapshot}: {error}") from error
            return Samples(times[chosen[:i]], velocities[:i], pressures[:i])
        pressures[i] = pressure_of(density, case.plan.sound_speed)
        advance(1)
    return Samples(times[chosen], velocities, pressures)


@dataclass(frozen=True)
class Inflow:
    """The inflow of a full run, and the one that the case asks for."""

    text: str
    miss: float
    """The difference of the flow rates, relative to the root mean square of the target."""

    @property
    def is_wrong(self) -> bool:
        """Whether the flow is not the one of the case."""
        return self.miss > WRONG_INFLOW

    @property
    def problem(self) -> str | None:
        """A sentence for a run that misses its inflow; None for others."""
        if not self.miss > MISSED_INFLOW:
            return None
        return (
            f"{self.text}. The flow is not the one of the case: raise scene.inflow.strength, take "
            "a wider strip, or let inflow.ramp and time.final_time be longer"
        )


def inflow_of(case: Case, point: ParameterPoint, trajectory: Artifact) -> Inflow | None:
    """Return the target inflow and that of a run's later half; None without a strip.

    Times before the inflow has its speed do not count if there are others.
    """
    strip = case.plan.strip
    force = case.plan.flow(point).body_force
    if strip is None or force is None:
        return None
    domain = case.scene.domain
    along = strip.axis
    across = 1 - along
    n_places = max(2, round(domain.lengths[across] / case.plan.particle_spacing))
    points = np.empty((n_places, 2))
    points[:, across] = midpoints(domain.lower[across], domain.upper[across], n_places)
    points[:, along] = 0.5 * (strip.start + strip.end)
    points = points[domain.contains(points)]
    profile = (force.field(points.T) / strip.rates(points.T)).T
    points[:, along] = strip.end if strip.speed > 0.0 else strip.start
    times = trajectory.read("time")
    later = np.arange(len(times) // 2, len(times))
    driven = later[times[later] >= case.plan.scene.ramp]
    snapshots = driven if driven.size else later[-1:]
    sampled = sample_run(case, trajectory, points, snapshots=snapshots.tolist())
    wanted = np.array([force.amplitude(t) for t in sampled.time])[:, None, None] * profile
    width = domain.lengths[across] * len(points) / n_places  # solids may cross the strip
    target = width * wanted[..., along].mean(axis=1)
    size = math.sqrt(float(np.mean(target**2)))
    if not size > 0.0:
        return None  # a constant of zero stops the inflow
    wanted_rate = float(target.mean())
    actual_rate = width * float(sampled.velocity[..., along].mean())
    miss = (actual_rate - wanted_rate) / size
    off = np.linalg.norm(sampled.velocity.mean(axis=0) - wanted.mean(axis=0), axis=1)
    fastest = float(np.linalg.norm(wanted, axis=2).max())
    text = (
        f"{point.label}: target inflow {wanted_rate:.4g} m2/s, actual inflow {actual_rate:.4g} "
        f"m2/s ({100.0 * math.copysign(miss, miss * wanted_rate):+.2f} %); the profile differs by "
        f"{100.0 * math.sqrt(np.mean(off**2)) / fastest:.2g} % of its largest speed"
    )
    return Inflow(text, abs(miss))
