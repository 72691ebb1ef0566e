"""Command `figures`: the figures that a case asks for by name, from what its runs left.

Nothing is run: fields come from the runs, lines and errors from the comparison, modes and singular
values from the bases.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sphrom.case.figures import (
    ErrorFigure,
    FieldFigure,
    FigureSection,
    LineFigure,
    ModeFigure,
    SpectrumFigure,
)
from sphrom.compare.plots import spectra
from sphrom.compare.run_figures import draw_errors, draw_lines, draw_snapshots, frame_of
from sphrom.compare.stored import StoredComparison, StoredRuns
from sphrom.errors import ArtifactError
from sphrom.metrics.discrepancy import cumulative_singular_value_share
from sphrom.plots.canvas import save
from sphrom.plots.curves import draw_singular_values
from sphrom.plots.panels import Field, draw_field_grid
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = "figures"
"""Where the pictures are, beside the artifacts."""
SPACES = {"Lagrangian": "lagrangian", "reference": "bases"}
"""Rows of a figure of modes, and where the artifact of the bases has them."""
COMPONENTS = {"x-velocity": 0, "y-velocity": 1}


def run(context: StageContext) -> None:
    """Draw every figure that the case asks for into the folder `figures`.

    Raises ArtifactError where a run, a basis or the comparison that one shows is missing.
    """
    workspace, wanted = Workspace(context), context.case.compare.figures
    if not wanted:
        context.report.info("compare.figures asks for no figure")
        return
    runs, folder = StoredRuns(workspace), workspace.folder(FOLDER)
    with (
        StoredComparison.of(workspace) as comparison,
        context.report.progress("figures", len(wanted)) as advance,
    ):
        for figure in wanted:
            drawn = _draw(workspace, runs, comparison, figure)
            save(drawn, folder / f"{figure.name}.png")
            advance(1)
    context.report.info(f"{len(wanted)} figures are in {folder}")


def _draw(
    workspace: Workspace, runs: StoredRuns, comparison: StoredComparison, figure: FigureSection
) -> Figure:
    match figure:
        case FieldFigure():
            return draw_snapshots(workspace.case, runs, figure)
        case LineFigure():
            return draw_lines(workspace.case, comparison, figure)
        case ErrorFigure():
            return draw_errors(workspace.case, comparison, figure)
        case SpectrumFigure():
            return _spectrum(workspace, figure)
        case ModeFigure():
            return _modes(workspace, figure)


def _spectrum(workspace: Workspace, figure: SpectrumFigure) -> Figure:
    """Draw singular values; the legend tells the shares of so many modes."""
    chosen = {}
    for space, basis, part, values in spectra(workspace):
        if basis != figure.basis:
            continue
        shares = cumulative_singular_value_share(values)
        told = ", ".join(f"{_share(shares[m - 1])} % (M = {m})" for m in figure.modes
                         if m <= len(shares))  # fmt: skip
        name = f"{space} space" if part == "joint" else f"{space} space, {part}"
        chosen[f"{name}: {told}"] = values
    return draw_singular_values(chosen, figure.modes)


def _share(share: float) -> str:
    """Return a share [%] with two digits of what it leaves out."""
    for digits in range(1, 12):
        if round(100.0 - share, digits) >= 10.0 ** (1 - digits):
            return f"{share:.{digits}f}"
    return f"{share:.12g}"


def _modes(workspace: Workspace, figure: ModeFigure) -> Figure:
    rows = []
    field = "density" if figure.field == "density" else "velocity"
    with workspace.open(workspace.basis()) as artifact:
        for space, parent in SPACES.items():
            name = f"{parent}/{figure.basis}/modes/{field}"
            if name not in artifact:  # Lagrangian ones are kept where the case asks for them
                continue
            where = "reference" if parent == "bases" else parent
            position, modes = artifact.read(f"{where}_position"), artifact.dataset(name)
            row = []
            for number in figure.modes:
                if number > artifact.length(name):
                    raise ArtifactError(f"{artifact.path} has no mode {number} of {figure.basis}")
                values = modes[number - 1]
                if figure.field in COMPONENTS:
                    values = values[:, COMPONENTS[figure.field]]
                row.append(Field(f"{space} space, mode {number}", figure.field, position, values))
            rows.append(row)
    return draw_field_grid(frame_of(workspace.case), rows, scales=None, title=figure.field)
