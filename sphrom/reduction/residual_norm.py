"""The norm of the residual of a reduced model, at the cost of the model.

A state of coordinates a has the rates R(a) at the fixed points. The model follows Phi da/dt, and
its residual is R(a) - Phi da/dt. Both are polynomials of a, so that

    R(a) - Phi R^(a) = sum_k theta_k (columns of part k) (monomials of a),    R^ = Phi^T W R,

with the factors theta_k of `sphrom.reduction.reduced_operators`. The columns depend on neither a
nor the parameters, and only the triangular factor F of their QR decomposition is kept
(`sphrom.reduction.residual_factor`): |columns times m| = |F m|. The norm is the inner product's;
its square is a quartic of a.

The columns are orthogonal to all modes of the basis. A model of fewer modes also leaves out the
rates of the other modes, which the projected operators know. A closure (Eq. 3.22) changes da/dt
within the basis, by something orthogonal to both. So

    |R - Phi da/dt|^2 = |F m|^2 + |R^ of the modes left out|^2 + |R^ - da/dt|^2.

Monomials are ordered as in `sphrom.kernels.polynomial`, up to the second degree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial import Polynomial, pack
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.sph.fluid import NONE, Drive, Factors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class ResidualFactor:
    """F by parameter: coefficients (n_directions, n_monomials) of the monomials of a basis's modes.

    Those of walls and force are up to the first degree; None where a scene lacks the term.
    """

    inertia: Array
    viscosity: Array
    """Per unit of kinematic viscosity."""
    walls: Array | None
    """Per unit of kinematic viscosity and of wall speed."""
    force: Array | None
    """Per unit of the body force's amplitude."""
    walls_driven: bool = False
    """Whether walls move with the amplitude."""
    drives: Mapping[str, Drive[Array]] = field(default_factory=dict)
    """By parameter, what walls and force have per unit of its value, beside the above."""

    def at(
        self, kinematic_viscosity: float, wall_speed: float = 1.0, factors: Factors = NONE
    ) -> tuple[Array, ...]:
        """Return F (n_directions, n_monomials) by power of the amplitude."""
        own = self.inertia + kinematic_viscosity * self.viscosity
        driven, moved = self._with_drives("force", factors), self._with_drives("walls", factors)
        if moved is not None:
            walls = kinematic_viscosity * wall_speed * moved
            if self.walls_driven:
                driven = walls if driven is None else driven + walls
            else:
                own[:, : walls.shape[1]] += walls
        return (own,) if driven is None else (own, driven)

    def _with_drives(self, part: str, factors: Factors) -> Array | None:
        own: Array | None = getattr(self, part)
        for name, drive in self.drives.items():
            if (more := getattr(drive, part)) is not None:
                own = factors[name] * more + (0.0 if own is None else own)
        return own


@dataclass(frozen=True)
class ResidualNorm:
    """The residual's norm at given parameters, of the first modes of a basis or of some."""

    powers: tuple[Array, ...]
    """Coefficients (n_directions, n_monomials) that powers 0, 1 of the amplitude multiply."""
    closure: Polynomial | None = None
    """The rates that a closure adds, if there is one."""

    def __call__(self, states: Array, amplitude: Array | None = None) -> Array:
        """Return the norm (n_states,) [/s] at coordinates (n_states, n_modes).

        `amplitude` (n_states,) is that of the body force or of driven walls; None is none.
        """
        values = monomials(states)
        residual = values @ self.powers[0].T
        if amplitude is not None:
            for power, coefficients in enumerate(self.powers[1:], 1):
                used = values[:, : coefficients.shape[1]]
                residual += amplitude[:, None] ** power * (used @ coefficients.T)
        squares = np.sum(residual**2, axis=1)
        if self.closure is not None:
            pushes = np.zeros(len(states)) if amplitude is None else amplitude
            squares += np.sum(self.closure.along(states, pushes) ** 2, axis=1)
        return np.asarray(np.sqrt(squares))


def monomials(states: Array) -> Array:
    """Return the monomials (n_states, n_monomials) of coordinates, up to the second degree."""
    first, second = np.triu_indices(states.shape[1])
    ones = np.ones((len(states), 1))
    return np.concatenate((ones, states, states[:, first] * states[:, second]), axis=1)


def residual_norm(
    factor: ResidualFactor,
    operators: ReducedOperators,
    modes: Indices,
    kinematic_viscosity: float,
    wall_speed: float = 1.0,
    closure: Polynomial | None = None,
    factors: Factors = NONE,
) -> ResidualNorm:
    """Return the residual's norm of a model with some modes of a basis.

    Parameters
    ----------
    factor, operators : of the whole basis.
    modes : (n_modes,) those of the model, rising.
    closure : the rates that it adds to the projected ones.
    factors : the values of the parameters that drive the flow.
    """
    kept, left_out = _kept(operators.n_modes, tuple(modes.tolist()))
    powers = []
    around = kinematic_viscosity, wall_speed, factors
    for own, tensors in zip(factor.at(*around), operators.at(*around).powers, strict=True):
        others = pack(tuple(tensor[left_out] for tensor in tensors))
        used = kept[: np.searchsorted(kept, own.shape[1])]
        powers.append(np.concatenate((own[:, used], others[:, used])))
    return ResidualNorm(tuple(powers), closure)


@lru_cache(maxsize=64)
def _kept(n_modes: int, modes: tuple[int, ...]) -> tuple[Indices, Indices]:
    """Return the places of the monomials of some modes, and the modes that are left out."""
    chosen = np.array(modes, dtype=np.int64)
    left_out = np.setdiff1d(np.arange(n_modes), chosen)
    return _kept_monomials(n_modes, chosen), left_out


def _kept_monomials(n_modes: int, modes: Indices) -> Indices:
    """Return the places of the monomials of some modes among those of all."""
    first, second = np.triu_indices(n_modes)
    products = np.flatnonzero(np.isin(first, modes) & np.isin(second, modes))
    return np.concatenate(([0], 1 + modes, 1 + n_modes + products))
