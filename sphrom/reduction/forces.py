"""Forces on walls in generalized coordinates, projected once.

At fixed points the force on a wall is linear in the state (`sphrom.sph.fixed_points`), so that

    F = P z + nu (V z + s w) + beta(t) B z

with the terms z = (1, mean of the density fluctuation that is carried apart, coordinates), the
kinematic viscosity nu, the walls' speed s over the given one, and the amplitude beta of the body
force. No field is rebuilt. Rows are the components of the force, then the torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.drives import Drive, Factors

Array = NDArray[np.float64]

N_OTHER_TERMS = 2
"""Terms before the coordinates."""


@dataclass(frozen=True)
class ReducedForce:
    """What is multiplied with the terms (3, n_terms) [N/m, N]."""

    pressure: Array
    """P."""
    viscous: Array
    """V, per kinematic viscosity."""
    walls: Array
    """w (3,), per kinematic viscosity and wall speed."""
    body_force: Array | None
    """B, per amplitude; None without a body force."""
    drives: Mapping[str, Drive[Array]] = field(default_factory=dict)
    """By parameter, w (3,) and B per unit of its value, beside the above."""

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedForce:
        """Return the force in the coordinates of some modes, the others zero."""
        kept = np.concatenate((np.arange(N_OTHER_TERMS), N_OTHER_TERMS + modes))
        force = None if self.body_force is None else self.body_force[:, kept]
        pressure, viscous = self.pressure[:, kept], self.viscous[:, kept]
        drives = {
            name: Drive(drive.walls, None if drive.force is None else drive.force[:, kept])
            for name, drive in self.drives.items()
        }
        return replace(self, pressure=pressure, viscous=viscous, body_force=force, drives=drives)

    def with_drives(self, factors: Factors) -> ReducedForce:
        """Return the force at values of the parameters that drive the flow."""
        walls, force = self.walls, self.body_force
        for name, drive in self.drives.items():
            if drive.walls is not None:
                walls = walls + factors[name] * drive.walls
            if drive.force is not None:
                force = factors[name] * drive.force + (0.0 if force is None else force)
        return replace(self, walls=walls, body_force=force, drives={})

    def at(
        self,
        coordinates: Array,
        mean_density_fluctuation: Array | float,
        kinematic_viscosity: float,
        wall_speed: Array | float = 1.0,
        amplitude: Array | float = 0.0,
    ) -> Array:
        """Return the pressure's and the viscous force and torque (n_states, 2, 3) [N/m, N].

        Parameters
        ----------
        coordinates : (n_states, n_modes).
        mean_density_fluctuation, wall_speed, amplitude : (n_states,) or one for all.
        """
        n_states = len(coordinates)
        mean = np.broadcast_to(mean_density_fluctuation, n_states)
        terms = np.column_stack((np.ones(n_states), mean, coordinates))
        speed, beta = (np.broadcast_to(v, n_states)[:, None] for v in (wall_speed, amplitude))
        pressure = terms @ self.pressure.T
        if self.body_force is not None:
            pressure = pressure + beta * (terms @ self.body_force.T)
        viscous = kinematic_viscosity * (terms @ self.viscous.T + speed * self.walls)
        return np.stack((pressure, viscous), axis=1)
