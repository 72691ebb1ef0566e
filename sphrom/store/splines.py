"""The splines of the modes in their artifact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.reduction.bspline import LatticeSplines
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.spline import LocalSplines
from sphrom.reduction.trial_basis import TrialBasis, truncate
from sphrom.setup import assembly
from sphrom.store.basis import read_basis
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def read_splines(workspace: Workspace, name: str) -> ModeSplines:
    """Read the splines of one basis back."""
    lattice = workspace.case.psi.kind == "b-spline"
    return _read_lattice(workspace, name) if lattice else _read_polyharmonic(workspace, name)


def _read_lattice(workspace: Workspace, name: str) -> LatticeSplines:
    with workspace.open(workspace.splines()) as artifact:
        shape = artifact.read(f"bases/{name}/lattice_shape")
        return LatticeSplines(
            domain=assembly.domain(workspace.case),
            lattice_shape=(int(shape[0]), int(shape[1])),
            coefficients=artifact.read(f"bases/{name}/coefficients"),
        )


def _read_polyharmonic(workspace: Workspace, name: str) -> LocalSplines:
    with workspace.open(workspace.splines()) as artifact:
        group = f"bases/{name}"
        shape = artifact.read(f"{group}/cell_shape")
        return LocalSplines(
            order=int(artifact.number("spline_order")),
            polynomial_degree=int(artifact.number("polynomial_degree")),
            domain=assembly.domain(workspace.case),
            cell_shape=(int(shape[0]), int(shape[1])),
            cell_start=artifact.read(f"{group}/cell_start"),
            points=artifact.read(f"{group}/points"),
            radial_weights=artifact.read(f"{group}/radial_weights").T,
            polynomial_weights=artifact.read(f"{group}/polynomial_weights"),
            condition_number=artifact.read(f"{group}/condition_number"),
        )


def read_model_splines(workspace: Workspace, name: str, n_modes: int) -> ModeSplines:
    """Read the splines of a basis's first modes (of each part, where they are separate)."""
    return first_modes(read_splines(workspace, name), read_basis(workspace, name), n_modes)


def read_modes(workspace: Workspace, name: str, n_modes: int) -> tuple[TrialBasis, ModeSplines]:
    """Read the first modes of a basis, and their splines."""
    whole = read_basis(workspace, name)
    return truncate(whole, n_modes), first_modes(read_splines(workspace, name), whole, n_modes)


def write_splines(artifact: ArtifactWriter, name: str, splines: LocalSplines) -> None:
    """Write the polyharmonic splines of a basis."""
    group = f"bases/{name}"
    artifact.write(f"{group}/cell_shape", np.array(splines.cell_shape, dtype=np.int64))
    artifact.write(f"{group}/cell_start", splines.cell_start)
    artifact.write(f"{group}/points", splines.points)
    artifact.write(f"{group}/radial_weights", np.ascontiguousarray(splines.radial_weights.T))
    artifact.write(f"{group}/polynomial_weights", splines.polynomial_weights)
    artifact.write(f"{group}/condition_number", splines.condition_number)
