"""Singular values and modes of the bases of a case: the rows of their table, and their figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.compare.comparison_tables import SpectrumRow
from sphrom.metrics.grids import Slices
from sphrom.metrics.histories import cumulative_singular_value_share, energy
from sphrom.models.contract import basis_used
from sphrom.plots.arrangement import FLAT
from sphrom.plots.frames import Frame
from sphrom.plots.panels import Curve, Field, Panel, draw_grid
from sphrom.setup.assembly import has_air
from sphrom.setup.draw import solids_within
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPACES = {
    "reference": ("bases", "reference_position"),
    "Lagrangian": ("lagrangian", "lagrangian_position"),
}
"""Spaces of modes, with the groups of their modes and points in the artifact of the bases."""
COMPONENTS = {"x-velocity": 0, "y-velocity": 1, "z-velocity": 2}
MOST_MODES, MOST_FLAT = 6, 4
"""Largest numbers of pictures of modes in a row, and of flat pictures."""
SMALLEST_RATIO, SMALLEST_SHARE = 1e-12, 1e-10
"""Singular values relative to the first, and omitted shares [%], below which they are rounding
errors."""
SPECTRUM = ("singular value, relative to the first [–]", "later singular values, of the sum [%]")


def frame_of(case: Case) -> Frame:
    """Return the part of the plane that pictures of a case show."""
    box = case.scene.domain
    slices = Slices(box.lower, box.upper)
    solids = None if box.fills_box else solids_within(box, slices.extent)
    plane = None if slices.is_plane else slices
    return Frame(slices.extent, solids, plane, has_air=has_air(case))


def model_sizes(workspace: Workspace, basis: str) -> list[int]:
    """Return the numbers of modes of a basis that models use."""
    case = workspace.case
    used = (basis_used(workspace, m, point) for m in case.rom for point in case.plan.rom_points(m))
    return sorted({size for name, size in used if name == basis})


def _spectra(workspace: Workspace) -> Iterator[tuple[str, str, str, Array]]:
    """Yield space, basis, part and singular values of all decompositions."""
    with workspace.open(workspace.basis()) as artifact:
        for space, (parent, _) in SPACES.items():
            for name in artifact.datasets:
                match name.split("/"):
                    case [folder, basis, "singular_values", part] if folder == parent:
                        yield space, basis, part, artifact.read(name)


def spectrum_rows(workspace: Workspace) -> Iterator[SpectrumRow]:
    """Yield the rows of the table of singular values, if the case has reduced models."""
    for space, basis, part, values in _spectra(workspace) if workspace.case.rom else ():
        shares = cumulative_singular_value_share(values)
        figures = zip(values.tolist(), shares.tolist(), energy(values).tolist(), strict=True)
        for m, (value, share, energy_share) in enumerate(figures, start=1):
            yield SpectrumRow(space, basis, part, m, value, share, energy_share)


def draw_spectrum(
    workspace: Workspace, basis: str, marked: Sequence[int], *, with_shares: bool = False
) -> Figure:
    """Draw singular values, and the shares of the omitted ones (Eq. 4.3) over the mode number.

    Numbers of modes in `marked` get a line and, with `with_shares`, an entry in the legend.
    """
    ratios = []
    omitted = []
    for space, name, part, values in _spectra(workspace):
        if name != basis:
            continue
        label = f"{space} space" + ("" if part == "joint" else f", {part}")
        shares = cumulative_singular_value_share(values)
        if with_shares:
            texts = (f"{_share(shares[m - 1])} % (M = {m})" for m in marked if m <= len(shares))
            label = f"{label}: {', '.join(texts)}"
        number = np.arange(1.0, len(values) + 1.0)
        ratio = values / values[0]
        left_out = 100.0 - shares
        ratios.append(Curve(label, number, np.where(ratio > SMALLEST_RATIO, ratio, 0.0)))
        left_out = np.where(left_out > SMALLEST_SHARE, left_out, 0.0)
        omitted.append(Curve(label, number, left_out))
    panels = [
        Panel("", "mode number M [–]", label, curves, "both logarithmic", marked)
        for label, curves in zip(SPECTRUM, (ratios, omitted), strict=True)
    ]
    return draw_grid([panels])


def _share(share: float) -> str:
    """Format a share [%] with two significant digits of its difference from 100 %."""
    for digits in range(1, 12):
        if round(100.0 - share, digits) >= 10.0 ** (1 - digits):
            return f"{share:.{digits}f}"
    return f"{share:.12g}"


def mode_fields(
    workspace: Workspace, basis: str, field: str, numbers: Sequence[int]
) -> dict[str, list[Field]]:
    """Return pictures of one field of modes (from 1) by space; Lagrangian ones are optional."""
    fields: dict[str, list[Field]] = {}
    unit = "1/m" if workspace.case.basis.inner_product == "acoustic" else "–"
    with workspace.open(workspace.basis()) as artifact:
        for space, (parent, position) in SPACES.items():
            name = f"{parent}/{basis}/modes/{'velocity' if field in COMPONENTS else field}"
            if name not in artifact:
                continue
            picture = frame_of(workspace.case).raster(artifact.read(position))
            for number in numbers:
                values = np.asarray(artifact.dataset(name)[number - 1])
                if field in COMPONENTS:
                    values = values[:, COMPONENTS[field]]
                title, label = f"{space} space\nmode {number}", f"{field} [{unit}]"
                fields.setdefault(space, []).append(Field(title, label, picture(values)))
    return fields


def draw_modes(workspace: Workspace, basis: str) -> Figure:
    """Draw density and velocity of the first modes that models use, with spaces side by side."""
    number = max(model_sizes(workspace, basis), default=1)
    frame = frame_of(workspace.case)
    most = MOST_MODES if frame.aspect > FLAT else MOST_FLAT
    if workspace.case.basis.lagrangian:
        most //= len(SPACES)
    numbers = list(range(1, number + 1))
    if number > most:  # the first modes, and some of the others
        numbers = sorted({round(m) for m in np.geomspace(1, number, most)})
    rows = []
    n_dim = workspace.case.scene.domain.n_dim
    for field in ("density", *list(COMPONENTS)[:n_dim]):
        spaces = mode_fields(workspace, basis, field, numbers)
        rows.append(list(chain.from_iterable(spaces.values())))
    return draw_grid(rows, frame)
