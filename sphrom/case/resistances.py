"""Sections of what slows the fluid down: porous bodies, and the strip of an inflow."""

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
"""A number that isn't negative, or an expression."""
Vector = Annotated[tuple[Value, ...], Field(min_length=2, max_length=2)]
NO_FLOW = 1e-6
"""Share of the largest speed at which nothing flows along an axis on average."""


class PorousSection(ShapeSection):
    """A porous body: a shape that fluid flows through, against Darcy's resistance nu/k."""

    permeability: Positive = key(..., "its permeability k", unit="m2")


class StripSection(Section):
    """Where a strip across the box lies along its periodic axis."""

    # `from` is a word of Python's.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Coordinate = key(..., "where it starts", unit="m", alias="from")
    end: Coordinate = key(..., "where it ends", unit="m", alias="to")


class InflowSection(Section):
    """What flows in: a strip across a periodic box brings the flow back to a wanted velocity."""

    strip: StripSection = key(..., "the strip, along the periodic axis that the fluid flows along")
    velocity: Vector = key(
        ..., "what fluid leaves the strip with, numbers or expressions in x, y, t", unit="m/s"
    )
    strength: Positive = key(
        200.0,
        "K: the integral of the forcing's rate over the strip, over the largest speed",
        unit="-",
    )
    ramp: Duration | None = key(
        None,
        "how long the inflow takes to come up to speed; null is the box's length over the largest "
        "speed from rest, 0 for runs that start with a velocity",
        unit="s",
    )

    def strip_in(self, domain: Domain, samples: Array, velocity: Callable[[Array], Array]) -> Strip:
        """Return the strip in a domain, of which there are samples (n_samples, 2) [m].

        Velocities are (2, n_samples) [m/s]. Raises ValueError where it can't be had.
        """
        start, end, inflows = self.strip.start, self.strip.end, dict[int, Array]()
        for axis in np.flatnonzero(domain.periodic).tolist():
            inside = (samples[:, axis] >= start) & (samples[:, axis] <= end)
            within = domain.lower[axis] <= start < end <= domain.upper[axis]
            if within and end - start < domain.lengths[axis] and inside.any():
                inflows[axis] = velocity(samples[inside].T)
        if not inflows:
            raise ValueError(
                "inflow.strip: must be a part of the box, from a lower to a higher place on an "
                "axis that box.periodic names; the fluid that leaves the box enters the strip"
            )
        means = {axis: float(inflow[axis].mean()) for axis, inflow in inflows.items()}
        axis = max(means, key=lambda each: abs(means[each]))
        speed = float(np.linalg.norm(inflows[axis], axis=0).max())
        if not abs(means[axis]) > NO_FLOW * speed:
            raise ValueError("inflow.velocity: nothing flows along the box's periodic axis")
        return Strip(axis, start, end, math.copysign(speed, means[axis]), self.strength)


def ramp_share(ramp: float, time: Array | float) -> Array | float:
    """Return the share of its speed that an inflow has reached at times [s], along a cosine."""
    if ramp == 0.0:
        return 1.0
    return 0.5 - 0.5 * np.cos(math.pi * np.clip(np.divide(time, ramp), 0.0, 1.0))


def inverse_permeability(bodies: Iterable[tuple[PorousSection, BaseGeometry]]) -> Rates | None:
    """Return 1/k [1/m2] at positions (2, n_positions) [m], zero outside of porous bodies.

    None where there are no bodies.
    """
    known = [(shape, 1.0 / body.permeability) for body, shape in bodies]
    shapely.prepare([shape for shape, _ in known])

    def at(position: Array) -> Array:
        return sum(inverse * shapely.contains_xy(shape, *position) for shape, inverse in known)

    return at if known else None
