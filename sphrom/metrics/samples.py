"""The probes at which runs are compared, and the velocity and pressure there.

Probes are on a straight line and on a regular grid over the box. They are the midpoints of equal
intervals, so none is on the edges of a box, or twice on the two sides of a periodic one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array, Mask


@dataclass(frozen=True)
class Probes:
    """Points in the fluid at which runs are compared [m]."""

    line: Array
    """(n_line, 2), on a vertical line: the centreline unless the case chooses another."""
    grid: Array
    """(n_grid, 2), the points of a regular grid that are in the fluid, row by row."""
    grid_shape: tuple[int, int]
    """Rows and columns of the whole grid."""
    in_fluid: Mask
    """(n_rows n_columns,) whether points of the whole grid are in the fluid."""
    stations: Array
    """(n_stations, 2), points with recorded histories; none in most scenes."""

    @property
    def all(self) -> Array:
        """The line's points, then the grid's, then the stations."""
        return np.concatenate((self.line, self.grid, self.stations))

    @property
    def on_line(self) -> slice:
        """The slice of the line's points in `all`."""
        return slice(0, len(self.line))

    @property
    def on_grid(self) -> slice:
        """The slice of the grid's points in `all`."""
        return slice(len(self.line), len(self.line) + len(self.grid))

    @property
    def at_stations(self) -> slice:
        """The slice of the stations in `all`."""
        return slice(len(self.line) + len(self.grid), None)

    def picture(self, values: Array) -> Array:
        """Return values (n_grid,) as a picture (n_rows, n_columns), NaN outside the fluid."""
        whole = np.full(self.in_fluid.size, np.nan)
        whole[self.in_fluid] = values
        return whole.reshape(self.grid_shape)


@dataclass(frozen=True)
class Samples:
    """Velocity and pressure at the probes over time."""

    time: Array
    """(n_snapshots,) [s]."""
    velocity: Array
    """(n_snapshots, n_probes, 2) [m/s]."""
    pressure: Array
    """(n_snapshots, n_probes) [Pa]."""
    measured: Mapping[str, Array] = field(default_factory=dict)
    """Other quantities compared over time (n_snapshots, ...), by name."""

    @property
    def speed(self) -> Array:
        """The velocity's magnitude [m/s]."""
        return np.asarray(np.linalg.norm(self.velocity, axis=2))

    def at(self, snapshots: slice | NDArray[np.int64]) -> Samples:
        """Return some snapshots, at the times of the first snapshots, as many as there are."""
        measured = {name: values[snapshots] for name, values in self.measured.items()}
        velocity, pressure = self.velocity[snapshots], self.pressure[snapshots]
        return Samples(self.time[: len(velocity)], velocity, pressure, measured)


def without_weight(run: Samples, reference: Samples, weight: Array) -> tuple[Samples, Samples]:
    """Return the samples of two runs with a free surface, prepared for a comparison.

    Values are zero where either run has no fluid. `weight` (n_probes,) [Pa], the pressure of fluid
    at rest, is subtracted from the pressures.
    """
    common = slice(min(len(run.time), len(reference.time)))
    run, reference = run.at(common), reference.at(common)
    wet_in_run, wet_in_reference = (r.speed + np.abs(r.pressure) > 0.0 for r in (run, reference))
    wet = wet_in_run & wet_in_reference

    def compared(one: Samples) -> Samples:
        velocity = np.where(wet[..., None], one.velocity, 0.0)
        return Samples(one.time, velocity, np.where(wet, one.pressure - weight, 0.0))

    return compared(run), compared(reference)


def midpoints(lower: float, upper: float, n_points: int) -> Array:
    """Return the midpoints (n_points,) [m] of equal intervals between two bounds."""
    return lower + (np.arange(n_points) + 0.5) * (upper - lower) / n_points


def spread(spans: Sequence[tuple[float, float]], n_points: int) -> Array:
    """Return points (n_points,) [m], evenly spread over consecutive intervals."""
    starts = np.array([low for low, _ in spans])
    lengths = np.array([high - low for low, high in spans])
    ends = np.cumsum(lengths)
    along = midpoints(0.0, float(ends[-1]), n_points)
    piece = np.minimum(np.searchsorted(ends, along), len(spans) - 1)
    return np.asarray(starts[piece] + (along - (ends - lengths)[piece]))


def grid_points(
    lower: tuple[float, float], upper: tuple[float, float], shape: tuple[int, int]
) -> Array:
    """Return the points (ny nx, 2) [m] of a grid over a box, row by row from below.

    `reshape(shape)` turns a field there into a picture, with shape (ny, nx).
    """
    x, y = (midpoints(lower[i], upper[i], shape[1 - i]) for i in (0, 1))
    columns, rows = np.meshgrid(x, y)
    return np.stack((columns.ravel(), rows.ravel()), axis=1)
