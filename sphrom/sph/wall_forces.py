"""Forces and torques of the fluid on walls, from those on their ghosts.

A force acts where its ghost's wall is nearest. Ghosts have the viscous stress mu du/dn. The whole
stress adds mu (grad u)^T n, the normal n into the fluid. Around a solid its force is zero, as the
fluid is incompressible, and its torque is mu times the integral of u x n along the solid's edge:
minus mu times the circulation C of the wall's velocity, which is twice the angular velocity and the
area of a solid that turns. A side of the box is straight, and at a uniform speed adds nothing.
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
    """(3, 2, n_ghosts): force along x and y, and torque [m], from the force on each ghost."""
    circulation: float
    """C of the wall's velocity, anticlockwise [m2/s]."""

    @property
    def arm(self) -> float:
        """The root mean square of how far its ghosts are from what the torque is about [m]."""
        squares = np.sum(self.weights**2, axis=(1, 2))
        return float(np.sqrt(squares[TORQUE] / squares[0]))

    def loads(self, ghost_forces: Array) -> Array:
        """Return force and torque (3, ...) from the forces on ghosts (2, n_ghosts, ...) [N/m]."""
        return np.tensordot(self.weights, ghost_forces, 2)


def measured_wall(
    domain: Domain, walls: Walls, name: str, wall_velocity: Callable[[Array], Array]
) -> MeasuredWall:
    """Return a wall of a domain as one on which the force is measured.

    Parameters
    ----------
    wall_velocity : of all walls (n_points, 2) [m/s], at places on them (n_points, 2) [m].
    """
    own = np.flatnonzero(walls.wall == domain.wall_names.index(name))
    x, y = domain.arms(name, domain.on_wall(domain.wrap(walls.position[own]))).T
    weights = np.zeros((3, 2, len(walls.wall)))
    weights[0, 0, own] = weights[1, 1, own] = 1.0
    weights[TORQUE][:, own] = -y, x
    return MeasuredWall(weights, domain.circulation(name, wall_velocity))


class WallForces:
    """The forces on some walls, in the states of a functional."""

    def __init__(self, functional: Functional, walls: Mapping[str, MeasuredWall]) -> None:
        self._functional = functional
        self.walls = walls

    def __call__(self, state: Array, time: float) -> dict[str, Array]:
        """Return by name the pressure's and the viscous force and torque (2, 3) [N/m, N].

        States are full ones (5, n_particles), times in [s].
        """
        forces, functional = self._functional.ghost_forces(state, time), self._functional
        speed = 1.0 if functional.wall_speed is None else functional.wall_speed(time)
        viscosity = functional.fluid.reference_density * functional.fluid.kinematic_viscosity
        found = {}
        for name, wall in self.walls.items():
            found[name] = np.stack([wall.loads(part) for part in forces])
            found[name][1, TORQUE] -= viscosity * speed * wall.circulation
        return found
