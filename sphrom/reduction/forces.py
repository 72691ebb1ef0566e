"""Forces on walls in generalized coordinates, projected once.

At fixed points the force on a wall is linear in the state (`sphrom.sph.fixed_points`), so that

    F = P z + nu (V z + s w) + beta(t) B z + (C + (nu / nu_mean - 1) C') y

with the terms z = (1, mean of the density fluctuation that is carried apart, coordinates), the
kinematic viscosity nu, the walls' speed s over the given one, and the amplitude beta of the body
force. C and C' correct it, where it is calibrated (`sphrom.reduction.force_calibration`), with
y = (1, s, beta, coordinates). No field is rebuilt. Rows are the components of the force, then the
torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.fluid import Drive, Factors

Array = NDArray[np.float64]

N_OTHER_TERMS = 2
"""Terms before the coordinates."""


@dataclass(frozen=True)
class ForceCorrection:
    """What is added to a force, by viscosity."""

    mean: Array
    """C (2, 3, n_terms) of the pressure's and the viscous part [N/m, N], at the mean viscosity."""
    slope: Array
    """C' likewise."""
    mean_viscosity: float
    """nu_mean [m2/s]."""

    def at(self, kinematic_viscosity: float) -> Array:
        """Return what is multiplied with y (2, 3, n_terms), at a viscosity [m2/s]."""
        return self.mean + (kinematic_viscosity / self.mean_viscosity - 1.0) * self.slope


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
    correction: ForceCorrection | None = None
    """C and C'; None where it isn't calibrated."""

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedForce:
        """Return the force in the coordinates of some modes, not calibrated."""
        kept = np.concatenate((np.arange(N_OTHER_TERMS), N_OTHER_TERMS + modes))
        force = None if self.body_force is None else self.body_force[:, kept]
        pressure, viscous = self.pressure[:, kept], self.viscous[:, kept]
        drives = {
            name: Drive(drive.walls, None if drive.force is None else drive.force[:, kept])
            for name, drive in self.drives.items()
        }
        return ReducedForce(pressure, viscous, self.walls, force, drives)

    def corrected(self, correction: ForceCorrection) -> ReducedForce:
        """Return the force with a correction."""
        return replace(self, correction=correction)

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
        n_states, n_modes = coordinates.shape
        linear, speed, beta = slice(2, 2 + n_modes), 2 + n_modes, 3 + n_modes
        # One product of all terms: of short runs, calls take longer than the sums.
        terms = np.ones((n_states, 5 + 2 * n_modes))
        terms[:, 1] = mean_density_fluctuation
        terms[:, linear] = coordinates
        terms[:, speed], terms[:, beta] = wall_speed, amplitude
        np.multiply(terms[:, 1:speed], terms[:, beta, None], out=terms[:, beta + 1 :])
        return (terms @ self._matrix(kinematic_viscosity)).reshape(n_states, 2, 3)

    def _matrix(self, kinematic_viscosity: float) -> Array:
        """Return the factors (n_terms, 6) of z, s, beta, and beta times z but for its one."""
        n = self.pressure.shape[1]
        matrix = np.zeros((2 * n + 1, 6))
        matrix[:n, :3] = self.pressure.T
        matrix[:n, 3:] = kinematic_viscosity * self.viscous.T
        matrix[n, 3:] = kinematic_viscosity * self.walls
        if self.body_force is not None:
            matrix[n + 1 :, :3] = self.body_force.T
        if self.correction is not None:
            own = self.correction.at(kinematic_viscosity).reshape(6, -1).T
            matrix[0] += own[0]
            matrix[n : n + 2] += own[1:3]
            matrix[N_OTHER_TERMS:n] += own[3:]
        return matrix


def correction_terms(
    coordinates: Array, wall_speed: Array | float, amplitude: Array | float
) -> Array:
    """Return y (n_states, 3 + n_modes): one, s, beta, and the coordinates."""
    n_states = len(coordinates)
    speed, beta = (np.broadcast_to(v, n_states) for v in (wall_speed, amplitude))
    return np.column_stack((np.ones(n_states), speed, beta, coordinates))
