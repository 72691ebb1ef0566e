"""Measurements in the fluid over time: flow rates through sections, and fields at places.

A flow rate is the integral of u . n along a segment, by the three-point Gauss rule on pieces of
limited length, which is exact for velocities up to the fifth degree. The normal points to the right
of the segment's direction, so the flow rate is the increase of the stream function along it.

Measured quantities have the axes (snapshot, ...), then place and component if they have any.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.metrics.series import OSCILLATION, oscillation, oscillation_beside

Quantities = Mapping[str, Array]
"""The values of one measurement, by the names in UNITS."""

UNITS = {
    "force": "N/m", "torque": "N", "flow_rate": "m2/s", "velocity": "m/s", "pressure": "Pa",
    "elevation": "m", "centre_of_mass": "m", "kinetic_energy": "J/m", "potential_energy": "J/m",
}  # fmt: skip
VECTORS = ("force", "velocity", "centre_of_mass")
"""Quantities with an axis of components, the last."""
AXES = ("x", "y")
"""Names of components."""
WITH_WEIGHT = ("pressure", "force", "torque")
"""Quantities that hold the weight of fluid with a free surface."""
ABOUT_MEAN = ("elevation", "centre_of_mass")
"""Quantities whose errors are relative to how they vary over time."""
PLACED = ("velocity", "pressure")
"""Quantities with an axis of places."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""The Gauss rule on each piece of a section."""


@dataclass(frozen=True)
class FieldMeasure:
    """The places of measured fields, and the quadrature of a flow rate."""

    position: Array
    """(n_places, 2) [m]."""
    normal: Array | None = None
    """(n_places, 2) [m] normals times the weights of quadrature; None for fields at places."""

    @classmethod
    def section(cls, start: Array, end: Array, longest: float) -> FieldMeasure:
        """Return a section from start to end (2,) [m], in pieces not longer than a length [m]."""
        way = np.subtract(end, start)
        n_pieces = max(1, math.ceil(float(np.hypot(*way)) / longest))
        along = (np.arange(n_pieces)[:, None] + 0.5 * (1.0 + NODES)).ravel() / n_pieces
        share = np.tile(0.5 * WEIGHTS / n_pieces, n_pieces)
        to_the_right = np.array([way[1], -way[0]])
        return cls(start + along[:, None] * way, share[:, None] * to_the_right)

    @classmethod
    def line(cls, start: Array, end: Array, n_places: int) -> FieldMeasure:
        """Return equally spaced places from start to end (2,) [m], both included."""
        along = np.linspace(0.0, 1.0, n_places)[:, None]
        return cls((1.0 - along) * start + along * end)

    def of(self, velocity: Array, pressure: Array) -> Quantities:
        """Return the measurement of velocity (..., n_places, 2) and pressure (..., n_places)."""
        if self.normal is None:
            return {"velocity": velocity, "pressure": pressure}
        return {"flow_rate": np.sum(velocity * self.normal, axis=(-2, -1))}


def component_names(quantity: str) -> tuple[str, ...]:
    """Return the column names of a quantity's components, such as `force_x` and `force_y`."""
    return tuple(f"{quantity}_{axis}" for axis in AXES) if quantity in VECTORS else (quantity,)


@dataclass(frozen=True)
class Column:
    """The meaning of a column's values."""

    measure: str
    """A measurement of the case; empty for fields at places of the rows."""
    quantity: str
    component: int | None
    units: str

    @classmethod
    def named(cls, measure: str, quantities: Iterable[str]) -> dict[str, Column]:
        """Return the columns of a measurement by their names."""
        return {
            "_".join(filter(None, (measure, name))): cls(
                measure, q, k if q in VECTORS else None, UNITS[q]
            )
            for q in quantities
            for k, name in enumerate(component_names(q))
        }


@dataclass(frozen=True)
class Oscillating(Column):
    """A column whose oscillation over time is measured."""

    from_time: float
    """The first instant that counts [s]."""

    def units_of(self, figure: str) -> str:
        """Return the unit of a figure of the oscillation."""
        return "Hz" if figure.startswith("frequency") else self.units

    def of(self, time: Array, own: Quantities, full: Quantities | None = None) -> dict[str, float]:
        """Return the oscillation in the measurements of a run at times (n_snapshots,) [s].

        Its errors are included if a full run is given.
        """
        late, signals = time >= self.from_time, list[Array]()
        for values in (run[self.quantity] for run in (own, full) if run is not None):
            one = values if self.component is None else values[..., self.component]
            signals.append(one.reshape(len(time))[late])
        return (oscillation if full is None else oscillation_beside)(time[late], *signals)


class Oscillations(dict[str, Oscillating]):
    """The oscillations to determine, by the names of the measurements."""

    def of(self, time: Array, measured: Mapping[str, Quantities]) -> dict[str, Quantities]:
        """Return figures of oscillations, the same at all times (n,), and NaN for missing ones."""
        figures: dict[str, Quantities] = {}
        for name, each in self.items():
            own = each.of(time, measured[each.measure])
            figures[name] = {f: np.full(len(time), own.get(f, np.nan)) for f in OSCILLATION}
        return figures


def combined(
    measured: Mapping[str, Quantities], others: Mapping[str, Quantities], factor: float
) -> dict[str, Quantities]:
    """Return `factor` times the quantities of `others`, plus those of the same names."""
    return {
        name: {q: measured[name][q] + factor * v for q, v in each.items()}
        for name, each in others.items()
    }


def components(quantity: str, values: Array) -> dict[str, Array]:
    """Return the components of values (n_snapshots, ...), by name."""
    each = np.moveaxis(values, -1, 0) if quantity in VECTORS else (values,)
    return dict(zip(component_names(quantity), each, strict=True))


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


STATISTICS = ("last", "mean", "fluctuation", "least", "greatest")
"""Statistics of a time series; the fluctuation is the root mean square about the mean."""


def statistics(quantities: Quantities) -> dict[str, Array]:
    """Return the statistics (n_runs,) of series (n_runs, n_snapshots[, 2]), such as `torque_mean`.

    Lines have no statistics.
    """
    named: dict[str, Array] = {}
    for quantity, values in quantities.items():
        for name, series in components(quantity, values).items() if quantity in UNITS else ():
            each = [series[:, -1], series.mean(1), series.std(1), series.min(1), series.max(1)]
            named |= {f"{name}_{s}": v for s, v in zip(STATISTICS, each, strict=True)}
    return named


def mean_square(quantity: str, values: Array) -> float:
    """Return the mean square over time and places of values (n_snapshots, ...), or of vectors."""
    squares = np.sum(values**2, axis=-1) if quantity in VECTORS else values**2
    return float(squares.mean())


def variation(quantity: str, values: Array, *, with_weight: bool = False) -> float:
    """Return the mean square of reference values (n_snapshots, ...), by which errors are divided.

    The mean over time is first subtracted from elevations, centres of mass, and from pressures and
    loads that hold the weight of fluid. Otherwise a distant origin or deep fluid would make
    relative errors small.
    """
    if quantity in ABOUT_MEAN or (with_weight and quantity in WITH_WEIGHT):
        values = values - values.mean(axis=0)
    return mean_square(quantity, values)


def errors_of(
    quantity: str, values: Array, reference: Array, size: float
) -> tuple[float | None, float | None]:
    """Return relative L2 errors [%]: over all snapshots, and at the worst snapshot.

    Both are divided by the root of `size`, the reference's mean square; they are None if it is 0.
    """
    if not size > 0.0:
        return None, None
    each = [mean_square(quantity, wrong[None]) for wrong in values - reference]
    return 100.0 * math.sqrt(np.mean(each) / size), 100.0 * math.sqrt(max(each) / size)
