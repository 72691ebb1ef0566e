"""A flow of one's own: any domain, walls that slide along themselves, a body force, a start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.scenes.scene import Drive, Scene
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]
VectorField = Callable[[Array], Array]
"""From positions (n_points, 2) [m], vectors (n_points, 2)."""


@dataclass(frozen=True)
class CustomFlow(Scene):
    """A flow that a case describes; what isn't given is at rest, or zero."""

    where: Domain
    """The domain of the fluid."""
    wall_velocities: Mapping[str, VectorField] = field(default_factory=dict)
    """By the names of walls, their velocity [m/s] at places on them."""
    force: Drive | None = None
    start_velocity: VectorField | None = None
    """[m/s]."""
    start_pressure: Callable[[Array], Array] | None = None
    """From positions (n_points, 2) [m], (n_points,) [Pa]."""

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self.where

    def initial_velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at the start."""
        if self.start_velocity is None:
            return np.zeros_like(position)
        return self.start_velocity(position)

    def initial_pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at the start."""
        if self.start_pressure is None:
            return np.zeros(len(position))
        return self.start_pressure(position)

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) are of."""
        velocity = np.zeros_like(position)
        if self.wall_velocities:
            names = np.array(self.where.wall_names)[self.where.nearest_wall(position)]
            place = self.where.on_wall(position)
            for name, field_of in self.wall_velocities.items():
                chosen = names == name
                velocity[chosen] = field_of(place[chosen])
        return velocity

    @property
    def body_force(self) -> Drive | None:
        """What pushes the fluid, or None where nothing does."""
        return self.force
