"""The animation of a report: a reduced run beside the full one, speed above, pressure below."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.mode_figures import frame_of
from sphrom.metrics.samples import Probes
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


def side_by_side(panels: Sequence[Pixels], axis: int = 1) -> Pixels:
    """Return panels beside each other, or below with `axis` 0, white between them."""
    shape = list(panels[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, dtype=np.uint8)
    parts = [part for panel in panels for part in (panel, gap)]
    return np.concatenate(parts[:-1], axis=axis)


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
            if point in plan.rom_points(model) and _ended_well(workspace, model, point):
                yield _animation(workspace, model, point)
                return


def _ended_well(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> bool:
    with workspace.open(workspace.reduced_run(model, point)) as run:
        return run.text("status") == "complete"


def _animation(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> Html:
    probes = probes_of(workspace.case)
    with (
        StoredRun.opened(workspace, point) as full,
        StoredRun.opened(workspace, point, model) as reduced,
    ):
        times = full.time
        chosen = np.unique(np.linspace(0, len(times) - 1, N_FRAMES).round().astype(int))
        both = [run.sampled(probes.grid, chosen.tolist()) for run in (full, reduced)]
    scales = {"speed": (SPEED_MAP, False), "pressure": (SIGNED_MAP, True)}
    speed, pressure = (
        _Quantity.of(getattr(both[0], name), getattr(both[1], name), *colours)
        for name, colours in scales.items()
    )
    return animation(
        frames=[
            as_png(side_by_side([q.row(i, probes) for q in (speed, pressure)], axis=0))
            for i in range(len(chosen))
        ],
        times=[f"{times[snapshot]:.4g}" for snapshot in chosen],
        heads=("full", model.name, "difference"),
        extent=[f"{end:g}" for end in frame_of(workspace.case).extent],
        legends=[*speed.legends("speed", "m/s"), *pressure.legends("pressure", "Pa")],
        caption=f"{point.label}: speed above, pressure below; full run, {model.name}, and their "
        "difference. Colours mean the same in all frames; "
        f"the {100.0 - SHOWN_SHARE:g} % of values at either end share the last.",
        described=f"Two rows of three pictures of the flow at {point.label} over x and y, from "
        f"t = {times[chosen[0]]:.4g} s to {times[chosen[-1]]:.4g} s: the full run, {model.name}, "
        f"and their difference. {speed.described('speed', 'm/s')} "
        f"{pressure.described('pressure', 'Pa')}",
    )


def _usual(values: Array) -> Array:
    """Return values without extremes, such as the sound of a sudden start has."""
    low, high = np.percentile(values, (100.0 - SHOWN_SHARE, SHOWN_SHARE))
    return np.clip(values, low, high)


@dataclass(frozen=True)
class _Quantity:
    """One quantity in all frames, with the colours of fields and of differences."""

    full: Array
    """(n_frames, n_points)."""
    reduced: Array
    fields: Scale
    differences: Scale

    @classmethod
    def of(cls, full: Array, reduced: Array, colours: str, symmetric: bool) -> _Quantity:
        bounds = (symmetric_limits if symmetric else limits)(_usual(full), _usual(reduced))
        about_zero = symmetric_limits(_usual(reduced - full))
        return cls(full, reduced, Scale(colours, *bounds), Scale(DIFFERENCE_MAP, *about_zero))

    def row(self, frame: int, probes: Probes) -> Pixels:
        """Return full, reduced and difference as pixels."""
        full, reduced = self.full[frame], self.reduced[frame]
        shown = ((full, self.fields), (reduced, self.fields), (reduced - full, self.differences))
        return side_by_side([paint(probes.picture(field), scale) for field, scale in shown])

    def described(self, name: str, unit: str) -> str:
        """Return the range of the full run, and the largest difference, in a sentence."""
        low, high = format_figure(float(self.full.min())), format_figure(float(self.full.max()))
        most = format_figure(float(np.abs(self.reduced - self.full).max()))
        return (
            f"The {name} of the full run lies between {low} and {high} {unit}, and differs by "
            f"{most} {unit} at most."
        )

    def legends(self, name: str, unit: str) -> list[Html]:
        """Return the legends of both colour scales."""
        labels = ((f"{name} [{unit}]", self.fields), (f"difference [{unit}]", self.differences))
        return [
            legend(label, format_figure(scale.low), format_figure(scale.high), scale.gradient())
            for label, scale in labels
        ]
