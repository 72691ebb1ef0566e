"""Trial bases: modes that are orthonormal in an inner product (Eq. 3.7-3.8).

A state consists of a first field, derived from the density, and the velocity. In the acoustic
product the first field is c0 rho'/rho0 and a row is weighted with its particle's volume, so the
norm is the acoustic energy. In the paper's raw product it is the full density with unit weights.

In a closed box the spatial mean of the density drives no flow, and it may drift. A basis may
therefore treat it as a separate variable. Every state is then stripped of its mean (with the
weights of the rows), so all modes have zero mean and are orthogonal to a constant density.

Shapes: density (n_snapshots, n_points), velocity (n_snapshots, n_points, n_dim); of modes the same.

The largest speed and the kinetic energy of a reduced run follow from its coordinates. The largest
speed over all points and snapshots is found without evaluating most points: the speed at a point is
at most the sum of the modes' speeds there times their largest coordinates. Points whose bound is
below a speed already found are skipped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset

JOINT = "joint"
"""The name of the singular values of density and velocity taken together."""
_STATE = "of the inner product's state"


@dataclass(frozen=True)
class InnerProduct:
    """The first field of a state, and the weights of its rows."""

    name: Literal["acoustic", "raw"]
    density_scale: float
    density_offset: float

    @classmethod
    def acoustic(cls, reference_density: float, sound_speed: float) -> InnerProduct:
        """Return the acoustic-energy product: c0 rho'/rho0 [m/s], weighted with the volume."""
        return cls("acoustic", sound_speed / reference_density, 0.0)

    @classmethod
    def raw(cls, reference_density: float) -> InnerProduct:
        """Return the paper's product: the full density [kg/m3], unit weights."""
        return cls("raw", 1.0, reference_density)

    def without_mean(self) -> InnerProduct:
        """Return the product for states without their mean density; it has no constant part."""
        return replace(self, density_offset=0.0)

    def first_field(self, density_fluctuation: Array) -> Array:
        """Return the first field of a state, given the density fluctuation [kg/m3]."""
        return self.density_scale * density_fluctuation + self.density_offset

    def density_fluctuation(self, first_field: Array) -> Array:
        """Return the density fluctuation [kg/m3], given the first field of a state."""
        return (first_field - self.density_offset) / self.density_scale

    def weights(self, volume: Array) -> Array:
        """Return the weight of every point (n_points,), given its volume [m2]."""
        return np.ones(len(volume)) if self.name == "raw" else np.array(volume, dtype=float)


class Modes(Record):
    """Modes and their singular values, in the state's scaling."""

    density_modes: Array = dataset(
        "mode particle", _STATE, "density part of the modes", "Phi", "Eq. 3.16", at="modes/density"
    )
    velocity_modes: Array = dataset(
        "mode particle component", _STATE, "velocity part of the modes", "Phi", "Eq. 3.16",
        at="modes/velocity",
    )  # fmt: skip
    singular_values: Mapping[str, Array] = dataset(
        "singular_value", "of the inner product",
        "joint singular values of density and velocity, descending", "sigma", "Eq. 3.16",
        default_factory=dict,
    )  # fmt: skip


class StoredBasis(Modes):
    """The modes of a trial basis as stored in its artifact."""

    gram_error: float = attribute("1", "largest departure from orthonormality")


class TrialBasis(StoredBasis):
    """Modes that are orthonormal in an inner product."""

    inner_product: InnerProduct
    weights: Array
    """(n_points,), of the inner product."""
    separate_mean: bool = False
    """Whether the mean density fluctuation is a separate variable."""

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.density_modes)

    @property
    def n_dim(self) -> int:
        """Number of components of the velocity."""
        return self.velocity_modes.shape[2]


def weighted_mean(field: Array, weights: Array) -> Array:
    """Return the mean (...) of a field (..., n_points) with weights (n_points,)."""
    return np.asarray(field @ weights / weights.sum())


def mean_density_fluctuation(basis: TrialBasis, density_fluctuation: Array) -> Array:
    """Return the separate mean density fluctuations (...) [kg/m3] of states.

    They are zero if the modes include the mean.
    """
    if not basis.separate_mean:
        return np.zeros(density_fluctuation.shape[:-1])
    return weighted_mean(density_fluctuation, basis.weights)


def project(basis: TrialBasis, density_fluctuation: Array, velocity: Array) -> Array:
    """Return the generalized coordinates (..., n_modes) of states (..., n_points[, n_dim]).

    They give the best approximation in the inner product of the basis. With a separate mean, it is
    that of the states without their mean density fluctuation.
    """
    if basis.separate_mean:
        mean = mean_density_fluctuation(basis, density_fluctuation)
        density_fluctuation = density_fluctuation - mean[..., None]
    first_field = basis.inner_product.first_field(density_fluctuation)
    density_part = np.tensordot(first_field * basis.weights, basis.density_modes, (-1, 1))
    weighted = velocity * basis.weights[:, None]
    velocity_part = np.tensordot(weighted, basis.velocity_modes, ((-2, -1), (1, 2)))
    return np.asarray(density_part + velocity_part)


def reconstruct(
    basis: TrialBasis, generalized_coordinates: Array, mean: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return the states with coordinates (..., n_modes) (Eq. 3.7).

    They are the density fluctuation (..., n_points) [kg/m3] and the velocity
    (..., n_points, n_dim) [m/s]. `mean` (...) [kg/m3] is the mean density fluctuation of a basis
    that separates it.
    """
    first_field = np.tensordot(generalized_coordinates, basis.density_modes, 1)
    velocity = np.tensordot(generalized_coordinates, basis.velocity_modes, 1)
    density_fluctuation = basis.inner_product.density_fluctuation(first_field)
    return density_fluctuation + np.asarray(mean)[..., None], velocity


def truncate(basis: TrialBasis, n_modes: int) -> TrialBasis:
    """Return the basis of the first `n_modes` modes.

    Raises ValueError when the basis has fewer.
    """
    if not 1 <= n_modes <= basis.n_modes:
        raise ValueError(f"{n_modes} modes requested, but the basis has {basis.n_modes}")
    kept = np.arange(n_modes)
    density, velocity = basis.density_modes[kept], basis.velocity_modes[kept]
    return replace(basis, density_modes=density, velocity_modes=velocity)


def with_pressures(basis: TrialBasis, modes: Array) -> TrialBasis:
    """Return a basis with more modes, which have the first field (n_modes, n_points) alone."""
    velocity = np.zeros((*modes.shape, basis.n_dim))
    return replace(
        basis,
        density_modes=np.concatenate((basis.density_modes, modes)),
        velocity_modes=np.concatenate((basis.velocity_modes, velocity)),
    )


N_FIRST = 64
"""Number of points, those with the largest bounds, that are evaluated first."""
N_BLOCK = 4096
"""Number of points evaluated at once."""
ROUNDING = 1e-9
"""Relative margin of the bounds for rounding."""


class ModeVelocities:
    """The largest speed and the kinetic energy of coordinates, from the modes' velocities."""

    def __init__(self, basis: TrialBasis) -> None:
        self._modes = basis.velocity_modes
        self._speeds = np.hypot.reduce(self._modes, axis=-1)
        columns = self._modes.reshape(basis.n_modes, -1)
        self._products = columns @ columns.T

    def largest_speed(self, coordinates: Array) -> float:
        """Return the largest speed [m/s] of coordinates (n_snapshots, n_modes)."""
        bounds = np.abs(coordinates).max(axis=0) @ self._speeds
        n_first = min(N_FIRST, len(bounds))
        first = np.argpartition(bounds, -n_first)[-n_first:]
        largest = self._largest_at(coordinates, first)
        left = np.flatnonzero(bounds * (1.0 + ROUNDING) > largest)
        blocks = np.split(left, range(N_BLOCK, len(left), N_BLOCK))
        return max([largest, *(self._largest_at(coordinates, one) for one in blocks if len(one))])

    def _largest_at(self, coordinates: Array, points: NDArray[np.int64]) -> float:
        velocity = np.tensordot(coordinates, self._modes[:, points], 1)
        return float(np.sqrt(np.max(np.sum(velocity**2, axis=-1))))

    def kinetic_energy(self, coordinates: Array, mass: float) -> Array:
        """Return the energy (n_states,) [J/m] of coordinates (n_states, n_modes).

        `mass` [kg/m] is that of a particle.
        """
        return np.sum((coordinates @ (0.5 * mass * self._products)) * coordinates, axis=1)
