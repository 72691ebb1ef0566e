"""Measurements over time: flow rates, fields at places, and samples at the probes of comparisons.

A flow rate is the integral of u . n along a segment, by the three-point Gauss rule on pieces of
limited length, which is exact for velocities up to the fifth degree. The normal points to the right
of the segment's direction, so the flow rate is the increase of the stream function along it. In
three dimensions it is the integral over a rectangle perpendicular to an axis, along this axis.

Measured quantities have the axes (snapshot, ...), then place and component if they have any. Points
are (n_points, n_dim), in a plane or in space.

Runs are compared at probes on a straight line and on a regular grid over the box.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array, Indices, Mask
from sphrom.metrics.quantities import (
    COEFFICIENT,
    MEASURABLE,
    Column,
    components,
    is_vector,
)
from sphrom.metrics.series import (
    BELOW_ONSET,
    NO_OSCILLATION,
    OSCILLATION,
    PHASE,
    STEADY,
    oscillation,
    oscillation_beside,
)

Quantities = Mapping[str, Array]
"""The values of one measurement, by the names in `MEASURABLE`."""
Measured = Mapping[str, Quantities]
"""Quantities (n_snapshots, ...) of measurements, by the name of the measurement."""

TORQUE = 2
"""The row of the torque in a plane, after the force's components; none in three dimensions."""
TIME_TOLERANCE = 1e-9
"""Times that differ by less than this are treated as equal [s]."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""The Gauss rule on each piece of a section."""


class FieldMeasure:
    """Velocity and pressure at places.

    Parameters
    ----------
    position : (n_places, n_dim) [m].
    """

    is_integral = False
    """Whether it integrates the fields, so that its places are not of interest."""

    def __init__(self, position: Array) -> None:
        self.position = position

    @classmethod
    def line(cls, ends: Array, n_places: int) -> FieldMeasure:
        """Return equally spaced places between two ends (2, n_dim) [m], both included."""
        start, end = ends
        along = np.linspace(0.0, 1.0, n_places)[:, None]
        return cls((1.0 - along) * start + along * end)

    def of(self, velocity: Array, pressure: Array) -> Quantities:
        """Return the quantities of velocity (..., n_places, n_dim) and pressure (..., n_places)."""
        return {"velocity": velocity, "pressure": pressure}


class SegmentMeasure(FieldMeasure):
    """An integral along the segment between two ends (2, n_dim), in pieces of limited length."""

    is_integral = True

    def __init__(self, ends: Array, longest: float) -> None:
        start, end = ends
        self.vector = np.subtract(end, start)
        self.length = float(np.hypot.reduce(self.vector))
        along, self.share = gauss_rule(self.length, longest)
        super().__init__(start + along[:, None] * self.vector)


class FlowRate(SegmentMeasure):
    """The integral of the velocity's component to the right of a segment."""

    def __init__(self, ends: Array, longest: float) -> None:
        super().__init__(ends, longest)
        to_the_right = np.array([self.vector[1], -self.vector[0]])
        self._weights = self.share[:, None] * to_the_right

    @staticmethod
    def through(ends: Array, longest: float) -> FieldMeasure:
        """Return the flow rate through a segment, or in three dimensions through a rectangle.

        Its opposite corners (2, 3) [m] are equal along one axis.
        """
        return FlowRate(ends, longest) if ends.shape[1] == TORQUE else FlowAcross(ends, longest)

    def of(self, velocity: Array, pressure: Array) -> Quantities:
        return {"flow_rate": np.sum(velocity * self._weights, axis=(-2, -1))}


class FlowAcross(FieldMeasure):
    """The integral of the velocity along an axis, over a rectangle with opposite corners."""

    is_integral = True

    def __init__(self, ends: Array, longest: float) -> None:
        lower = ends.min(axis=0)
        lengths = np.ptp(ends, axis=0)
        self.axis = int(np.argmin(lengths))
        inner, outer = np.delete(np.arange(3), self.axis)
        along, share = gauss_rule(lengths[inner], longest)
        across, other_share = gauss_rule(lengths[outer], longest)
        position = np.tile(lower, (len(across), len(along), 1))
        position[..., inner] += lengths[inner] * along
        position[..., outer] += lengths[outer] * across[:, None]
        self._weights = np.outer(lengths[outer] * other_share, lengths[inner] * share).ravel()
        super().__init__(position.reshape(-1, 3))

    def of(self, velocity: Array, pressure: Array) -> Quantities:
        return {"flow_rate": np.sum(velocity[..., self.axis] * self._weights, axis=-1)}


FLOW_RATES = (FlowRate, FlowAcross)
"""The kinds of flow rates."""


class Integral(SegmentMeasure):
    """The integrals of velocity and pressure along a segment."""

    def of(self, velocity: Array, pressure: Array) -> Quantities:
        weights = self.length * self.share
        return {
            "velocity_integral": np.sum(velocity * weights[:, None], axis=-2),
            "pressure_integral": np.sum(pressure * weights, axis=-1),
        }


def gauss_rule(length: float, longest: float) -> tuple[Array, Array]:
    """Return places and weights (n,) along a unit interval, in pieces of limited length [m]."""
    n_pieces = max(1, math.ceil(length / longest))
    along = (np.arange(n_pieces)[:, None] + 0.5 * (1.0 + NODES)).ravel() / n_pieces
    return along, np.tile(0.5 * WEIGHTS / n_pieces, n_pieces)


def of_loads(loads: Array, n_dim: int) -> Quantities:
    """Return the force, and in a plane the torque, from loads (..., 3).

    Loads are force and torque in a plane, and the three components of the force in space.
    """
    if n_dim > TORQUE:
        return {"force": loads}
    return {"force": loads[..., :TORQUE], "torque": loads[..., TORQUE]}


@dataclass(frozen=True)
class Oscillating(Column):
    """A column whose oscillation over time is measured."""

    from_time: float
    """The first instant that counts [s]."""

    def units_of(self, figure: str) -> str:
        """Return the unit of a figure of the oscillation."""
        if figure == PHASE:
            return "deg"
        return "Hz" if figure.startswith("frequency") else self.units

    def of(self, time: Array, own: Quantities, full: Quantities | None = None) -> dict[str, float]:
        """Return the oscillation in the measurements of a run at times (n_snapshots,) [s].

        Its errors are included if a full run is given.
        """
        late = since(time, self.from_time)
        signals = list[Array]()
        for values in (run[self.quantity] for run in (own, full) if run is not None):
            one = values if self.component is None else values[..., self.component]
            signals.append(one.reshape(len(time))[late])
        return (oscillation if full is None else oscillation_beside)(time[late], *signals)


class Oscillations(dict[str, Oscillating]):
    """The oscillations to determine, by the names of the measurements."""

    def of(
        self, time: Array, measured: Mapping[str, Quantities], regime: str | None = None
    ) -> dict[str, Quantities]:
        """Return figures of oscillations, the same at all times (n,), and NaN for missing ones."""
        figures: dict[str, Quantities] = {}
        for name, oscillating in self.items():
            found = in_regime(regime, oscillating.of(time, measured[oscillating.measure]))
            figures[name] = {f: np.full(len(time), found.get(f, np.nan)) for f in OSCILLATION}
        return figures


def in_regime(regime: str | None, figures: dict[str, float]) -> dict[str, float]:
    """Return the figures of an oscillation in a regime; a steady flow only has a mean."""
    return {f: v for f, v in figures.items() if regime != STEADY or f.startswith("mean")}


def why_missing(regime: str | None) -> str:
    """Return why a run in a regime has no frequency and no amplitude."""
    return BELOW_ONSET if regime == STEADY else NO_OSCILLATION


def since(time: Array, from_time: float) -> Mask:
    """Return the mask of times (n_snapshots,) [s] that are not before a given time."""
    return time >= from_time - TIME_TOLERANCE


def with_coefficients(
    measured: Mapping[str, Quantities], factors: Mapping[str, float]
) -> dict[str, Quantities]:
    """Return measurements with coefficients of forces, by factors [m/N] of some measurements."""
    return {
        name: {**each, COEFFICIENT: factors[name] * each["force"]} if name in factors else each
        for name, each in measured.items()
    }


def combined(
    measured: Mapping[str, Quantities], others: Mapping[str, Quantities], factor: float
) -> dict[str, Quantities]:
    """Return `factor` times the quantities of `others`, plus those of the same names."""
    return {
        name: {q: measured[name][q] + factor * v for q, v in each.items()}
        for name, each in others.items()
    }


def items(measured: Mapping[str, Quantities], index: int | Indices) -> dict[str, Quantities]:
    """Return items along the first axis of all quantities, by measurement."""
    return {name: {q: v[index] for q, v in each.items()} for name, each in measured.items()}


def of_a_run(quantities: Quantities) -> Quantities:
    """Return the measurements that are stored with a run: histories, and lines at its end.

    A probe's histories have no axis of places. Lines have `final_velocity` and `final_pressure`.
    """
    if "velocity" not in quantities:
        return quantities
    if quantities["velocity"].shape[1] == 1:
        return {name: values[:, 0] for name, values in quantities.items()}
    return {f"final_{name}": values[-1] for name, values in quantities.items()}


STATISTICS: Mapping[str, Callable[..., Any]] = {
    "last": partial(np.take, indices=-1),
    "mean": np.mean,
    "fluctuation": np.std,
    "least": np.min,
    "greatest": np.max,
}
"""Statistics of time series along an axis; the fluctuation is the root mean square about the mean.
"""


def statistics(quantities: Quantities, counted: Mask) -> dict[str, Array]:
    """Return statistics (n_runs,) of series (n_runs, n_snapshots[, n_dim]), such as `torque_mean`.

    Only the `counted` snapshots (n_snapshots,) enter; without any, there is only the last value.
    Lines have no statistics.
    """
    named: dict[str, Array] = {}
    for quantity, values in quantities.items():
        for name, whole in components(quantity, values).items() if quantity in MEASURABLE else ():
            named[f"{name}_last"] = whole[:, -1]
            if counted.any():
                series = whole[:, counted]
                named |= {f"{name}_{s}": of(series, axis=1) for s, of in STATISTICS.items()}
    return named


SECOND_DIFFERENCE = 6.0
"""Mean square of the second differences of uncorrelated noise, relative to that of the noise."""
NOISY, NEGLIGIBLE = 0.25, 0.005
"""Least share of noise in the mean square of a component with nothing but noise; largest share of
a negligible component in the root mean square of its vector."""
ONLY_NOISE, DRY = "only noise", "zero above the surface at times"
"""Remarks on a component without relative errors, and on a probe that fluid leaves."""


def mean_square(quantity: str, values: Array) -> float:
    """Return the mean square over time and places of values (n_snapshots, ...), or of vectors."""
    squares = np.sum(values**2, axis=-1) if is_vector(quantity) else values**2
    return float(squares.mean())


def mean_squares(quantity: str, values: Array) -> dict[str, float]:
    """Return the mean squares of values (n_snapshots, ...) and of their components, by name."""
    squares = {name: mean_square(name, each) for name, each in components(quantity, values).items()}
    return {quantity: sum(squares.values())} | squares


def variations(quantity: str, values: Array, *, with_weight: bool = False) -> dict[str, float]:
    """Return the mean squares of reference values (n_snapshots, ...), by which errors are divided.

    They are those of a vector, by the name of the quantity, and of each component. The mean over
    time is first subtracted from elevations, centres of mass, and from pressures and loads that
    hold the weight of fluid. Otherwise a distant origin or deep fluid would make relative errors
    small. The mean square is zero if a component has only noise: a large part of it changes from
    snapshot to snapshot, or it is negligible beside the vector. So is that of a vector of noise.
    """
    about_mean = MEASURABLE[quantity].about_mean
    if about_mean or (with_weight and MEASURABLE[quantity].has_weight):
        values = values - values.mean(axis=0)
    sizes = mean_squares(quantity, values)
    whole = sizes[quantity]
    parts = components(quantity, values)
    for name, each in parts.items():
        noise = mean_square(name, np.diff(each, 2, axis=0)) if len(each) > 2 else 0.0
        noisy = noise >= SECOND_DIFFERENCE * NOISY * sizes[name]
        if noisy or sizes[name] <= NEGLIGIBLE**2 * whole:
            sizes[name] = 0.0
    sizes[quantity] *= any(sizes[name] > 0.0 for name in parts)
    return sizes


def shares(squares: Mapping[str, float], sizes: Mapping[str, float]) -> dict[str, float | None]:
    """Return errors over sizes [%] from their mean squares by name; None where the size is zero."""
    pairs = {name: (square, sizes[name]) for name, square in squares.items()}
    return {n: 100.0 * math.sqrt(a / b) if b > 0.0 else None for n, (a, b) in pairs.items()}


def errors_of(
    quantity: str, values: Array, reference: Array, size: float
) -> tuple[float | None, float | None]:
    """Return relative L2 errors [%]: over all snapshots, and at the worst snapshot.

    Both are divided by the root of `size`, the reference's mean square; they are None if it is 0.
    """
    if not size > 0.0:
        return None, None
    squares = [mean_square(quantity, wrong[None]) for wrong in values - reference]
    return 100.0 * math.sqrt(np.mean(squares) / size), 100.0 * math.sqrt(max(squares) / size)


@dataclass(frozen=True)
class Probes:
    """Points in the fluid at which runs are compared [m]."""

    line: Array
    """(n_line, n_dim), on a line along y: the centreline unless the case chooses another."""
    grid: Array
    """(n_grid, n_dim), the points of a regular grid that are in the fluid, row by row."""
    grid_shape: tuple[int, int]
    """Rows and columns of pictures."""
    in_fluid: Mask
    """(n_rows n_columns,) whether points of pictures are in the fluid."""
    stations: Array
    """(n_stations, n_dim), points with recorded histories; none in most scenes."""
    on_slices: Array | None = None
    """(n_pictured, 3), the points of pictures of slices in space; None if it is the grid."""

    @property
    def pictured(self) -> Array:
        """The points of pictures (n_pictured, n_dim) that are in the fluid."""
        return self.grid if self.on_slices is None else self.on_slices

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
        """Return values (n_pictured,) as a picture (n_rows, n_columns), NaN outside the fluid."""
        whole = np.full(self.in_fluid.size, np.nan)
        whole[self.in_fluid] = values
        return whole.reshape(self.grid_shape)


@dataclass(frozen=True)
class Samples:
    """Velocity and pressure at the probes over time."""

    time: Array
    """(n_snapshots,) [s]."""
    velocity: Array
    """(n_snapshots, n_probes, n_dim) [m/s]."""
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
    run = run.at(common)
    reference = reference.at(common)
    wet_in_run, wet_in_reference = (r.speed + np.abs(r.pressure) > 0.0 for r in (run, reference))
    wet = wet_in_run & wet_in_reference

    def compared(one: Samples) -> Samples:
        velocity = np.where(wet[..., None], one.velocity, 0.0)
        return Samples(one.time, velocity, np.where(wet, one.pressure - weight, 0.0))

    return compared(run), compared(reference)
