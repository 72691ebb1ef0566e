"""Fields of runs at fixed probes: a line and a grid, on which runs are compared, and stations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.metrics.samples import Probes, Samples, grid_points, midpoints, spread
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.trial_basis import TrialBasis, mean_density_fluctuation, project
from sphrom.setup.particles import sampler
from sphrom.sph.fluid import pressure_of
from sphrom.store.trajectory import snapshot_fields

ON_WALL = 1e-6
"""Points nearer to a wall than this part of the spacing are on it."""
N_INFLOWS = 10
"""Instants at which the inflow of a run is looked at."""
LEAST_SHARE = 1e-10
"""Of a combination of modes that holds nothing of a field."""


def probes_of(case: Case) -> Probes:
    """Return where the runs of a case are compared.

    Raises CaseError when no fluid is on the line.
    """
    domain = case.scene.domain
    x = case.plan.probe_line
    spans = domain.sections(x)
    if not spans:
        raise CaseError(f"compare.line: there is no fluid at x = {x:g} m")
    n_line, longer = case.compare.line_points, max(domain.lengths)
    n_columns, n_rows = (max(2, round(case.compare.grid * s / longer)) for s in domain.lengths)
    shape = n_rows, n_columns
    points = grid_points(domain.lower, domain.upper, shape)
    # A point on a wall, as a grid can have on edges within the box, is of no fluid.
    in_fluid = domain.wall_distance(points) > ON_WALL * case.plan.particle_spacing
    if (strip := case.plan.strip) is not None:  # what happens in it is not of the flow
        in_fluid &= ~strip.contains(points.T)
    return Probes(
        line=np.stack((np.full(n_line, float(x)), spread(spans, n_line)), axis=1),
        grid=points[in_fluid],
        grid_shape=shape,
        in_fluid=in_fluid,
        stations=case.scene.stations(case.plan.probe_line),
    )


def sample_run(
    case: Case,
    trajectory: Artifact,
    points: Array,
    advance: Callable[[int], None] = lambda done: None,
    snapshots: Sequence[int] | None = None,
    surface: Array | None = None,
) -> Samples:
    """Sample the particles of a run at points (n_points, 2) [m], at some or all snapshots.

    A run that became unstable is sampled as far as particles are left near all points. Above a
    surface at heights y (n_snapshots, n_points) [m] velocity and pressure are zero.
    """
    times, sample = trajectory.read("time"), sampler(case, points)
    chosen = range(len(times)) if snapshots is None else snapshots
    velocities = np.zeros((len(chosen), len(points), 2))
    pressures = np.zeros((len(chosen), len(points)))
    wet: slice | Mask = slice(None)
    for i, snapshot in enumerate(chosen):
        if surface is not None:
            wet = points[:, 1] <= surface[snapshot]
            sample = sampler(case, points[wet])
        try:
            density, velocities[i, wet] = sample(*snapshot_fields(trajectory, snapshot))
        except ValueError as error:
            if trajectory.text("status") == "complete":
                raise ArtifactError(f"{trajectory.path}, snapshot {snapshot}: {error}") from error
            return Samples(times[chosen[:i]], velocities[:i], pressures[:i])
        pressures[i, wet] = pressure_of(density, case.plan.sound_speed)
        advance(1)
    return Samples(times[chosen], velocities, pressures)


def described_inflow(case: Case, point: ParameterPoint, trajectory: Artifact) -> str | None:
    """Return the inflow that was wanted and that a run's later half has, in words; or None."""
    strip, force = case.plan.strip, case.plan.flow(point).body_force
    if strip is None or force is None:
        return None
    domain, across = case.scene.domain, 1 - strip.axis
    n_places = max(2, round(domain.lengths[across] / case.plan.particle_spacing))
    points = np.empty((n_places, 2))
    points[:, strip.axis] = strip.end if strip.speed > 0.0 else strip.start
    points[:, across] = midpoints(domain.lower[across], domain.upper[across], n_places)
    points = points[domain.contains(points)]
    width = domain.lengths[across] * len(points) / n_places  # solids may cross the strip
    times = trajectory.read("time")
    chosen = np.unique(np.linspace(len(times) // 2, len(times) - 1, N_INFLOWS).astype(int))
    found = sample_run(case, trajectory, points, snapshots=chosen.tolist())
    inside = points.copy()
    inside[:, strip.axis] = 0.5 * (strip.start + strip.end)
    profile = (force.field(inside.T) / strip.rates(inside.T)).T
    wanted = np.array([force.amplitude(t) for t in found.time])[:, None, None] * profile
    flows = [width * v[..., strip.axis].mean() for v in (wanted, found.velocity)]
    off = np.linalg.norm(found.velocity.mean(axis=0) - wanted.mean(axis=0), axis=1)
    return (
        f"{point.label}: inflow of {flows[0]:.4g} m2/s wanted, {flows[1]:.4g} found "
        f"({100.0 * (flows[1] / flows[0] - 1.0):+.2f} %); its profile is off by "
        f"{100.0 * math.sqrt(np.mean(off**2)) / abs(strip.speed):.2g} % of its largest speed"
    )


def sample_mapped(case: Case, mapped: Artifact, sample: ReferenceMap) -> Samples:
    """Sample mapped snapshots: what the map alone costs."""
    position = mapped.read("reference_position")
    snapshots = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    fields = [sample(position, density, velocity) for density, velocity in snapshots]
    density, velocity = map(np.array, zip(*fields, strict=True))
    return Samples(mapped.read("time"), velocity, pressure_of(density, case.plan.sound_speed))


def sample_best(
    case: Case, mapped: Artifact, basis: TrialBasis, splines: ModeSplines, probes: Probes
) -> tuple[Samples, Samples]:
    """Sample what in a basis is nearest to mapped snapshots: in both fields, and in each alone.

    The first are states, by projection in the basis's inner product. Of the others each field has
    coordinates of its own, so that no state with these modes is nearer in either.
    """
    densities, velocities = mapped.dataset("density_fluctuation"), mapped.dataset("velocity")
    snapshots = zip(densities, velocities, strict=True)
    parts = [(project(basis, d, 0.0 * v), project(basis, 0.0 * d, v)) for d, v in snapshots]
    by_density, by_velocity = (np.array(part) for part in zip(*parts, strict=True))
    share = (basis.density_modes * basis.weights) @ basis.density_modes.T
    shares = (share, by_density), (np.eye(basis.n_modes) - share, by_velocity)
    alone = [np.linalg.lstsq(gram, part.T, LEAST_SHARE)[0].T for gram, part in shares]
    means = np.array([mean_density_fluctuation(basis, density) for density in densities])
    times = mapped.read("time")
    both, density, velocity = (
        expand(case, basis, splines, probes.all, times, each, means)
        for each in (by_density + by_velocity, *alone)
    )
    return both, replace(density, velocity=velocity.velocity)


def expand(
    case: Case,
    basis: TrialBasis,
    splines: ModeSplines,
    points: Array,
    times: Array,
    coordinates: Array,
    mean_density: Array,
) -> Samples:
    """Sample the states of coordinates (n_snapshots, n_modes) at points by the modes' splines.

    `mean_density` (n_snapshots,) [kg/m3] is what the basis has carried apart, else zero.
    """
    values = splines.values(points).reshape(len(points), -1, 3)
    fields = np.tensordot(coordinates, values, (1, 1))
    density = basis.inner_product.density_fluctuation(fields[..., 0]) + mean_density[:, None]
    return Samples(times, fields[..., 1:], pressure_of(density, case.plan.sound_speed))
