"""Terms that a user adds to the acceleration of the fluid.

A term is A(x) u + B(x)(u, u) + a(x, u, t). The parts with A and B are polynomials of the velocity
u, so operators can be projected for them, but not for an arbitrary function a. A Coriolis force, -2
Omega x u, is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arrays import Array


@dataclass(frozen=True)
class Term:
    """A term of the acceleration, as functions of positions (n, 2) [m] in the box.

    Parameters
    ----------
    linear : returns matrices A (n, 2, 2) [1/s], which multiply the velocity.
    quadratic : returns B (n, 2, 2, 2) [1/m]; the component i is sum_jk B[:, i, j, k] u_j u_k.
    acceleration : any function of positions (n, 2) [m], velocities (n, 2) [m/s] and the time [s],
        which returns accelerations (n, 2) [m/s2]. Models from operators don't support it.

    Functions may also return one value for all positions.
    """

    linear: Callable[[Array], ArrayLike] | None = None
    quadratic: Callable[[Array], ArrayLike] | None = None
    acceleration: Callable[[Array, Array, float], ArrayLike] | None = None

    def __post_init__(self) -> None:
        given = [part for part in vars(self).values() if part is not None]
        if not given or not all(map(callable, given)):
            raise ValueError("a term needs functions: linear, quadratic or acceleration")

    def matrices(self, position: Array) -> Array:
        """Return the matrices A (2, 2, n) [1/s] at positions (n, 2) [m]."""
        return _tensor("linear", self.linear, 2, position)

    def products(self, position: Array) -> Array:
        """Return the tensors B (2, 2, 2, n) [1/m] at positions (n, 2) [m]."""
        return _tensor("quadratic", self.quadratic, 3, position)

    def __call__(self, position: Array, velocity: Array, time: float) -> Array:
        """Return the acceleration (2, n) [m/s2] at positions (n, 2) [m].

        Velocities are (2, n) [m/s], the time is in [s]. Raises ValueError for a wrong shape.
        """
        out = np.zeros_like(velocity)
        if self.linear is not None:
            out += np.einsum("ijn,jn->in", self.matrices(position), velocity)
        if self.quadratic is not None:
            out += np.einsum("ijkn,jn,kn->in", self.products(position), velocity, velocity)
        if self.acceleration is not None:
            found = self.acceleration(position, velocity.T, time)
            out += _shaped("acceleration", found, position.shape).T
        return out


def _tensor(
    name: str, function: Callable[[Array], ArrayLike] | None, order: int, position: Array
) -> Array:
    """Return a tensor's components (2, ..., n) at positions (n, 2); zero without a function."""
    found = 0.0 if function is None else function(position)
    return np.moveaxis(_shaped(name, found, (len(position), *(2,) * order)), 0, -1)


def _shaped(name: str, found: ArrayLike, shape: tuple[int, ...]) -> Array:
    values = np.asarray(found, dtype=np.float64)
    try:
        return np.broadcast_to(values, shape)
    except ValueError as error:
        raise ValueError(f"{name}: must return {shape}; got {values.shape}") from error
