"""Sections of a case for resistances: porous bodies, and the strip of an inflow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Annotated

import numpy as np
import shapely
from pydantic import ConfigDict, Field
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.fields import Coordinate, Duration, Positive, Section, key
from sphrom.case.shapes import ShapeSection
from sphrom.sph.domain import Domain
from sphrom.sph.resistance import Rates, Strip

Value = Coordinate | Annotated[str, Field(max_length=1000)]
"""A number, or an expression."""
Rate = Duration | Annotated[str, Field(max_length=1000)]
"""A non-negative number, or an expression."""
Vector = Annotated[tuple[Value, ...], Field(min_length=2, max_length=2)]
NO_FLOW = 1e-6
"""Least mean speed of an inflow along the axis, over the largest speed."""


class PorousSection(ShapeSection):
    """A porous body: fluid flows through its shape against Darcy's resistance nu/k."""

    permeability: Positive = key(..., "permeability k", unit="m2")


class StripSection(Section):
    """The place of a strip across the box along its periodic axis."""

    # `from` is a keyword of Python.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Coordinate = key(..., "start of the strip", unit="m", alias="from")
    end: Coordinate = key(..., "end of the strip", unit="m", alias="to")


class InflowSection(Section):
    """An inflow: in a strip across a periodic box, the flow is forced to a given velocity."""

    strip: StripSection = key(..., "the strip, on the periodic axis along which the fluid flows")
    velocity: Vector = key(
        ...,
        "velocity of the fluid that leaves the strip, numbers or expressions in x, y, t",
        unit="m/s",
    )
    strength: Positive = key(
        200.0,
        "K, the integral of the rate of forcing over the strip, divided by the largest speed",
        unit="-",
    )
    ramp: Duration | None = key(
        None,
        "time in which the inflow reaches its speed; null means the length of the box over the "
        "largest speed, or 0 for runs that start with a velocity",
        unit="s",
    )

    def strip_in(self, domain: Domain, samples: Array, velocity: Callable[[Array], Array]) -> Strip:
        """Return the strip in a domain, from samples of its points (n_samples, 2) [m].

        Velocities are (2, n_samples) [m/s]. Raises ValueError unless the strip is part of the box
        and fluid flows through it.
        """
        start, end, inflows = self.strip.start, self.strip.end, dict[int, Array]()
        for axis in np.flatnonzero(domain.periodic).tolist():
            inside = (samples[:, axis] >= start) & (samples[:, axis] <= end)
            within = domain.lower[axis] <= start < end <= domain.upper[axis]
            if within and end - start < domain.lengths[axis] and inside.any():
                inflows[axis] = velocity(samples[inside].T)
        if not inflows:
            raise ValueError(
                "inflow.strip: must be part of the box, with `from` below `to`, on an axis that "
                "box.periodic names; fluid that leaves the box enters the strip"
            )
        means = {axis: float(inflow[axis].mean()) for axis, inflow in inflows.items()}
        axis = max(means, key=lambda each: abs(means[each]))
        speed = float(np.linalg.norm(inflows[axis], axis=0).max())
        if not abs(means[axis]) > NO_FLOW * speed:
            raise ValueError("inflow.velocity: must have a mean along the periodic axis of the box")
        return Strip(axis, start, end, math.copysign(speed, means[axis]), self.strength)


def ramp_share(ramp: float, time: Array | float) -> Array | float:
    """Return the share of its speed that an inflow has reached at times [s], half a cosine."""
    if ramp == 0.0:
        return 1.0
    return 0.5 - 0.5 * np.cos(math.pi * np.clip(np.divide(time, ramp), 0.0, 1.0))


def inverse_permeability(bodies: Iterable[tuple[PorousSection, BaseGeometry]]) -> Rates | None:
    """Return a function for 1/k [1/m2] at positions (2, n_positions) [m]; None without bodies.

    It is zero outside of porous bodies.
    """
    inverses = [(shape, 1.0 / body.permeability) for body, shape in bodies]
    shapely.prepare([shape for shape, _ in inverses])

    def at(position: Array) -> Array:
        return sum(inverse * shapely.contains_xy(shape, *position) for shape, inverse in inverses)

    return at if inverses else None
