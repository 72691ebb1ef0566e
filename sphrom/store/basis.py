"""The trial bases in their artifact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.basis import Modes, Offset, OneBasis
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
PARTS = ("joint", "density", "velocity")
"""Of a basis, in the order of its modes."""


def inner_product(workspace: Workspace) -> InnerProduct:
    """Return the product in which the modes of the case are orthonormal."""
    product = assembly.inner_product(workspace.case)
    return product.without_mean() if workspace.case.plan.separate_mean_density else product


def read_points(workspace: Workspace) -> Array:
    """Read the points of the reference space (n_points, 2) [m]."""
    with workspace.open(workspace.basis()) as artifact:
        return artifact.read("reference_position")


def write_basis(
    workspace: Workspace, artifact: ArtifactWriter, name: str, basis: TrialBasis
) -> None:
    """Write one trial basis."""
    offset = basis.offset
    stored = OneBasis(
        modes=Modes(density=basis.density_modes, velocity=basis.velocity_modes),
        offset=None if offset is None else Offset(density=offset[0], velocity=offset[1]),
        singular_values=basis.singular_values,
        train=np.array([list(p.as_dict().values()) for p in workspace.case.plan.bases[name]]),
        gram_error=basis.gram_error,
    )
    write_record(artifact, stored, f"bases/{name}")


def read_basis(workspace: Workspace, name: str) -> TrialBasis:
    """Read one trial basis back."""
    with workspace.open(workspace.basis()) as artifact:
        stored = read_record(artifact, OneBasis, f"bases/{name}")
        volume = artifact.read("volume")
    offset, values, product = stored.offset, stored.singular_values, inner_product(workspace)
    return TrialBasis(
        density_modes=stored.modes.density,
        velocity_modes=stored.modes.velocity,
        offset=None if offset is None else (offset.density, offset.velocity),
        singular_values={part: values[part] for part in PARTS if part in values},
        inner_product=product,
        weights=product.weights(volume),
        gram_error=stored.gram_error,
        separate_mean=workspace.case.plan.separate_mean_density,
    )
