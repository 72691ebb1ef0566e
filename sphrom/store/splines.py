"""The splines of the modes in their artifact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.operators import CellSplines, LatticeSplines
from sphrom.reduction import bspline
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.spline import LocalSplines
from sphrom.reduction.trial_basis import TrialBasis, truncate
from sphrom.store.basis import read_basis
from sphrom.store.workspace import Workspace

Indices = NDArray[np.int64]


def write_splines(
    artifact: ArtifactWriter, name: str, splines: LocalSplines | bspline.LatticeSplines
) -> None:
    """Write the splines of a basis."""
    stored: CellSplines | LatticeSplines
    if isinstance(splines, LocalSplines):
        stored = CellSplines.of(
            splines,
            cell_shape=np.array(splines.cell_shape, dtype=np.int64),
            radial_weights=np.ascontiguousarray(splines.radial_weights.T),
        )
    else:
        shape = np.array(splines.lattice_shape, dtype=np.int64)
        stored = LatticeSplines(lattice_shape=shape, coefficients=splines.coefficients)
    write_record(artifact, stored, f"bases/{name}")


def read_splines(workspace: Workspace, name: str) -> ModeSplines:
    """Read the splines of one basis back."""
    domain, group = workspace.case.scene.domain, f"bases/{name}"
    with (
        workspace.open(workspace.splines()) as artifact,
        artifact.refused_where_it_does_not_fit(),
    ):
        if workspace.case.plan.lattice_splines:
            lattice = read_record(artifact, LatticeSplines, group)
            shape = _pair(lattice.lattice_shape)
            return bspline.LatticeSplines(domain, shape, lattice.coefficients)
        stored = read_record(artifact, CellSplines, group)
        return LocalSplines(
            order=int(artifact.number("spline_order")),
            polynomial_degree=int(artifact.number("polynomial_degree")),
            domain=domain,
            cell_shape=_pair(stored.cell_shape),
            cell_start=stored.cell_start,
            points=stored.points,
            radial_weights=stored.radial_weights.T,
            polynomial_weights=stored.polynomial_weights,
            condition_number=stored.condition_number,
        )


def _pair(shape: Indices) -> tuple[int, int]:
    return int(shape[0]), int(shape[1])


def read_model_splines(workspace: Workspace, name: str, n_modes: int) -> ModeSplines:
    """Read the splines of a basis's first modes (of each part, where they are separate)."""
    return read_modes(workspace, name, n_modes)[1]


def read_modes(workspace: Workspace, name: str, n_modes: int) -> tuple[TrialBasis, ModeSplines]:
    """Read the first modes of a basis, and their splines."""
    whole, splines = read_basis(workspace, name), read_splines(workspace, name)
    with (
        workspace.open(workspace.splines()) as artifact,
        artifact.refused_where_it_does_not_fit(),
    ):
        return truncate(whole, n_modes), first_modes(splines, whole, n_modes)
