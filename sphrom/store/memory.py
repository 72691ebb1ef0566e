"""Memory operators in the artifact: what Eq. 3.22 adds to the rates, per unit of memory length.

They are quadratic in the viscosity, and so assembled at three viscosities. The residual that they
are made of is what projection onto so many modes leaves: those of fewer modes are no part of them,
and every size of basis that a model asks for has its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.reduction.memory_operators import MemoryOperators
from sphrom.reduction.polynomial import Polynomial, Tensors

Array = NDArray[np.float64]

DEGREES = ("constant", "linear", "quadratic", "cubic")
AMPLITUDES = ("", "force/", "force_squared/")
"""Groups of the tensors that the amplitude's powers multiply: a body force's or driven walls'."""


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
