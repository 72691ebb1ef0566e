"""The projection of forces on walls, summed over ghosts once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.mode_fields import ModeFields, mode_fields
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import NONE, Drive
from sphrom.sph.wall_forces import TORQUE, MeasuredWall

Array = NDArray[np.float64]


def project_forces(
    points: FixedPoints,
    basis: TrialBasis,
    wall: MeasuredWall,
    circulations: Mapping[str, float] = NONE,
) -> ReducedForce:
    """Project the force on a wall onto a basis.

    `circulations` [m2/s] are those of the walls' velocity that a parameter gives per unit.

    Raises ValueError where there are no walls.
    """
    fields = mode_fields(basis, points)
    uniform = np.full((points.n_points, 1), points.density_scale)

    def terms(of_fields: Array, of_mean: Array) -> Array:
        """Return loads (3, n_terms) from those of columns and of a uniform density."""
        return _of_terms(wall.loads(of_fields), wall.loads(of_mean), fields)

    still = np.zeros((2, points.n_points, 1))
    density = fields.scaled_density

    def heads(force: Array | None) -> Array | None:
        if force is None:
            return None
        head, share = force[..., None], 1.0 / points.sound_speed
        found = terms(
            points.ghost_heads(head * density * share),
            points.ghost_heads(head * uniform * share),
        )
        found[:, 0] += wall.loads(points.ghost_heads(force))
        return found

    def drag(ghost_drag: Array, circulation: float) -> Array:
        found = wall.loads(ghost_drag)
        found[TORQUE] -= points.reference_density * circulation
        return found

    drives = {}
    for name, drive in points.drives.items():
        walls = None
        if drive.walls is not None:
            walls = drag(points.drag_of(drive.walls.T), circulations[name])
        drives[name] = Drive(walls, heads(drive.force))
    return ReducedForce(
        pressure=terms(
            points.ghost_pressures(density, fields.velocity),
            points.ghost_pressures(uniform, still),
        ),
        viscous=terms(points.ghost_friction(fields.velocity), points.ghost_friction(still)),
        walls=drag(points.ghost_drag, wall.circulation),
        body_force=heads(points.body_force),
        drives=drives,
    )


def _of_terms(of_columns: Array, of_mean: Array, fields: ModeFields) -> Array:
    """Return loads (3, n_terms) in their order: what is constant, the mean, the modes."""
    n = fields.n_modes
    constant = of_columns[:, n:].sum(axis=1, keepdims=True)
    return np.hstack((constant, of_mean, of_columns[:, :n]))
