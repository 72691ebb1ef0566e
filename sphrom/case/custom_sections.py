"""Sections of the scene of kind custom: inflows, porous bodies and fluid with a free surface."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import shapely
from pydantic import BeforeValidator, ConfigDict, Field

from sphrom.arrays import Array
from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
    Duration,
    OneOf,
    Point,
    Positive,
    Section,
    key,
)
from sphrom.case.shapes import ShapeSection, shapes_with
from sphrom.scenes.expressions import Expression
from sphrom.scenes.flows import BodyForce
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Strip
from sphrom.sph.places import grid

Value = Coordinate | Annotated[str, Field(max_length=1000)]
"""A number, or an expression."""
Rate = Duration | Annotated[str, Field(max_length=1000)]
"""A non-negative number, or an expression."""
NO_FLOW = 1e-6
"""Least mean speed of an inflow along the axis, relative to the largest speed."""


def _without_tables(value: Any) -> Any:
    """Refuse mappings, which are meant as tables."""
    if any(isinstance(part, Mapping) for part in (value if isinstance(value, list) else [value])):
        raise ValueError(
            "must be a list of numbers or expressions; for a table, set scene.histories to "
            "{sway: {file: sway.csv}}, and write sway(t) in an expression"
        )
    return value


Vector = Annotated[
    tuple[Value, ...], Field(min_length=2, max_length=3), BeforeValidator(_without_tables)
]
"""A component along each axis of the box."""


class BoxSection(Section):
    """The box that contains the flow."""

    lower: Point = key((0.0, 0.0), "lower left corner, (x, y) or (x, y, z)", unit="m")
    upper: Point = key((1.0, 1.0), "upper right corner", unit="m")
    periodic: tuple[Literal["x", "y", "z"], ...] = key((), "periodic axes")


class MovingWallSection(Section):
    """The motion of a wall along itself."""

    velocity: Vector | None = key(
        None, "velocity, numbers or expressions in x, y (and z) and t", unit="m/s"
    )
    rotation: Value | None = key(
        None,
        "rate of rotation about its centroid, anticlockwise, a number or an expression in t",
        unit="rad/s",
    )


class PorousSection(ShapeSection):
    """A porous body: fluid flows through its shape against Darcy's resistance nu/k."""

    permeability: Positive = key(..., "permeability k", unit="m2")


Porous = Annotated[PorousSection, OneOf(**shapes_with(PorousSection))]


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

    def samples(self, domain: Domain, axis: int) -> Array:
        """Return points (n_points, 2) [m] of the fluid in the strip, on its edges too.

        Points on a solid that only touches the strip, such as one that ends at the edge of the box,
        do not count: there is no fluid of the strip beside them.
        """
        lower = np.array(domain.lower)
        upper = np.array(domain.upper)
        lower[axis] = self.strip.start
        upper[axis] = self.strip.end
        points = grid(lower, upper)
        if domain.fills_box:
            return points
        parts = shapely.get_parts(shapely.intersection(domain.fluid, shapely.box(*lower, *upper)))
        fluid = shapely.union_all(parts[shapely.area(parts) > 0.0])
        shapely.prepare(fluid)
        return points[shapely.intersects_xy(fluid, *points.T)]

    def strip_in(self, domain: Domain, velocities: Sequence[Callable[[Array], Array]]) -> Strip:
        """Return the strip in a domain, with the largest speed of all velocities.

        Parameters
        ----------
        velocities : of all runs, each (2, n_samples) [m/s] at positions (2, n_samples) [m].

        Raises ValueError unless the strip is part of the box and fluid flows through it.
        """
        start = self.strip.start
        end = self.strip.end
        inflows = dict[int, Array]()
        for axis in np.flatnonzero(domain.periodic).tolist():
            within = domain.lower[axis] <= start < end <= domain.upper[axis]
            if not within or end - start >= domain.lengths[axis]:
                continue
            places = self.samples(domain, axis)
            if len(places):
                fields = [velocity(places.T) for velocity in velocities]
                inflows[axis] = max(fields, key=lambda field: np.linalg.norm(field, axis=0).max())
        if not inflows:
            raise ValueError(
                "inflow.strip: must be part of the box, with `from` below `to`, on an axis that "
                "box.periodic names; fluid that leaves the box enters the strip"
            )
        means = {axis: float(inflow[axis].mean()) for axis, inflow in inflows.items()}
        axis = max(means, key=lambda each: abs(means[each]))
        speed = float(np.linalg.norm(inflows[axis], axis=0).max())
        if not SMALLEST <= speed <= LARGEST:
            raise ValueError(
                f"inflow.velocity: its largest speed must be {SMALLEST:g} to {LARGEST:g} m/s; got "
                f"{speed:g} m/s"
            )
        if not abs(means[axis]) > NO_FLOW * speed:
            raise ValueError("inflow.velocity: must have a mean along the periodic axis of the box")
        return Strip(axis, start, end, math.copysign(speed, means[axis]), self.strength)


def ramp_share(ramp: float, time: Array | float) -> Array | float:
    """Return the share of its speed that an inflow has reached at times [s], half a cosine."""
    if ramp == 0.0:
        return 1.0
    return 0.5 - 0.5 * np.cos(math.pi * np.clip(np.divide(time, ramp), 0.0, 1.0))


SURFACE_DEFAULTS: Mapping[str, Any] = {
    "discretization": {
        "smoothing_length_ratio": 2.5,
        "acoustic_damping": 0.1,
        "fixed_volume": False,
        "viscosity": "paper",
        "shifting": {"enabled": False},
        "walls": {"kind": "adjoint"},
    }
}
"""Defaults of other sections for scenes with a free surface.

A lattice under pressure resists shear like a solid, because the kernel's sums are inexact on a
strained lattice: at h = 2 dx waves are 0.9 % too fast. Only viscous forces along pairs are
consistent at the surface (Colagrossi et al., Phys. Rev. E 84, 2011). Walls of kind `adjoint` give
no energy to sound, so that fluid at rest stays at rest. The damper is weak, because sums over an
incomplete support have a divergence at the surface.
"""


class SurfaceFluidSection(Section):
    """Fluid with a free surface, which fills part of the box."""

    model_config = ConfigDict(defer_build=True)

    if TYPE_CHECKING:  # only fluid below a level has the key
        level: Value | None

    gravity: Duration = key(9.81, "acceleration along -y", unit="m/s2")

    @abstractmethod
    def fill(self, domain: Domain, particle_spacing: float, level: float) -> Array:
        """Return the points (n_particles, 2) [m] of the domain's lattice in the fluid.

        Parameters
        ----------
        level : height of the surface at rest [m]; not used for a shape.
        """


class LevelFluid(SurfaceFluidSection):
    """Fluid below a level."""

    level: Value = key(
        ..., "height y of the surface at rest, a number or an expression of constants", unit="m"
    )

    def fill(self, domain: Domain, particle_spacing: float, level: float) -> Array:
        points = domain.fill(particle_spacing)
        filled = points[points[:, 1] < level]
        if domain.fills_box:
            return filled
        # Beside solids a lattice may not end at the level, or not along the sides.
        below = domain.below(level)
        ends = domain.row_end(level, particle_spacing) == level
        right = ends and len(filled) == below.n_particles(particle_spacing)
        return filled if right else below.fill(particle_spacing)


class ShapedFluid(SurfaceFluidSection, ShapeSection):
    """Fluid within a shape."""

    level: ClassVar[None] = None  # type: ignore[misc]

    def fill(self, domain: Domain, particle_spacing: float, level: float) -> Array:
        points = domain.fill(particle_spacing)
        return points[shapely.contains_xy(self.geometry(), *points.T)]


SurfaceFluid = Annotated[
    SurfaceFluidSection,
    OneOf(level=LevelFluid, **shapes_with(ShapedFluid, "circle", "rectangle", "polygon")),
]


@dataclass(frozen=True)
class SurfaceForce(BodyForce):
    """Gravity and a body force whose components may change differently with time.

    `field` is its value at the start, and `amplitude` is one.
    """

    parts: tuple[Expression, ...] = ()
    """Components of the body force, in x, y and t."""
    gravity: float = 0.0
    """Acceleration along -y [m/s2]."""

    @classmethod
    def of(cls, parts: tuple[Expression, ...], gravity: float) -> SurfaceForce:
        """Return the acceleration by the components of a body force and by gravity [m/s2]."""
        force = cls(lambda at: force(at, 0.0), lambda time: 1.0, None, True, parts, gravity)
        return force

    def over(self, times: Array) -> Array:
        """Return a uniform body force at times (2, n_times) [m/s2], without gravity."""
        values = [part(x=0.0, y=0.0, t=times) for part in self.parts]
        return np.stack([np.broadcast_to(one, times.shape) for one in values])

    def __call__(self, position: Array, time: float) -> Array:
        out = np.empty_like(position)
        for row, part in zip(out, self.parts, strict=True):
            row[:] = part(x=position[0], y=position[1], t=time)
        out[1] -= self.gravity
        return out
