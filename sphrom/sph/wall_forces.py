"""Forces and torques of the fluid on walls, from the forces on their ghosts.

A force acts at the point of the wall nearest to the ghost. It contains the viscous stress mu du/dn.
The whole stress also has the term mu (grad u)^T n, with the normal n into the fluid. For a solid
the force of this term is zero, because the fluid is incompressible. Its torque is minus mu times
the circulation C of the wall's velocity, which for a rotating solid is twice the angular velocity
times the area. A straight side of the box contributes nothing at a uniform speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.sph.domain import Domain, Walls

if TYPE_CHECKING:
    from sphrom.sph.functional import Functional


TORQUE = 2
"""The row of the torque, after the components of the force."""


@dataclass(frozen=True)
class MeasuredWall:
    """A wall on which the force is measured."""

    weights: Array
    """(3, 2, n_ghosts) that give force along x and y, and torque [m], from forces on ghosts."""
    circulation: float
    """C of the wall's velocity, anticlockwise [m2/s]."""

    @property
    def arm(self) -> float:
        """The root mean square distance of its ghosts from the centre of rotation [m]."""
        squares = np.sum(self.weights**2, axis=(1, 2))
        return float(np.sqrt(squares[TORQUE] / squares[0]))

    def loads(self, ghost_forces: Array) -> Array:
        """Return force and torque (3, ...), given the forces on ghosts (2, n_ghosts, ...) [N/m]."""
        return np.tensordot(self.weights, ghost_forces, 2)


def measured_wall(
    domain: Domain, walls: Walls, name: str, wall_velocity: Callable[[Array], Array]
) -> MeasuredWall:
    """Return a wall of a domain, prepared for the measurement of its force.

    Parameters
    ----------
    wall_velocity : returns the walls' velocity (n_points, 2) [m/s] at places (n_points, 2) [m].
    """
    own = np.flatnonzero(walls.wall == domain.wall_names.index(name))
    x, y = domain.arms(name, domain.on_wall(domain.wrap(walls.position[own]))).T
    weights = np.zeros((3, 2, len(walls.wall)))
    weights[0, 0, own] = weights[1, 1, own] = 1.0
    weights[TORQUE][:, own] = -y, x
    return MeasuredWall(weights, domain.circulation(name, wall_velocity))


class WallForces:
    """The forces on some walls, for states of a functional."""

    def __init__(self, functional: Functional, walls: Mapping[str, MeasuredWall]) -> None:
        self._functional = functional
        self.walls = walls

    def __call__(self, state: Array, time: float) -> dict[str, Array]:
        """Return pressure and viscous force with torque (2, 3) [N/m, N], by name.

        States are full ones (5, n_particles), times in [s].
        """
        forces, functional = self._functional.ghost_forces(state, time), self._functional
        speed = 1.0 if functional.wall_speed is None else functional.wall_speed(time)
        viscosity = functional.fluid.reference_density * functional.fluid.kinematic_viscosity
        loads = {}
        for name, wall in self.walls.items():
            loads[name] = np.stack([wall.loads(part) for part in forces])
            loads[name][1, TORQUE] -= viscosity * speed * wall.circulation
        return loads
