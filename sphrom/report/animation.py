"""The animation of a report: a reduced run beside the full one, speed above, pressure below."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.compare.mode_figures import frame_of
from sphrom.online.stored_run import StoredRun
from sphrom.plots.canvas import (
    DIFFERENCE_MAP,
    SIGNED_MAP,
    SOLID_COLOUR,
    SPEED_MAP,
    limits,
    symmetric_limits,
)
from sphrom.plots.page import Html, animation, legend
from sphrom.plots.tables import format_figure
from sphrom.store.sampling import probes_of
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

N_FRAMES = 25
SHOWN_SHARE = 99.5
"""Of all values in all frames, in percent, the colours tell apart; farther ones share the last."""
GAP = 4
"""White pixels between two panels."""
LEAST_WIDTH = 160
"""Of a panel [pixels]: on coarser grids each point is a square of several."""


QUANTITIES: dict[str, Any] = {
    "speed": ("m/s", SPEED_MAP, limits),
    "pressure": ("Pa", SIGNED_MAP, symmetric_limits),
}
"""Unit, colours and the ends of their scale by name, from above."""


@dataclass(frozen=True)
class Scale:
    """Which colours stand for which values."""

    colours: str
    """Of matplotlib's maps."""
    low: float
    high: float

    def gradient(self, n_colours: int = 9) -> list[str]:
        """Return colours from the lowest value to the highest, as CSS has them."""
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        return [to_hex(c) for c in colormaps[self.colours](np.linspace(0.0, 1.0, n_colours))]


def paint(field: Array, scale: Scale) -> Pixels:
    """Return a field (ny, nx), from below, as pixels (rows, columns, 3), from above.

    Where it is NaN there is no fluid.
    """
    from matplotlib import colormaps
    from matplotlib.colors import Normalize, to_rgba

    colours = colormaps[scale.colours].with_extremes(bad=to_rgba(SOLID_COLOUR))
    values = Normalize(scale.low, scale.high)(np.ma.masked_invalid(field[::-1]))
    pixels = np.asarray(colours(values, bytes=True))[..., :3]
    times = -(-LEAST_WIDTH // field.shape[1])
    return pixels.repeat(times, axis=0).repeat(times, axis=1)


def arranged(rows: Sequence[Sequence[Pixels]]) -> Pixels:
    """Return panels of one size in rows, white between them."""
    gap = ((0, GAP), (0, GAP), (0, 0))
    padded = [[np.pad(panel, gap, constant_values=255) for panel in row] for row in rows]
    return np.vstack([np.hstack(row) for row in padded])[:-GAP, :-GAP]


def as_png(pixels: Pixels) -> bytes:
    """Return pixels as a PNG file."""
    from matplotlib.image import imsave

    content = io.BytesIO()
    imsave(content, pixels, format="png")
    return content.getvalue()


def animations(workspace: Workspace) -> Iterator[Html]:
    """Yield an animation of the first reduced run that ended well, where one did.

    A predicted parameter value comes before a trained one, a fast model before others.
    """
    plan = workspace.case.plan
    for point in (*plan.test_points, *plan.train_points):
        for model in plan.models_by_speed:
            if point in plan.rom_points(model):
                with StoredRun.opened(workspace, point, model) as run:
                    if run.is_complete:
                        yield _animation(workspace, model.name, point, run)
                        return


def _animation(workspace: Workspace, name: str, point: ParameterPoint, reduced: StoredRun) -> Html:
    probes = probes_of(workspace.case)
    with StoredRun.opened(workspace, point) as full:
        times = full.time
        chosen = np.unique(np.linspace(0, len(times) - 1, N_FRAMES).round().astype(int))
        both = [run.sampled(probes.grid, chosen.tolist()) for run in (full, reduced)]
    rows: list[list[tuple[Array, Scale]]] = []
    legends = []
    for quantity, (unit, colours, ends) in QUANTITIES.items():
        fields = [getattr(samples, quantity) for samples in both]
        difference = fields[1] - fields[0]
        scale = Scale(colours, *ends(*map(_usual, fields)))
        differences = Scale(DIFFERENCE_MAP, *symmetric_limits(_usual(difference)))
        rows.append([(fields[0], scale), (fields[1], scale), (difference, differences)])
        for label, each in ((f"{quantity} [{unit}]", scale), (f"difference [{unit}]", differences)):
            low, high = format_figure(each.low), format_figure(each.high)
            legends.append(legend(label, low, high, each.gradient()))
    return animation(
        frames=[
            as_png(arranged([[paint(probes.picture(v[i]), s) for v, s in row] for row in rows]))
            for i in range(len(chosen))
        ],
        times=[f"{times[snapshot]:.4g}" for snapshot in chosen],
        heads=("full", name, "difference"),
        extent=[f"{end:g}" for end in frame_of(workspace.case).extent],
        legends=legends,
        caption=f"{point.label}: speed above, pressure below; full run, {name}, and their "
        f"difference, from t = {times[chosen[0]]:.4g} s to {times[chosen[-1]]:.4g} s. Colours mean "
        f"the same in all frames; the {100.0 - SHOWN_SHARE:g} % of values at either end share the "
        "last.",
    )


def _usual(values: Array) -> Array:
    """Return values without extremes, such as the sound of a sudden start has."""
    low, high = np.percentile(values, (100.0 - SHOWN_SHARE, SHOWN_SHARE))
    return np.clip(values, low, high)
