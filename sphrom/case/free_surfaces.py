"""Fluid with a free surface: its shape at rest, and the accelerations that act on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import Field, model_validator
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.expressions import Expression
from sphrom.case.fields import Duration, Place, Section, key, only_one
from sphrom.case.resistances import Value
from sphrom.case.shapes import CircleSection, RectangleSection, ShapeSection
from sphrom.scenes.flows import BodyForce
from sphrom.sph.domain import Domain


def surface_defaults(slip_along_axes: bool) -> dict[str, Any]:
    """Return defaults of other sections for scenes with a free surface.

    A lattice under pressure resists shear like a solid, because the kernel's sums are inexact on a
    strained lattice: at h = 2 dx waves are 0.6 % too fast. Only viscous forces along pairs are
    consistent at the surface (Colagrossi et al., Phys. Rev. E 84, 2011). Walls that return the flux
    into them turn fluid that slides past their ghosts into noise. Other walls need a damper; it is
    weak, because sums over an incomplete support have a divergence at the surface.

    Parameters
    ----------
    slip_along_axes : whether fluid slips freely along all walls, and all follow the axes.
    """
    return {
        "discretization": {
            "smoothing_length_ratio": 2.5,
            "acoustic_damping": 0.1,
            "fixed_volume": False,
            "viscosity": "paper",
            "shifting": {"enabled": False},
            "walls": {"continuity": "normal" if slip_along_axes else "adjoint"},
        }
    }


SHAPES = "level", "circle", "rectangle", "polygon"
"""The keys for the shape of the fluid; a case has exactly one."""


class SurfaceFluidSection(Section):
    """Fluid that fills part of the box, below a level or within a shape."""

    level: Value | None = key(
        None, "height y of the surface at rest, a number or an expression of constants", unit="m"
    )
    circle: CircleSection | None = key(None, "a circle that fluid fills")
    rectangle: RectangleSection | None = key(None, "a rectangle along the axes that fluid fills")
    polygon: Annotated[tuple[Place, ...], Field(min_length=3)] | None = key(
        None, "corners of a polygon that fluid fills, in order", unit="m"
    )
    gravity: Duration = key(9.81, "acceleration along -y", unit="m/s2")

    @model_validator(mode="after")
    def _one_kind(self) -> SurfaceFluidSection:
        only_one(self, SHAPES)
        return self

    def geometry(self) -> BaseGeometry:
        """Return the polygon of a shape [m]. Raises ValueError if it is not a polygon."""
        kind = only_one(self, SHAPES)
        return ShapeSection.model_validate({kind: getattr(self, kind)}).geometry()

    def fill(self, domain: Domain, particle_spacing: float, level: float) -> Array:
        """Return the points (n_particles, 2) [m] of the domain's lattice in the fluid.

        Parameters
        ----------
        level : height of the surface at rest [m]; not used for a shape.
        """
        points = domain.fill(particle_spacing)
        if self.level is not None:
            return points[points[:, 1] < level]
        return points[shapely.contains_xy(self.geometry(), *points.T)]


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

    @property
    def varies_in_space(self) -> bool:
        """Whether the body force depends on x or y."""
        return any(part.depends_on & {"x", "y"} for part in self.parts)

    def uniform(self, times: Array) -> Array:
        """Return a uniform body force at times (2, n_times) [m/s2], without gravity."""
        values = [part(x=0.0, y=0.0, t=times) for part in self.parts]
        return np.stack([np.broadcast_to(one, times.shape) for one in values])

    def __call__(self, position: Array, time: float) -> Array:
        out = np.empty_like(position)
        for row, part in zip(out, self.parts, strict=True):
            row[:] = part(x=position[0], y=position[1], t=time)
        out[1] -= self.gravity
        return out


def hydrostatic(
    start: Callable[[Array], Array], level: float, weight: float
) -> Callable[[Array], Array]:
    """Return initial conditions with the hydrostatic pressure below a level [m] added.

    Parameters
    ----------
    start : returns velocity and pressure (n_points, 3) at positions (n_points, 2) [m].
    weight : density times gravity [N/m3].
    """

    def at(position: Array) -> Array:
        fields = start(position)
        fields[:, 2] += weight * (level - position[:, 1])
        return fields

    return at
