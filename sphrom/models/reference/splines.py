"""Stage `fit-psi`: splines of the modes (Eq. 3.17-3.19, Alg. 3.3), or B-splines on a lattice."""

from __future__ import annotations

import math
import time

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import write_record
from sphrom.case.models import Case
from sphrom.console import Reporter
from sphrom.errors import CaseError
from sphrom.models.reference.stored import read_basis, read_points
from sphrom.reduction import spline
from sphrom.reduction.lattice_splines import LatticeSplines, fit_lattice_splines
from sphrom.reduction.mode_splines import basis_columns
from sphrom.reduction.spline import LocalSplines
from sphrom.store.workspace import Workspace


def fit_splines(workspace: Workspace) -> None:
    """Fit splines to the modes of every basis, unless they are up to date."""
    target = workspace.splines()
    if not workspace.must_make(target):
        return
    case = workspace.case
    report = workspace.context.report
    points = read_points(workspace)
    kind = {"spline_order": case.psi.order, "polynomial_degree": case.psi.polynomial_degree}
    attributes = {} if case.plan.lattice_splines else kind
    with workspace.create(target, attributes) as artifact:
        started = time.perf_counter()
        for name in case.plan.bases:
            columns = basis_columns(read_basis(workspace, name))
            splines = fit(case, points, columns, f"basis {name}", report)
            write_record(artifact, splines, f"bases/{name}")
            report.info(f"basis {name}: {splines.n_columns} {_summary(splines)}")
        artifact.annotate("timing/fit", time.perf_counter() - started)


def fit(
    case: Case, points: Array, columns: Array, name: str, report: Reporter
) -> LocalSplines | LatticeSplines:
    """Return the splines of functions (n_points, n_columns) through points (n_points, n_dim) [m].

    Raises CaseError if they can't be fitted.
    """
    domain = case.scene.domain
    if case.plan.lattice_splines:
        try:
            return fit_lattice_splines(points, columns, domain)
        except ValueError as error:
            raise CaseError(f"psi.kind: {error}; set psi.kind to polyharmonic") from error
    width = spline.default_cell_width(domain, len(points))
    n_cells = math.prod(spline.fitting_cells(domain, width))
    with report.progress(f"splines, {name}", n_cells) as advance:
        try:
            return spline.fit_splines(
                points,
                columns,
                domain,
                order=case.psi.order,
                polynomial_degree=case.psi.polynomial_degree,
                cell_width=width,
                progress=advance,
            )
        except ValueError as error:
            raise CaseError(f"psi: {error}") from error


def _summary(splines: LocalSplines | LatticeSplines) -> str:
    if isinstance(splines, LatticeSplines):
        return f"B-splines on {' x '.join(map(str, splines.lattice_shape))} points"
    counts = np.diff(splines.cell_start)
    fitted = counts > 0
    solid = f", {np.sum(~fitted)} more in solids" if not fitted.all() else ""
    condition = splines.condition_number[fitted]
    return (
        f"splines over {np.sum(fitted)} cells of {counts[fitted].min()} to {counts.max()} "
        f"points{solid}; condition number {np.median(condition):.1e} in the median, "
        f"{condition.max():.1e} at most"
    )
