"""The resistance in a scene of kind custom: an expression, porous bodies and an inflow's strip.

It does not depend on parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.driving import at_places, finite_peak, require_finite
from sphrom.metrics.grids import midpoints
from sphrom.sph.fluid import Resistance
from sphrom.sph.places import N_SAMPLES

if TYPE_CHECKING:
    from sphrom.case.custom_scene import CustomScene


class Slowing:
    """The resistance in a scene, from its expression, porous bodies and strip.

    Parameters
    ----------
    bodies : the shapes of porous bodies, by name.

    Raises ValueError if a body contains no fluid.
    """

    def __init__(self, scene: CustomScene, bodies: Mapping[str, BaseGeometry]) -> None:
        self._scene, self._bodies = scene, bodies
        self._permeability = {name: scene.porous[name].permeability for name in bodies}
        fluid = scene.domain.fluid if bodies else shapely.Point()
        self._parts = {name: fluid.intersection(shape) for name, shape in bodies.items()}
        for name, part in self._parts.items():
            if not part.area > 0.0:
                raise ValueError(
                    f"porous.{name}: contains no fluid; it is in solids or out of the box"
                )

    @cached_property
    def resistance(self) -> Resistance | None:
        """The resistance to the flow. Raises ValueError if it is negative or not finite."""
        scene = self._scene
        own = None
        if scene.resistance != 0.0:
            expression = scene.at().expression("resistance", scene.resistance, "x", "y")
            own = partial(at_places, expression)
            places = scene.places.all
            rate = own(places.T)
            require_finite("resistance", rate, places)
            finite_peak("resistance", scene.places, own)
            least, (x, y) = finite_peak("resistance", scene.places, lambda at: -own(at))
            if rate.min() < 0.0:
                x, y = places[np.argmin(rate)]
            if min(rate.min(), -least) < 0.0:
                raise ValueError(f"resistance: is negative at ({x:g}, {y:g}) m")
        if own is None and not self._bodies and scene.strip is None:
            return None
        inverse = self._inverse_permeability if self._bodies else None
        return Resistance(own, inverse, scene.strip, scene.places.wrapped)

    def _inverse_permeability(self, position: Array) -> Array:
        """Return the sum of 1/k of the bodies (n_positions,) [1/m2] at positions [m]."""
        return sum(
            1.0 / self._permeability[name] * shapely.contains_xy(shape, *position)
            for name, shape in self._bodies.items()
        )

    def largest(self, viscosity: float) -> float:
        """Return the largest rate [1/s] at a viscosity [m2/s]."""
        if self.resistance is None:
            return 0.0
        return self.resistance.largest(self._slowest.T, viscosity)

    @cached_property
    def _slowest(self) -> Array:
        """Places (n_places, 2) [m] that include those with the largest resistance."""
        places = [self._scene.places.all]
        if self.resistance is not None and self.resistance.own is not None:
            places.append(self._scene.places.peak(self.resistance.own)[1][None])
        # Samples miss thin bodies.
        parts = list(self._parts.values())
        shared = (one.intersection(other) for one, other in combinations(parts, 2))
        inside = [part.representative_point() for part in (*parts, *shared) if part.area > 0.0]
        return np.concatenate([*places, shapely.get_coordinates(inside)])

    @cached_property
    def way(self) -> float:
        """The least integral of 1/k along lines through the box [1/m]; the larger of x and y."""
        domain = self._scene.domain
        ways = [0.0]
        for axis in range(2) if self._parts else ():
            middles = midpoints(domain.lower[axis], domain.upper[axis], N_SAMPLES)
            lines = shapely.intersection(domain.fluid, self._scene.places.lines(axis, middles))
            lines = lines[shapely.length(lines) > 0.0]
            parts = (
                shapely.length(shapely.intersection(part, lines)) / self._permeability[name]
                for name, part in self._parts.items()
            )
            ways.append(float(sum(parts).min(initial=math.inf)))
        return max(ways)

    @property
    def widths(self) -> dict[str, float]:
        """The width [m] of each porous body, the diameter of the largest circle in it."""
        parts = self._parts.items()
        circles = {name: shapely.maximum_inscribed_circle(part) for name, part in parts}
        return {name: 2.0 * float(circle.length) for name, circle in circles.items()}
