"""The bases and splines of modes in their artifacts.

Modes are orthonormal, so the coordinates in fewer modes are the first stored ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import h5py
import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Samples
from sphrom.reduction.mode_splines import ModeSplines, Values
from sphrom.reduction.trial_basis import TrialBasis, truncate, with_pressures
from sphrom.setup import assembly
from sphrom.sph.fluid import pressure_of
from sphrom.store.workspace import Workspace


def read_points(workspace: Workspace) -> Array:
    """Read the points of the reference space (n_points, n_dim) [m]."""
    with workspace.open(workspace.basis()) as artifact:
        return artifact.read("reference_position")


def read_basis(workspace: Workspace, name: str) -> TrialBasis:
    """Read one trial basis."""
    product = assembly.inner_product(workspace.case)
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

    The datasets are open until the next ones are requested.
    """
    for point in workspace.case.plan.bases[name]:
        with workspace.open(workspace.mapped(point)) as mapped:
            yield point, mapped.dataset("density_fluctuation"), mapped.dataset("velocity")


def read_splines(workspace: Workspace, name: str, *, of_pressure: bool = False) -> ModeSplines:
    """Read the splines of one basis, or those of its pressure modes."""
    case = workspace.case
    domain = case.scene.domain
    target = workspace.operators() if of_pressure else workspace.splines()
    group = f"{'pressure_splines' if of_pressure else 'bases'}/{name}"
    with workspace.open(target) as artifact:
        # Kernels of splines take long to import, and few runs need them.
        if case.plan.lattice_splines:
            from sphrom.reduction.lattice_splines import LatticeSplines

            return read_record(artifact, LatticeSplines, group, domain=domain)
        from sphrom.reduction.spline import LocalSplines

        return read_record(
            artifact,
            LocalSplines,
            group,
            order=case.psi.order,
            polynomial_degree=case.psi.polynomial_degree,
            domain=domain,
        )


def read_modes(workspace: Workspace, name: str, n_modes: int) -> tuple[TrialBasis, ModeSplines]:
    """Read the first modes of a basis, and their splines."""
    basis = truncate(read_basis(workspace, name), n_modes)
    return basis, read_splines(workspace, name).first(n_modes)


def read_whole(workspace: Workspace, name: str, n_modes: int, *, own_pressure: bool) -> TrialBasis:
    """Read the first modes of a basis, and then its pressure modes if asked."""
    basis = truncate(read_basis(workspace, name), n_modes)
    if not own_pressure:
        return basis
    with workspace.open(workspace.operators()) as artifact:
        return with_pressures(basis, artifact.read(f"bases/{name}/pressure/modes"))


def read_values(workspace: Workspace, name: str, n_modes: int, *, own_pressure: bool) -> Values:
    """Return the values of the first modes of a basis, and then of its pressure modes if asked."""
    values = read_splines(workspace, name).first(n_modes).values
    if not own_pressure:
        return values
    of_pressure = read_splines(workspace, name, of_pressure=True).values
    return both(values, of_pressure)


def both(modes: Values, pressures: Values) -> Values:
    """Return the values of modes, and then of pressure modes, given their pressures alone."""

    def values(points: Array) -> Array:
        own = pressures(points)
        at_rest = [0.0 * own] * points.shape[1]
        fields = np.stack((own, *at_rest), axis=2)
        return np.hstack((modes(points), fields.reshape(len(own), -1)))

    return values


def expand(
    case: Case,
    basis: TrialBasis,
    values_at: Values,
    points: Array,
    times: Array,
    coordinates: Array,
    mean_density: Array,
) -> Samples:
    """Sample the states with coordinates (n_snapshots, n_modes) at points by the modes' values.

    `mean_density` (n_snapshots,) [kg/m3] is the separate mean of a basis that has one, else zero.
    """
    values = values_at(points).reshape(*points.shape[:1], -1, 1 + points.shape[1])
    fields = np.tensordot(coordinates, values, (1, 1))
    density = basis.inner_product.density_fluctuation(fields[..., 0]) + mean_density[:, None]
    return Samples(times, fields[..., 1:], pressure_of(density, case.plan.sound_speed))
