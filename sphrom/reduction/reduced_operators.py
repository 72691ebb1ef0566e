"""Projected right-hand sides, and the norm of their residual, at any parameters.

Galerkin projection (Eq. 3.21) at fixed points gives rates that are quadratic in the coordinates,

    da/dt = sum_k theta_k (c_k + A_k a + H_k(a, a)),

with factors theta_k of the parameters (`sphrom.reduction.affine`): 1 for the inertia (pressure,
diffusion, advection), the kinematic viscosity nu, nu again for moving walls, and the amplitude
beta(t) of the body force. For driven walls the factor is nu beta(t). A parameter that drives the
flow by walls or force has parts of its own; its value multiplies their factors. One set of
operators serves all parameters. `sphrom.reduction.operator_projection` makes them; reduced runs
need only these records.

The norm of a model's residual costs no more than the model. A state with coordinates a has the
rates R(a) at fixed points, and the residual R(a) - Phi da/dt. Both are polynomials of a, so that

    R(a) - Phi R^(a) = sum_k theta_k (columns of part k) (monomials of a),    R^ = Phi^T W R,

with the same factors theta_k. The columns depend on neither a nor the parameters. Only the
triangular factor F of their QR decomposition is kept, because |columns times m| = |F m|. The norm
is that of the inner product; its square is a quartic of a.

The columns are orthogonal to all modes of the basis. The residual of a model with fewer modes also
contains the rates of the other modes, which the projected operators give. A closure (Eq. 3.22)
changes da/dt within the basis, orthogonally to both. So

    |R - Phi da/dt|^2 = |F m|^2 + |R^ of the other modes|^2 + |R^ - da/dt|^2.

Monomials are ordered as in `sphrom.kernels.polynomial`, up to the second degree.

Rates at fixed parameters are a `Polynomial`; with a closure it is of the third degree. Its
coefficients may change in time through the powers of one amplitude, such as that of a body force.
Tensors of degree d are (n_modes, ...) with d trailing axes of n_modes, in which they are symmetric.
Those of many runs have a first axis of runs, and so have states and amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement, pairwise, permutations, zip_longest
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, Tensors, dataset, fields_of_record, part, tensors
from sphrom.reduction.affine import AMPLITUDE, FACTORS, VISCOSITY, Affine, factor_of
from sphrom.reduction.monomials import monomials, monomials_of
from sphrom.sph.fluid import NONE, Factors

STABLE_RADIUS = 4.0
"""Beyond this radius the scheme of Eq. 2.18 is unstable along every ray of the left half-plane."""
NEUTRAL = 1e-12
"""Largest excess of a growth factor over one that counts as rounding."""
N_BISECTIONS = 50
MEMORY_RATIO = 0.2
"""Automatic memory length times the reduced Jacobian's spectral radius."""
ACOUSTIC_RATIO = 0.5
"""Largest automatic memory length over the time in which sound crosses h."""
VISCOUS = " per m2/s of viscosity"
WALLS = f"{VISCOUS}, at the walls' speed"
FORCE = " per amplitude of the body force"
VALUE = ", per unit of the parameter"
_RATES = "of the modes, /s"
_PART = "part of the reduced rates due to"
_CLOSURE = (
    "rates that a closure with this number of modes adds, per unit of memory length, by power of "
    "the viscosity [m2/s]"
)
_LINEAR, _NORM = "direction linear_monomial", "of the inner product, /s"
_LEFT_OUT = (
    "residual of the rates due to {}: multiplied by the monomials of coordinates, it is a vector "
    "with the norm of the residual"
)


@dataclass(frozen=True)
class Polynomial:
    """Rates as a polynomial of the coordinates."""

    powers: tuple[Tensors, ...]
    """The tensors by power 0, 1, ... of the amplitude."""

    @property
    def n_modes(self) -> int:
        """Number of coordinates."""
        return int(self.powers[0][0].shape[-1])

    @property
    def degree(self) -> int:
        """The highest degree of a tensor."""
        return max(1, *(len(tensors) - 1 for tensors in self.powers))

    def __call__(self, coordinates: Array, amplitude: float = 0.0) -> Array:
        """Return the rates (n_modes,) [1/s]."""
        return self.along(coordinates[None], np.array([amplitude]))[0]

    def along(self, states: Array, amplitudes: Array) -> Array:
        """Return the rates (..., n_states, n_modes) [1/s] at states with an amplitude each."""
        rates = np.zeros((*states.shape[:-1], self.n_modes))
        for power, terms in enumerate(self.powers):
            factors = amplitudes[..., None] ** power
            for degree, tensor in enumerate(terms):
                rates += factors * _contracted_with_each(tensor, states, degree)
        return rates

    def jacobian(self, coordinates: Array, amplitude: float = 0.0) -> Array:
        """Return the derivative (n_modes, n_modes) [1/s] of the rates."""
        return self.jacobians(coordinates[None], amplitude)[0]

    def jacobians(self, states: Array, amplitude: float = 0.0) -> Array:
        """Return the derivatives (n_states, n_modes, n_modes) [1/s] at states."""
        derivatives = np.zeros((len(states), self.n_modes, self.n_modes))
        for power, terms in enumerate(self.powers):
            for degree, tensor in enumerate(terms[1:], 1):
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
    """Return a tensor (..., n, ...) contracted with every state (..., n_states, n_modes)."""
    runs = tensor.shape[: tensor.ndim - 1 - times]
    rows = tensor.shape[len(runs) : tensor.ndim - 1]
    if times == 0:
        return tensor[..., None, :]
    columns = tensor.reshape((*runs, -1, states.shape[-1])).swapaxes(-1, -2)
    contracted = (states @ columns).reshape(states.shape[:-1] + rows)
    for _ in range(times - 1):
        along = states.reshape(*states.shape[:-1], *(1,) * (contracted.ndim - states.ndim), -1)
        contracted = np.einsum("...j,...j->...", contracted, along)
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


def unpack(coefficients: Array, n_modes: int) -> Tensors:
    """Return the tensors (n, ...) by degree that `pack` makes coefficients (n, n_monomials) of."""
    tensors = list[Array]()
    rest = coefficients
    while rest.shape[1]:
        index, times = _exponents(n_modes, len(tensors))
        columns, rest = np.split(rest, [times.size], axis=1)
        tensor = np.zeros((len(columns), *(n_modes,) * len(index)))
        for axes in permutations(index):
            tensor[:, *axes] = columns.reshape(tensor[:, *axes].shape) / times
        tensors.append(tensor)
    return tuple(tensors)


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
    low = np.zeros(size.size)
    high = np.full(size.size, STABLE_RADIUS)
    for _ in range(N_BISECTIONS):
        middle = 0.5 * (low + high)
        z = middle * ray
        growth = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
        stable = np.abs(growth) <= 1.0 + NEUTRAL
        low = np.where(stable, middle, low)
        high = np.where(stable, high, middle)
    return np.divide(low, size, out=np.full(size.size, np.inf), where=size > 0.0)


def memory_length(jacobian: Array, smoothing_length: float, sound_speed: float) -> float:
    """Return the automatic memory length [s] for a Galerkin Jacobian (n_modes, n_modes) [1/s].

    It is 0.2 over the spectral radius, and at most half the time in which sound crosses a smoothing
    length: a basis of few modes may represent no sound, but the closure's residual is full of it.
    """
    longest = ACOUSTIC_RATIO * smoothing_length / sound_speed
    radius = spectral_radius(jacobian)
    return min(MEMORY_RATIO / radius, longest) if radius > 0.0 else longest


class _Parts(Record):
    """Tensors, or an array, by part of the rates; None if a scene lacks the part."""

    drives: Mapping[str, Any] = part(default_factory=dict)
    """Records of `walls` and `force` by driving parameter."""
    walls_driven: bool = False
    """Whether walls move with the amplitude."""

    @classmethod
    def of_parts(cls, by_part: Mapping[str, Any], parameters: Iterable[str], **others: Any) -> Self:
        """Return the record of parts named as in `by_part`, given the driving parameters."""
        drive = fields_of_record(cls)["drives"].record
        assert drive is not None
        drives = {
            name: drive(**{part: by_part.get(f"{part}/{name}") for part in fields_of_record(drive)})
            for name in parameters
        }
        alone = {name: x for name, x in by_part.items() if name in FACTORS}
        return cls(**alone, drives=drives, **others)

    @property
    def by_part(self) -> dict[str, Any]:
        """The parts that there are; `walls/lid` is that of walls per unit of a parameter `lid`."""
        parts = {name: getattr(self, name, None) for name in FACTORS}
        for parameter, drive in self.drives.items():
            parts |= {f"{name}/{parameter}": x for name, x in vars(drive).items()}
        return {name: x for name, x in parts.items() if x is not None}

    @cached_property
    def _affine(self) -> Affine:
        """The parts with their factors."""
        parts = self.by_part.items()
        tensors = {name: x if isinstance(x, tuple) else (x,) for name, x in parts}
        return Affine([(factor_of(name, self.walls_driven), x) for name, x in tensors.items()])


class DriveRates(Record):
    """The reduced rates caused by one parameter, through walls and the body force."""

    walls: Tensors | None = tensors(
        1, _RATES + WALLS + VALUE, f"{_PART} walls", "Eq. 3.21", symbols="cA", default=None
    )
    force: Tensors | None = tensors(
        1, _RATES + FORCE + VALUE, f"{_PART} force", "Eq. 3.21", symbols="cA", default=None
    )


class ReducedOperators(_Parts):
    """Tensors (c, A, H) of degree 0, 1 and 2 by part; None if a scene lacks the part."""

    inertia: Tensors = tensors(2, _RATES, f"{_PART} inertia", "Eq. 3.21", symbols="cAH")
    viscosity: Tensors = tensors(
        2, _RATES + VISCOUS, f"{_PART} viscosity", "Eq. 3.21", symbols="cAH"
    )
    walls: Tensors | None = tensors(
        1, _RATES + WALLS, f"{_PART} walls", "Eq. 3.21", symbols="cA", default=None
    )
    force: Tensors | None = tensors(
        1, _RATES + FORCE, f"{_PART} force", "Eq. 3.21", symbols="cA", default=None
    )
    acoustic: Array = dataset(
        "mode mode", _RATES, "linear part due to pressure and divergence alone",
        equation="Eq. 3.21",
    )  # fmt: skip
    drives: Mapping[str, DriveRates] = part(default_factory=dict)

    @property
    def n_modes(self) -> int:
        """Number of generalized coordinates."""
        return len(self.acoustic)

    @property
    def skewness(self) -> float:
        """Largest entry of the acoustic part's symmetric part, relative to the largest entry of the
        part.

        In the acoustic product it is zero up to rounding: projection creates no sound.
        """
        largest = float(np.max(np.abs(self.acoustic)))
        symmetric = float(np.max(np.abs(self.acoustic + self.acoustic.T)))
        return symmetric / largest if largest > 0.0 else 0.0

    def of_modes(self, modes: Indices) -> ReducedOperators:
        """Return the operators of some modes."""
        return self.mapped(lambda tensor: tensor[np.ix_(*(modes,) * tensor.ndim)])

    def at(self, kinematic_viscosity: float, factors: Factors = NONE) -> Polynomial:
        """Return the rates at a viscosity [m2/s] and values of the driving parameters.

        The amplitude of the polynomial is that of the body force or of driven walls.
        """
        return Polynomial(self._affine.at({VISCOSITY: kinematic_viscosity, **factors}))


class DriveResidual(Record):
    """The residual of the rates caused by one parameter."""

    walls: Array | None = dataset(
        _LINEAR, _NORM + WALLS + VALUE, _LEFT_OUT.format("walls"), default=None
    )
    force: Array | None = dataset(
        _LINEAR, _NORM + FORCE + VALUE, _LEFT_OUT.format("force"), default=None
    )


class ResidualFactor(_Parts):
    """F by part: coefficients (n_directions, n_monomials) of the monomials of a basis's modes.

    Those of walls and force are of degree one at most; None if a scene lacks the part.
    """

    inertia: Array = dataset("direction monomial", _NORM, _LEFT_OUT.format("inertia"))
    viscosity: Array = dataset("direction monomial", _NORM + VISCOUS, _LEFT_OUT.format("viscosity"))
    walls: Array | None = dataset(_LINEAR, _NORM + WALLS, _LEFT_OUT.format("walls"), default=None)
    force: Array | None = dataset(_LINEAR, _NORM + FORCE, _LEFT_OUT.format("force"), default=None)
    drives: Mapping[str, DriveResidual] = part(default_factory=dict)

    def of_model(self, operators: ReducedOperators, modes: Indices) -> ResidualFactor:
        """Return the factor of a model with some modes, in rising order, from the operators of all.

        Its rows include the rates of the other modes; there are no more rows than columns.
        """
        kept = monomials_of(modes, operators.n_modes)
        left_out = np.setdiff1d(np.arange(operators.n_modes), modes)
        parts = list[Array]()
        for name, columns in self.by_part.items():
            used = kept[: np.searchsorted(kept, columns.shape[1])]
            others = pack(tuple(tensor[left_out] for tensor in operators.by_part[name]))
            parts.append(np.concatenate((columns[:, used], others[:, used])))
        triangle = np.linalg.qr(np.hstack(parts), mode="r")
        ends = np.cumsum([part.shape[1] for part in parts])
        folded = dict(zip(self.by_part, np.split(triangle, ends[:-1], axis=1), strict=True))
        return self.of_parts(folded, self.drives, walls_driven=self.walls_driven)

    def at(self, kinematic_viscosity: float | Array, factors: Factors = NONE) -> tuple[Array, ...]:
        """Return F (..., n_directions, n_monomials) by power of the amplitude."""
        powers = self._affine.at({VISCOSITY: kinematic_viscosity, **factors})
        return tuple(factor for (factor,) in powers)


class MemoryOperators(Record):
    """The rates that a closure adds per unit of memory length, quadratic in the viscosity."""

    steady: Tensors = tensors(
        3, "of the modes, /s2", _CLOSURE, "Eq. 3.22", by="viscosity_power", at=""
    )
    force: Tensors | None = tensors(
        2, f"of the modes, /s2{FORCE}", _CLOSURE, "Eq. 3.22", by="viscosity_power", default=None
    )
    force_squared: Tensors | None = tensors(
        1, "of the modes, /s2 per squared amplitude of the body force", _CLOSURE, "Eq. 3.22",
        by="viscosity_power", default=None,
    )  # fmt: skip

    def at(self, kinematic_viscosity: float) -> Polynomial:
        """Return the polynomial at a viscosity [m2/s]."""
        parts = [
            ((AMPLITUDE,) * power + (VISCOSITY,) * degree, tuple(t[degree] for t in tensors))
            for power, tensors in enumerate((self.steady, self.force, self.force_squared))
            if tensors is not None
            for degree in range(len(tensors[0]))
        ]
        return Polynomial(Affine(parts).at({VISCOSITY: kinematic_viscosity}))


def residual_norm(
    factor: ResidualFactor,
    kinematic_viscosity: float,
    states: Array,
    amplitude: Array | None = None,
    factors: Factors = NONE,
    closure: Polynomial | None = None,
) -> Array:
    """Return the norm (..., n_states) [/s] of a model's residual at (..., n_states, n_modes).

    Parameters
    ----------
    factor : of the model.
    amplitude : (n_states,) of the body force or of driven walls, None if there is none.
    factors : the values of the driving parameters.
    closure : the rates that a closure adds to the projected ones.
    """
    steady, *driven = factor.at(kinematic_viscosity, factors)
    values = monomials(states)
    residual = values @ steady.swapaxes(-1, -2)
    pushes = np.zeros(states.shape[:-1]) if amplitude is None else amplitude
    for power, coefficients in enumerate(driven, 1):
        used = values[..., : coefficients.shape[-1]]
        residual += pushes[..., None] ** power * (used @ coefficients.swapaxes(-1, -2))
    squares = np.sum(residual**2, axis=-1)
    if closure is not None:
        squares += np.sum(closure.along(states, pushes) ** 2, axis=-1)
    return np.asarray(np.sqrt(squares))
