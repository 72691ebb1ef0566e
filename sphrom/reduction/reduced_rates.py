"""Rates that are polynomials of the generalized coordinates, and their growth rates.

The rates da/dt = c + A a + H(a, a) + ... are those of Galerkin projection (Eq. 3.21) at fixed
reference points; with a closure they are of third degree. Coefficients may change in time through
the powers of one amplitude, such as that of a body force.

Shapes: coordinates (n_modes,), tensors of degree d (n_modes, ...) with d trailing axes of n_modes,
in which they are symmetric.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement, pairwise, zip_longest

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array, Indices
from sphrom.declaration import Tensors

STABLE_RADIUS = 4.0
"""Beyond this radius the scheme of Eq. 2.18 is unstable along every ray of the left half-plane."""
NEUTRAL = 1e-12
"""Largest excess of a growth factor over one that counts as rounding."""
N_BISECTIONS = 50
MEMORY_RATIO = 0.2
"""Automatic memory length times the reduced Jacobian's spectral radius."""
ACOUSTIC_RATIO = 0.5
"""Largest automatic memory length over the time in which sound crosses h."""


@dataclass(frozen=True)
class Polynomial:
    """Rates as a polynomial of the coordinates."""

    powers: tuple[Tensors, ...]
    """The tensors by power 0, 1, ... of the amplitude."""

    @property
    def n_modes(self) -> int:
        """Number of coordinates."""
        return self.powers[0][0].size

    @property
    def degree(self) -> int:
        """The highest degree of a tensor."""
        return max(1, *(len(tensors) - 1 for tensors in self.powers))

    def __call__(self, coordinates: Array, amplitude: float = 0.0) -> Array:
        """Return the rates (n_modes,) [1/s]."""
        rates = np.zeros(self.n_modes)
        for power, tensors in enumerate(self.powers):
            for degree, tensor in enumerate(tensors):
                for _ in range(degree):
                    tensor = tensor @ coordinates
                rates += amplitude**power * tensor
        return rates

    def along(self, states: Array, amplitudes: Array) -> Array:
        """Return the rates (n_states, n_modes) [1/s] at states with an amplitude each."""
        rates = np.zeros((len(states), self.n_modes))
        for power, tensors in enumerate(self.powers):
            factors = amplitudes[:, None] ** power
            for degree, tensor in enumerate(tensors):
                rates += factors * _contracted_with_each(tensor, states, degree)
        return rates

    def jacobian(self, coordinates: Array, amplitude: float = 0.0) -> Array:
        """Return the derivative (n_modes, n_modes) [1/s] of the rates."""
        return self.jacobians(coordinates[None], amplitude)[0]

    def jacobians(self, states: Array, amplitude: float = 0.0) -> Array:
        """Return the derivatives (n_states, n_modes, n_modes) [1/s] at states."""
        derivatives = np.zeros((len(states), self.n_modes, self.n_modes))
        for power, tensors in enumerate(self.powers):
            for degree, tensor in enumerate(tensors[1:], 1):
                contracted = tensor[None]
                for left in range(degree - 1, 0, -1):
                    columns = states.reshape(len(states), *(1,) * left, self.n_modes, 1)
                    contracted = (contracted @ columns)[..., 0]
                derivatives += degree * amplitude**power * contracted
        return derivatives

    def at_rest(self, amplitude: float = 0.0) -> Array:
        """Return the Jacobian at zero coordinates, which contains the linear parts only."""
        return self.jacobian(np.zeros(self.n_modes), amplitude)

    def scaled(self, factor: float) -> Polynomial:
        """Return the rates times a factor."""
        return Polynomial(tuple(tuple(factor * t for t in tensors) for tensors in self.powers))

    def plus(self, other: Polynomial, factor: float = 1.0) -> Polynomial:
        """Return the sum of these rates and `factor` times others; degrees and powers may differ.

        Missing tensors of a power count as zero.
        """
        powers = (
            zip_longest(own, more, fillvalue=0.0)
            for own, more in zip_longest(self.powers, other.powers, fillvalue=())
        )
        return Polynomial(
            tuple(tuple(np.asarray(t + factor * u) for t, u in tensors) for tensors in powers)
        )

    def packed(self) -> tuple[Array, Indices]:
        """Return the coefficients of monomials, in the layout of `sphrom.kernels.polynomial`."""
        packed = [pack(tensors) for tensors in self.powers]
        width = sum(len(_exponents(self.n_modes, d)[1]) for d in range(self.degree + 1))
        coefficients = np.zeros((len(packed), self.n_modes, width))
        for row, columns in zip(coefficients, packed, strict=True):
            row[:, : columns.shape[1]] = columns
        return coefficients, np.array([columns.shape[1] for columns in packed], dtype=np.int64)


def _contracted_with_each(tensor: Array, states: Array, times: int) -> Array:
    """Return a tensor (n, ...) contracted with every state (n_states, n_modes)."""
    if times == 0:
        return tensor[None]
    contracted = (states @ tensor.reshape(-1, states.shape[1]).T).reshape(-1, *tensor.shape[:-1])
    for _ in range(times - 1):
        contracted = np.einsum("s...j,sj->s...", contracted, states)
    return np.asarray(contracted)


@cache
def _exponents(n_modes: int, degree: int) -> tuple[Indices, Array]:
    """Return the indices (degree, n) of all monomials of a degree, and their multiplicities."""
    index = np.array(list(combinations_with_replacement(range(n_modes), degree)), dtype=np.int64).T
    if degree == 0:
        return np.zeros((0, 1), dtype=np.int64), np.ones(1)
    run = np.ones(index.shape[1])
    repeats = run.copy()
    for before, after in pairwise(index):
        run = np.where(before == after, run + 1.0, 1.0)
        repeats *= run
    return index, math.factorial(degree) / repeats


def pack(tensors: Tensors) -> Array:
    """Return tensors (n, ...) by degree as coefficients (n, n_monomials) in the layout of kernels.

    The number of rows may differ from that of the coordinates.
    """
    parts = []
    for degree, tensor in enumerate(tensors):
        index, times = _exponents(tensor.shape[-1], degree)
        parts.append(tensor[:, *index].reshape(len(tensor), times.size) * times)
    return np.concatenate(parts, axis=1)


def largest_growth(jacobian: Array) -> float:
    """Return the largest real part [1/s] of a Jacobian's eigenvalues: if positive, states grow."""
    return float(np.linalg.eigvals(jacobian).real.max())


def spectral_radius(jacobian: Array) -> float:
    """Return the largest magnitude [1/s] of a Jacobian's eigenvalues."""
    return float(np.max(np.abs(np.linalg.eigvals(jacobian))))


def stability_limits(eigenvalues: NDArray[np.complex128]) -> Array:
    """Return the largest stable steps (n,) [s] of Eq. 2.18 for eigenvalues (n,) [1/s].

    They are where rays leave the stability region of the scheme; zero eigenvalues have no limit. A
    growing mode grows at any step, so its real part counts as zero.
    """
    neutral = np.minimum(eigenvalues.real, 0.0) + 1j * eigenvalues.imag
    size = np.abs(neutral)
    ray = np.divide(neutral, size, out=np.zeros_like(neutral), where=size > 0.0)
    low, high = np.zeros(size.size), np.full(size.size, STABLE_RADIUS)
    for _ in range(N_BISECTIONS):
        middle = 0.5 * (low + high)
        z = middle * ray
        growth = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
        stable = np.abs(growth) <= 1.0 + NEUTRAL
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return np.divide(low, size, out=np.full(size.size, np.inf), where=size > 0.0)


def memory_length(jacobian: Array, smoothing_length: float, sound_speed: float) -> float:
    """Return the automatic memory length [s] for a Galerkin Jacobian (n_modes, n_modes) [1/s].

    It is 0.2 over the spectral radius, and at most half the time in which sound crosses a smoothing
    length: a basis of few modes may represent no sound, but the closure's residual is full of it.
    """
    longest = ACOUSTIC_RATIO * smoothing_length / sound_speed
    radius = spectral_radius(jacobian)
    return min(MEMORY_RATIO / radius, longest) if radius > 0.0 else longest
