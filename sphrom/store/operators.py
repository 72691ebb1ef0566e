"""The projected operators in their artifact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.reduction.operators import PARTS, ReducedOperators

Array = NDArray[np.float64]

DEGREES = ("constant", "linear", "quadratic")


def write_operators(artifact: ArtifactWriter, name: str, operators: ReducedOperators) -> None:
    """Write the operators of a basis."""
    for part in PARTS:
        tensors = getattr(operators, part)
        for degree, tensor in zip(DEGREES, tensors or (), strict=False):
            artifact.write(f"bases/{name}/{part}/{degree}", tensor)
    artifact.write(f"bases/{name}/acoustic", operators.acoustic)


def read_operators(artifact: Artifact, name: str, modes: NDArray[np.int64]) -> ReducedOperators:
    """Read the operators of some modes of a basis back."""
    group = f"bases/{name}"

    def tensors(part: str) -> tuple[Array, ...] | None:
        if f"{group}/{part}/constant" not in artifact:
            return None
        return tuple(
            artifact.read(f"{group}/{part}/{DEGREES[degree]}")[np.ix_(*(modes,) * (degree + 1))]
            for degree in range(PARTS[part] + 1)
        )

    return ReducedOperators(
        inertia=tensors("inertia") or (),
        viscosity=tensors("viscosity") or (),
        walls=tensors("walls"),
        force=tensors("force"),
        acoustic=artifact.read(f"{group}/acoustic")[np.ix_(modes, modes)],
        order=1 if artifact.number("density_order") else 0,
        walls_driven=artifact.number("walls_driven") == 1.0,
    )
