"""From a case to what computes on its particles: the functional, ghosts of walls, and maps.

They load the kernels of SPH; `sphrom.setup.assembly` makes everything else, without them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.scenes.scene import Scene
from sphrom.setup.assembly import discretization, domain, fluid, scene
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.functional import Functional
from sphrom.sph.wall_forces import MeasuredWall, WallForces, measured_wall
from sphrom.sph.walls import Walls, build_walls

Array = NDArray[np.float64]


def functional(case: Case, point: ParameterPoint) -> Functional:
    """Return the full-order functional at a parameter point."""
    flow = scene(case, point)
    return Functional(
        fluid(case, point),
        discretization(case),
        flow.domain,
        walls=walls(case, flow),
        body_force=flow.body_force,
        wall_speed=flow.wall_amplitude,
    )


def walls(case: Case, flow: Scene) -> Walls | None:
    """Return the ghosts of a scene's walls, or None where it has no walls."""
    if not flow.domain.has_walls:
        return None
    return build_walls(
        flow.domain, case.particle_spacing, case.n_wall_layers, wall_velocity=flow.wall_velocity
    )


def measured_walls(case: Case, flow: Scene) -> dict[str, MeasuredWall]:
    """Return the walls on which a case measures forces, by the names of the measurements."""
    ghosts = walls(case, flow) if case.scene.measured_walls else None
    if ghosts is None:
        return {}
    return {
        name: measured_wall(flow.domain, ghosts, wall, flow.wall_velocity)
        for name, wall in case.scene.measured_walls.items()
    }


def wall_forces(case: Case, point: ParameterPoint, of: Functional) -> WallForces | None:
    """Return the forces that a case measures in the states of a functional, if any."""
    measured = measured_walls(case, scene(case, point))
    return WallForces(of, measured) if measured else None


def map_onto(case: Case, points: Array) -> ReferenceMap:
    """Return the case's map of particle fields onto points (n_points, 2)."""
    return ReferenceMap(
        points,
        domain(case),
        particle_spacing=case.particle_spacing,
        smoothing_length=case.reference_smoothing_length,
        method=case.reference.method,
    )


def fixed_points(case: Case, position: Array) -> FixedPoints:
    """Return the sums over neighbours at the reference points (n_points, 2) [m].

    Raises CaseError for readings of the paper that they don't have.
    """
    point = case.train_points[0]
    flow = scene(case, point)
    force = None if flow.body_force is None else flow.body_force.field(position.T)
    try:
        return FixedPoints(
            position,
            fluid(case, point),
            discretization(case),
            flow.domain,
            walls(case, flow),
            force,
            walls_driven=flow.wall_amplitude is not None,
        )
    except ValueError as error:
        raise CaseError(f"discretization: {error}") from error
