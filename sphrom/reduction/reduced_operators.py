"""Projected right-hand sides as records: the rates of a model at any viscosity.

Galerkin projection (Eq. 3.21) at fixed points gives rates that are quadratic in the coordinates,

    da/dt = sum_k theta_k (c_k + A_k a + H_k(a, a)),

with factors theta_k of the parameters: 1 for the inertia (pressure, diffusion, advection), the
kinematic viscosity nu, nu s for walls that move with s times their given velocity, and the
amplitude beta(t) of the body force. Where walls are driven, their factor is nu s beta(t). A
parameter that drives the flow by walls or force has parts of its own, whose factors are its value
times theirs. One set of operators serves all parameters. `sphrom.reduction.operators` and
`sphrom.reduction.memory_operators` make them; reduced runs need nothing but these records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial import Polynomial, Tensors
from sphrom.sph.fluid import NONE, Drive, Factors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PARTS = {"inertia": 2, "viscosity": 2, "walls": 1, "force": 1}
"""The parts of the operators, and the degrees of their polynomials."""


@dataclass(frozen=True)
class ReducedOperators:
    """Tensors (c, A, H) of degree 0, 1 and 2 by parameter; None where a scene lacks the term."""

    inertia: Tensors
    viscosity: Tensors
    """Per unit of kinematic viscosity."""
    walls: Tensors | None
    """Per unit of kinematic viscosity and of wall speed; of degree 0 and 1."""
    force: Tensors | None
    """Per unit of the body force's amplitude; of degree 0 and 1."""
    acoustic: Array
    """(n_modes, n_modes) [1/s] the share of pressure and divergence in A."""
    order: Literal[0, 1]
    """To which rho0/rho is expanded."""
    walls_driven: bool = False
    """Whether walls move with the amplitude."""
    drives: Mapping[str, Drive[Tensors]] = field(default_factory=dict)
    """By parameter, what walls and force have per unit of its value, beside the above."""

    @property
    def n_modes(self) -> int:
        """Number of generalized coordinates."""
        return len(self.acoustic)

    @property
    def skewness(self) -> float:
        """The largest entry of the acoustic part's symmetric part, over the part's largest.

        Zero but for rounding in the acoustic product: no sound is created by projection.
        """
        largest = float(np.max(np.abs(self.acoustic)))
        symmetric = float(np.max(np.abs(self.acoustic + self.acoustic.T)))
        return symmetric / largest if largest > 0.0 else 0.0

    def of_modes(self, modes: Indices) -> ReducedOperators:
        """Return the operators of some modes."""

        def chosen(tensors: Tensors) -> Tensors:
            return tuple(tensor[np.ix_(*(modes,) * tensor.ndim)] for tensor in tensors)

        def chosen_of(tensors: Tensors | None) -> Tensors | None:
            return None if tensors is None else chosen(tensors)

        return replace(
            self,
            inertia=chosen(self.inertia),
            viscosity=chosen(self.viscosity),
            walls=chosen_of(self.walls),
            force=chosen_of(self.force),
            acoustic=self.acoustic[np.ix_(modes, modes)],
            drives={
                parameter: Drive(chosen_of(drive.walls), chosen_of(drive.force))
                for parameter, drive in self.drives.items()
            },
        )

    def at(
        self, kinematic_viscosity: float, wall_speed: float = 1.0, factors: Factors = NONE
    ) -> Polynomial:
        """Return the rates at a viscosity [m2/s] and a speed of walls over the given one.

        The amplitude of the polynomial is that of the body force, or of driven walls. `factors`
        are the values of the parameters that drive the flow.
        """
        rates = Polynomial((self.inertia,)).plus(Polynomial((self.viscosity,)), kinematic_viscosity)
        force = combined(self.force, self.drives, "force", factors)
        if force is not None:
            rates = rates.plus(Polynomial(((), force)))
        moved = combined(self.walls, self.drives, "walls", factors)
        if moved is not None:
            walls = ((), moved) if self.walls_driven else (moved,)
            rates = rates.plus(Polynomial(walls), kinematic_viscosity * wall_speed)
        return rates


def combined(
    own: Tensors | None, drives: Mapping[str, Drive[Tensors]], part: str, factors: Factors
) -> Tensors | None:
    """Return tensors of walls or force with those of all parameters at their values."""
    for name, drive in drives.items():
        more: Tensors | None = getattr(drive, part)
        if more is not None:
            scaled = tuple(factors[name] * tensor for tensor in more)
            own = scaled if own is None else tuple(map(np.add, own, scaled))
    return own


@dataclass(frozen=True)
class MemoryOperators:
    """The rates that a closure adds per unit of memory length, quadratic in the viscosity."""

    coefficients: tuple[Polynomial, Polynomial, Polynomial]
    """Of the viscosity's powers 0, 1 and 2."""

    def at(self, kinematic_viscosity: float) -> Polynomial:
        """Return the polynomial at a viscosity [m2/s]."""
        zeroth, first, second = self.coefficients
        return zeroth.plus(first, kinematic_viscosity).plus(second, kinematic_viscosity**2)
