"""Memory operators in the artifact: what Eq. 3.22 adds to the rates, per unit of memory length.

They are quadratic in the viscosity, and so assembled at three viscosities. The residual that they
are made of is what projection onto so many modes leaves: those of fewer modes are no part of them,
and every size of basis that a model asks for has its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.reduction.memory_operators import project_memory
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.online import ACOUSTIC_RATIO, MEMORY_RATIO
from sphrom.reduction.polynomial import Polynomial, Tensors, spectrum
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Order

Array = NDArray[np.float64]

DEGREES = ("constant", "linear", "quadratic", "cubic")
AMPLITUDES = ("", "force/", "force_squared/")
"""Groups of the tensors that the amplitude's powers multiply: a body force's or driven walls'."""


@dataclass(frozen=True)
class MemoryOperators:
    """A polynomial whose tensors are quadratic in the kinematic viscosity."""

    coefficients: tuple[Polynomial, Polynomial, Polynomial]
    """Of the viscosity's powers 0, 1 and 2."""

    def at(self, kinematic_viscosity: float) -> Polynomial:
        """Return the polynomial at a viscosity [m2/s]."""
        zeroth, first, second = self.coefficients
        return _combined(
            (1.0, zeroth), (kinematic_viscosity, first), (kinematic_viscosity**2, second)
        )


def project_memory_operators(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None,
    *,
    largest_viscosity: float,
    order: Order,
) -> MemoryOperators:
    """Assemble the operators of all viscosities, from those at 0, a half of the largest, and it."""
    nu = largest_viscosity
    low, middle, high = (
        project_memory(points, basis, splines, kinematic_viscosity=share * nu, order=order)
        for share in (0.0, 0.5, 1.0)
    )
    slope = _combined((-3.0 / nu, low), (4.0 / nu, middle), (-1.0 / nu, high))
    curvature = _combined((2.0 / nu**2, low), (-4.0 / nu**2, middle), (2.0 / nu**2, high))
    return MemoryOperators((low, slope, curvature))


def _combined(*parts: tuple[float, Polynomial]) -> Polynomial:
    """Return a sum of polynomials of the same degrees, each times its factor."""
    factors = [factor for factor, _ in parts]

    def added(tensors: tuple[Array, ...]) -> Array:
        return np.asarray(sum(f * t for f, t in zip(factors, tensors, strict=True)))

    powers = zip(*(polynomial.powers for _, polynomial in parts), strict=True)
    return Polynomial(tuple(tuple(map(added, zip(*tensors, strict=True))) for tensors in powers))


def write_memory(artifact: ArtifactWriter, group: str, operators: MemoryOperators) -> None:
    """Write memory operators; the viscosity's power is the first axis of every dataset."""
    by_amplitude = zip(*(p.powers for p in operators.coefficients), strict=True)
    for where, by_viscosity in zip(AMPLITUDES, by_amplitude, strict=False):
        for degree, tensors in enumerate(zip(*by_viscosity, strict=True)):
            artifact.write(f"{group}/{where}{DEGREES[degree]}", np.stack(tensors))


def read_memory(artifact: Artifact, group: str) -> MemoryOperators:
    """Read memory operators back."""
    powers: list[list[Array]] = []
    for p, where in enumerate(AMPLITUDES):
        names = [f"{group}/{where}{degree}" for degree in DEGREES[: len(DEGREES) - p]]
        if names[0] in artifact:
            powers.append([artifact.read(name) for name in names])

    def of(viscosity_power: int) -> Polynomial:
        chosen: list[Tensors] = [tuple(t[viscosity_power] for t in tensors) for tensors in powers]
        return Polynomial(tuple(chosen))

    return MemoryOperators((of(0), of(1), of(2)))


def memory_group(basis: str, n_modes: int) -> str:
    """Return where the operators of a size of basis are in the artifact."""
    return f"bases/{basis}/memory/{n_modes}"


def timing(basis: str, n_modes: int) -> str:
    """Return the attribute that says what the operators of a size of basis took."""
    return f"timing/memory-{basis}-{n_modes}"


def largest_viscosity(case: Case) -> float:
    """Return the largest kinematic viscosity that is trained on [m2/s]."""
    return max(case.kinematic_viscosity(point) for point in case.train_points)


def automatic_memory_length(case: Case, jacobian: Array) -> float:
    """Return the memory length of a Jacobian (n_modes, n_modes) [1/s], in [s].

    By the rule of `sphrom.reduction.online.automatic_memory_length`.
    """
    longest = ACOUSTIC_RATIO * case.smoothing_length / case.sound_speed
    radius = spectrum(jacobian).radius
    return min(MEMORY_RATIO / radius, longest) if radius > 0.0 else longest
