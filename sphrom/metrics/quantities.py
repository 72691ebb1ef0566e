"""The table of measured quantities, and the names of their components and columns.

A quantity is declared once, in `MEASURABLE`. Its datasets in all artifacts, its columns in tables,
its panels and its errors follow from the table. The classes in `sphrom.case.measure_sections`
measure quantities.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import attribute, dataset

AXES = ("x", "y", "z")
"""Names of components; fields in a plane have the first two."""
COEFFICIENT = "coefficient"
"""The quantity that follows from a force and its scales, and is not recorded."""


@dataclass(frozen=True)
class Quantity:
    """A measured quantity."""

    unit: str
    """The unit in a plane, where forces and flow rates are per metre of depth."""
    meaning: str
    symbol: str = ""
    equation: str = ""
    is_vector: bool = False
    """Whether it has an axis of components, the last."""
    is_placed: bool = False
    """Whether it has an axis of places, before that of components."""
    of_field: Literal["velocity", "pressure", ""] = ""
    """The field that it is linear in, if any; models project such quantities."""
    has_weight: bool = False
    """Whether it holds the weight of fluid with a free surface."""
    about_mean: bool = False
    """Whether its errors are relative to how it varies over time."""
    in_space: str | None = ""
    """The unit in three dimensions if it differs; None if only measured in a plane."""

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of its axes after those of runs and snapshots."""
        return ("place",) * self.is_placed + ("component",) * self.is_vector


MEASURABLE: Mapping[str, Quantity] = {
    "force": Quantity("N/m", "force on a wall", is_vector=True, has_weight=True, in_space="N"),
    "torque": Quantity("N", "torque on a wall, anticlockwise", has_weight=True, in_space=None),
    "flow_rate": Quantity(
        "m2/s",
        "flow through a section, from the left to the right of its direction",
        of_field="velocity",
        in_space="m3/s",
    ),
    "velocity": Quantity(
        "m/s",
        "velocity at the places",
        "u",
        "Eq. 2.7",
        is_vector=True,
        is_placed=True,
        of_field="velocity",
    ),
    "pressure": Quantity(
        "Pa",
        "pressure at the places",
        "p",
        "Eq. 2.8",
        is_placed=True,
        of_field="pressure",
        has_weight=True,
    ),
    "velocity_integral": Quantity(
        "m2/s", "integral of the velocity along a segment", is_vector=True, of_field="velocity"
    ),
    "pressure_integral": Quantity(
        "N/m", "integral of the pressure along a segment", of_field="pressure", has_weight=True
    ),
    "elevation": Quantity("m", "height of the free surface", about_mean=True),
    "centre_of_mass": Quantity("m", "centre of mass of the fluid", is_vector=True, about_mean=True),
    "kinetic_energy": Quantity("J/m", "kinetic energy", in_space="J"),
    "potential_energy": Quantity("J/m", "potential energy"),
    COEFFICIENT: Quantity("1", "coefficient of the force", "C", is_vector=True, has_weight=True),
}
"""All measured quantities by name."""
OF_WALLS = ("force", "torque")
"""Loads, recorded as separate parts due to pressure and due to viscosity."""
FROM_FIELDS = tuple(name for name, quantity in MEASURABLE.items() if quantity.of_field)
"""Quantities that are linear in velocity or pressure."""
IN_FLUID = tuple(name for name in MEASURABLE if name not in (*OF_WALLS, COEFFICIENT))
"""Quantities that runs record besides loads."""
PLACED = tuple(name for name, quantity in MEASURABLE.items() if quantity.is_placed)
"""Quantities with an axis of places."""


def stored(
    names: Iterable[str],
    before: str = "",
    *,
    after: str = "",
    leave_out: str = "",
    at: str = "{}",
    units: str = "{}",
    meaning: str = "{}",
) -> Any:
    """Declare a mapping of a record, with a dataset for each of some quantities.

    Parameters
    ----------
    before, after : axes before and after those of the quantity.
    leave_out : an axis of the quantity that the datasets don't have.
    at, units, meaning : texts in which `{}` stands for the quantity's own.
    """
    declared = {}
    for name in names:
        quantity = MEASURABLE[name]
        axes = (axis for axis in quantity.axes if axis != leave_out)
        declared[at.format(name)] = {
            "axes": (*before.split(), *axes, *after.split()),
            "units": units.format(quantity.unit),
            "in_space": units.format(quantity.in_space) if quantity.in_space else "",
            "meaning": meaning.format(quantity.meaning),
            "symbol": quantity.symbol,
            "equation": quantity.equation,
        }
    return dataset("quantity", "", "", names=declared, at="*", default_factory=dict)


def stored_numbers(names: Iterable[str]) -> Any:
    """Declare a mapping of a record, with an attribute for each of some quantities."""
    declared = {
        name: {"units": MEASURABLE[name].unit, "meaning": MEASURABLE[name].meaning}
        for name in names
    }
    return attribute("", "", names=declared, at="*", default_factory=dict)


def is_vector(name: str) -> bool:
    """Return whether a name is that of a vector; names of components and figures are not."""
    return name in MEASURABLE and MEASURABLE[name].is_vector


def unit_of(quantity: str, n_dim: int) -> str:
    """Return the unit of a quantity."""
    measurable = MEASURABLE[quantity]
    return (measurable.in_space if n_dim == len(AXES) else None) or measurable.unit


def component_names(quantity: str, n_dim: int = 2) -> tuple[str, ...]:
    """Return the column names of a quantity's components, such as `force_x` and `force_y`."""
    if is_vector(quantity):
        return tuple(f"{quantity}_{axis}" for axis in AXES[:n_dim])
    return (quantity,)


def components(quantity: str, values: Array) -> dict[str, Array]:
    """Return the components of values (n_snapshots, ...), by name."""
    parts = np.moveaxis(values, -1, 0) if is_vector(quantity) else (values,)
    return dict(zip(component_names(quantity, len(parts)), parts, strict=True))


def parts(quantity: str, values: Array) -> dict[str, Array]:
    """Return values (n_snapshots, ...) of a quantity and of its components, by name."""
    return {quantity: values} | components(quantity, values)


@dataclass(frozen=True)
class Column:
    """The meaning of a column's values."""

    measure: str
    """A measurement of the case; empty for fields at places of the rows."""
    quantity: str
    component: int | None
    units: str

    @classmethod
    def named(cls, measure: str, quantities: Iterable[str], n_dim: int = 2) -> dict[str, Column]:
        """Return the columns of a measurement by their names."""
        return {
            "_".join(filter(None, (measure, name))): cls(
                measure,
                quantity,
                component if is_vector(quantity) else None,
                unit_of(quantity, n_dim),
            )
            for quantity in quantities
            if n_dim == 2 or MEASURABLE[quantity].in_space is not None
            for component, name in enumerate(component_names(quantity, n_dim))
        }
