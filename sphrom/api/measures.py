"""What is measured over time, with named axes and units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.metrics.measures import COMPONENTS, UNITS, Quantities
from sphrom.setup.assembly import field_measures

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
Variable = tuple[object, ...]
"""Axes, values and attributes."""


def labelled(dims: str, values: Array, units: str, meaning: str) -> Variable:
    """Return a variable as xarray takes it; `dims` has spaces between axes."""
    return dims.split(), values, {"units": units, "long_name": meaning}


def labelled_measures(
    case: Case, measured: Mapping[str, Quantities], time: Array, attributes: Mapping[str, Any]
) -> xarray.Dataset:
    """Return what a case measures at times (n_snapshots,) [s], by name and quantity."""
    import xarray

    variables = {
        f"{name}_{quantity}": labelled(
            _dims(name, quantity, values), values, UNITS[quantity], f"{quantity} of {name}"
        )
        for name, quantities in measured.items()
        for quantity, values in quantities.items()
    }
    coordinates = {"time": labelled("snapshot", time, "s", "time of each snapshot")}
    coordinates |= dict(_positions(case))
    found = xarray.Dataset(variables, coordinates, dict(attributes))
    return found.set_xindex("time")


def _dims(name: str, quantity: str, values: Array) -> str:
    """Return the axes of a quantity of a measurement."""
    is_vector = quantity in COMPONENTS
    places = f" {name}_place" if values.ndim == 2 + is_vector else ""
    return f"snapshot{places}{' component' if is_vector else ''}"


def _positions(case: Case) -> Iterator[tuple[str, Variable]]:
    for name, measure in field_measures(case).items():
        if measure.normal is None:
            dims = f"{name}_place component"
            yield f"{name}_position", labelled(dims, measure.position, "m", f"places of {name}")
