"""The trial bases and the splines of their modes, in their artifacts."""

from __future__ import annotations

from collections.abc import Iterator

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import read_record
from sphrom.case.points import ParameterPoint
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis, truncate
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def inner_product(workspace: Workspace) -> InnerProduct:
    """Return the product in which the modes of the case are orthonormal."""
    product = assembly.inner_product(workspace.case)
    return product.without_mean() if workspace.case.plan.separate_mean_density else product


def read_points(workspace: Workspace) -> Array:
    """Read the points of the reference space (n_points, 2) [m]."""
    with workspace.open(workspace.basis()) as artifact:
        return artifact.read("reference_position")


def read_basis(workspace: Workspace, name: str) -> TrialBasis:
    """Read one trial basis."""
    product = inner_product(workspace)
    with workspace.open(workspace.basis()) as artifact:
        return read_record(
            artifact,
            TrialBasis,
            f"bases/{name}",
            inner_product=product,
            weights=product.weights(artifact.read("volume")),
            separate_mean=workspace.case.plan.separate_mean_density,
        )


def mapped_runs(
    workspace: Workspace, name: str
) -> Iterator[tuple[ParameterPoint, h5py.Dataset, h5py.Dataset]]:
    """Yield the training points of a basis, with their mapped density fluctuations and velocities.

    These are open until the next one is asked for.
    """
    for point in workspace.case.plan.bases[name]:
        with workspace.open(workspace.mapped(point)) as mapped:
            yield point, mapped.dataset("density_fluctuation"), mapped.dataset("velocity")


def read_splines(workspace: Workspace, name: str) -> ModeSplines:
    """Read the splines of one basis."""
    domain, group = workspace.case.scene.domain, f"bases/{name}"
    with workspace.open(workspace.splines()) as artifact:
        # Kernels of splines take long to load, and few runs need them.
        if workspace.case.plan.lattice_splines:
            from sphrom.reduction.lattice_splines import LatticeSplines

            return read_record(artifact, LatticeSplines, group, domain=domain)
        from sphrom.reduction.spline import LocalSplines

        return read_record(
            artifact,
            LocalSplines,
            group,
            order=int(artifact.number("spline_order")),
            polynomial_degree=int(artifact.number("polynomial_degree")),
            domain=domain,
        )


def read_model_splines(workspace: Workspace, name: str, n_modes: int) -> ModeSplines:
    """Read the splines of a basis's first modes."""
    return read_modes(workspace, name, n_modes)[1]


def read_modes(workspace: Workspace, name: str, n_modes: int) -> tuple[TrialBasis, ModeSplines]:
    """Read the first modes of a basis, and their splines."""
    whole, splines = read_basis(workspace, name), read_splines(workspace, name)
    return truncate(whole, n_modes), first_modes(splines, whole, n_modes)
