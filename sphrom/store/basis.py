"""The trial bases in their artifact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def inner_product(workspace: Workspace) -> InnerProduct:
    """Return the product in which the modes of the case are orthonormal."""
    product = assembly.inner_product(workspace.case)
    return product.without_mean() if workspace.case.separate_mean_density else product


def write_basis(
    workspace: Workspace, artifact: ArtifactWriter, name: str, basis: TrialBasis
) -> None:
    """Write one trial basis."""
    group = f"bases/{name}"
    artifact.write(f"{group}/modes/density", basis.density_modes)
    artifact.write(f"{group}/modes/velocity", basis.velocity_modes)
    if basis.offset is not None:
        artifact.write(f"{group}/offset/density", basis.offset[0])
        artifact.write(f"{group}/offset/velocity", basis.offset[1])
    for part, values in basis.singular_values.items():
        artifact.write(f"{group}/singular_values/{part}", values)
    trained = [list(point.as_dict().values()) for point in workspace.case.bases[name]]
    artifact.write(f"{group}/train", np.array(trained))
    artifact.annotate(f"{group}/gram_error", basis.gram_error)


def read_basis(workspace: Workspace, name: str) -> TrialBasis:
    """Read one trial basis back."""
    with workspace.open(workspace.basis()) as artifact:
        group = f"bases/{name}"
        offset = None
        if f"{group}/offset/density" in artifact:
            offset = (
                artifact.read(f"{group}/offset/density"),
                artifact.read(f"{group}/offset/velocity"),
            )
        parts = [
            p
            for p in ("joint", "density", "velocity")
            if f"{group}/singular_values/{p}" in artifact
        ]
        product = inner_product(workspace)
        return TrialBasis(
            density_modes=artifact.read(f"{group}/modes/density"),
            velocity_modes=artifact.read(f"{group}/modes/velocity"),
            offset=offset,
            singular_values={p: artifact.read(f"{group}/singular_values/{p}") for p in parts},
            inner_product=product,
            weights=product.weights(artifact.read("volume")),
            gram_error=artifact.number(f"{group}/gram_error"),
            separate_mean=workspace.case.separate_mean_density,
        )
