"""Stage `fit-psi`: splines of the modes, local polyharmonic ones (Eq. 3.17-3.19, Alg. 3.3) or
B-splines on a lattice."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.errors import CaseError
from sphrom.reduction.bspline import LatticeSplines, fit_lattice_splines
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.spline import LocalSplines, default_cell_width, fit_splines
from sphrom.reduction.spline_cells import fitting_cells
from sphrom.reduction.trial_basis import TrialBasis, kept_modes
from sphrom.stages import assembly
from sphrom.stages.check import require_room
from sphrom.stages.context import StageContext
from sphrom.stages.pod import read_basis
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]


def run(context: StageContext) -> None:
    """Fit splines to the modes of every basis."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, None, "fit-psi")
    target = workspace.splines()
    if not workspace.wanted(target):
        return
    case = context.case
    with workspace.open(workspace.basis()) as basis:
        points = basis.read("reference_position")
    lattice = case.psi.kind == "b-spline"
    polyharmonic = {
        "spline_order": case.psi.order,
        "polynomial_degree": case.psi.polynomial_degree,
    }
    attributes = {} if lattice else polyharmonic
    with workspace.create(target, attributes) as artifact:
        started = time.perf_counter()
        for name in case.bases:
            modes = read_basis(workspace, name)
            if lattice:
                _fit_lattice(workspace, artifact, points, modes, name)
            else:
                splines = _fit(workspace, points, modes, name)
                _write(artifact, name, splines)
                workspace.context.report.info(_summary(name, splines))
        artifact.annotate("timing/fit", time.perf_counter() - started)


def _fit(workspace: Workspace, points: Array, basis: TrialBasis, name: str) -> LocalSplines:
    case = workspace.case
    ratio = case.psi.cell_width_ratio
    domain = assembly.domain(case)
    width = (
        default_cell_width(domain, len(points)) if ratio is None else ratio * case.particle_spacing
    )
    n_cells = math.prod(fitting_cells(domain, width))
    with workspace.context.report.progress(f"splines, basis {name}", n_cells) as advance:
        try:
            return fit_splines(
                points,
                columns(basis),
                domain,
                order=case.psi.order,
                polynomial_degree=case.psi.polynomial_degree,
                cell_width=width,
                progress=advance,
            )
        except ValueError as error:
            raise CaseError(f"psi: {error}") from error


def _fit_lattice(
    workspace: Workspace, artifact: ArtifactWriter, points: Array, basis: TrialBasis, name: str
) -> None:
    """Fit B-splines to the modes of a basis, and write them."""
    try:
        splines = fit_lattice_splines(points, columns(basis), assembly.domain(workspace.case))
    except ValueError as error:
        raise CaseError(f"psi.kind: {error}; set psi.kind to polyharmonic") from error
    group = f"bases/{name}"
    artifact.write(f"{group}/lattice_shape", np.array(splines.lattice_shape, dtype=np.int64))
    artifact.write(f"{group}/coefficients", splines.coefficients)
    n_columns, n_rows = splines.lattice_shape
    workspace.context.report.info(
        f"basis {name}: {splines.n_columns} B-splines on {n_columns} x {n_rows} points"
    )


def columns(basis: TrialBasis) -> Array:
    """Return a basis as columns (n_points, 3 n_modes): first field and velocity, mode by mode.

    The mean of a centred basis stands last, as if it were a mode more.
    """
    modes = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
    if basis.offset is not None:
        mean = np.concatenate((basis.offset[0][:, None], basis.offset[1]), axis=1)
        modes = np.concatenate((modes, mean[None]))
    return np.ascontiguousarray(modes.transpose(1, 0, 2).reshape(modes.shape[1], -1))


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


def select(splines: ModeSplines, chosen: NDArray[np.int64]) -> ModeSplines:
    """Return the splines of some columns."""
    return splines.select(chosen)


def read_model_splines(workspace: Workspace, name: str, n_modes: int) -> ModeSplines:
    """Read the splines of a basis's first modes (of each part, where they are separate)."""
    basis = read_basis(workspace, name)
    chosen = spline_columns(basis, kept_modes(basis, n_modes))
    return select(read_splines(workspace, name), chosen)


def spline_columns(basis: TrialBasis, modes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the columns of splines that belong to some modes, and to the mean of the basis."""
    if basis.offset is not None:
        modes = np.append(modes, basis.n_modes)
    return (3 * modes[:, None] + np.arange(3)).ravel()


def _write(artifact: ArtifactWriter, name: str, splines: LocalSplines) -> None:
    group = f"bases/{name}"
    artifact.write(f"{group}/cell_shape", np.array(splines.cell_shape, dtype=np.int64))
    artifact.write(f"{group}/cell_start", splines.cell_start)
    artifact.write(f"{group}/points", splines.points)
    artifact.write(f"{group}/radial_weights", np.ascontiguousarray(splines.radial_weights.T))
    artifact.write(f"{group}/polynomial_weights", splines.polynomial_weights)
    artifact.write(f"{group}/condition_number", splines.condition_number)


def _summary(name: str, splines: LocalSplines) -> str:
    counts = np.diff(splines.cell_start)
    fitted = counts > 0
    solid = f", {np.sum(~fitted)} more in solids" if not fitted.all() else ""
    condition = splines.condition_number[fitted]
    return (
        f"basis {name}: {splines.n_columns} splines over {np.sum(fitted)} cells of "
        f"{counts[fitted].min()} to {counts.max()} points{solid}; condition number "
        f"{np.median(condition):.1e} in the median, {condition.max():.1e} at most"
    )
