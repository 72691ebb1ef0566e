"""The scene of kind custom: a box with solids of any shape, moving walls and a body force.

Walls' velocities and the force must be affine in the parameters, because operators are projected
once: each parameter that drives the flow has its own operators, which its value multiplies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import PrivateAttr, model_validator
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case import custom_checks
from sphrom.case.custom_sections import (
    BoxSection,
    InflowSection,
    MovingWallSection,
    Porous,
    Rate,
    SurfaceFluid,
    Vector,
)
from sphrom.case.driving import (
    BODY_FORCE,
    INFLOW,
    Driving,
    at_places,
)
from sphrom.case.fields import Coordinate, Positive, SafeName, key
from sphrom.case.functions import Digest, function_of
from sphrom.case.measure_sections import MEASURE, Measures
from sphrom.case.points import REYNOLDS
from sphrom.case.scene_section import OF_WALLS, Defaults, SceneSection, Settings
from sphrom.case.shapes import Shape, ShapeSection
from sphrom.case.slowing import Slowing
from sphrom.case.space_checks import check_axes
from sphrom.case.tables import Histories, InitialSection
from sphrom.scenes.expressions import CALLED, CONSTANTS, FUNCTIONS, Function
from sphrom.scenes.flows import CustomFlow, Scales, Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import NONE, Strip
from sphrom.sph.places import Places
from sphrom.sph.polygons import connects_images
from sphrom.sph.space_box import SpaceBox
from sphrom.sph.terms import Term

MOST_PLACES = 200_000
"""Largest number of particles at whose places expressions are also checked."""
MOST_SETTINGS = 64
"""Largest number of parameter points, evenly chosen, at which slow checks are made."""
MOST_KNOWN = 4000
"""Largest number of parameter points with a cached driving."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The parameters and the time of all runs of a case, where they are known."""

    settings: Settings = ({},)
    """The values of the parameters at all points."""
    until: float = 0.0
    """The end of runs [s]."""
    places: Array = field(default_factory=lambda: np.empty((0, 2)))
    """Places of particles (n_places, n_dim) [m]."""


NO_RUNS = Runs()


class CustomScene(SceneSection):
    """A flow of your own: a box without solids, with moving walls, a force and initial fields."""

    title: ClassVar[str] = "A flow of your own"
    defaults: ClassVar[Defaults] = {
        **OF_WALLS,
        "discretization": {"smoothing_length_ratio": 2.0, "resolution": 20},
    }

    kind: Literal["custom"] = key(..., "kind of flow")
    box: BoxSection = key(BoxSection(), "the box that contains the flow")
    solids: dict[SafeName, Shape] = key({}, "solids in the box, by name")
    walls: dict[SafeName, MovingWallSection] = key(
        {},
        "moving walls: sides of the box (left, right, bottom, top; in three dimensions also "
        "back, front) and "
        "solids, by name",
    )
    constants: dict[SafeName, Coordinate] = key({}, "constants for expressions, by name")
    histories: dict[SafeName, Histories] = key(
        {},
        "functions of time, by name; expressions in t may contain sway(t) if one has the name sway",
    )
    functions: dict[SafeName, Digest] = key(
        {}, "digests of functions that expressions may call, which only sphrom.Flow gives"
    )
    terms: dict[SafeName, dict[Literal["linear", "quadratic", "acceleration"], Digest]] = key(
        {}, "digests of terms of the acceleration by kind, which only sphrom.Flow gives"
    )
    body_force: Vector = key(
        (0.0, 0.0), "acceleration, numbers or expressions in x, y (and z) and t", unit="m/s2"
    )
    fluid: SurfaceFluid | None = key(
        None, "the part of the box that fluid with a free surface fills; null fills all of it"
    )
    slip: Literal["none", "free"] = key("none", "whether fluid sticks to the walls or slips freely")
    resistance: Rate = key(
        0.0, "rate of resistance to the flow, a number or an expression in x, y", unit="1/s"
    )
    porous: dict[SafeName, Porous] = key({}, "porous bodies in the box, by name")
    inflow: InflowSection | None = key(None, "inflow of an open box")
    initial: InitialSection = key(InitialSection(), "initial fields of runs")
    reference_length: Positive | None = key(
        None, "L of the Reynolds number; null is the width of the box", unit="m"
    )
    measure: Measures = MEASURE
    _runs: Runs = PrivateAttr(default_factory=lambda: NO_RUNS)

    @model_validator(mode="after")
    def _consistent(self) -> CustomScene:
        """Refuse inconsistent keys, and scenes that can't be built."""
        reserved = (*self.axes, "t", REYNOLDS, *CONSTANTS, *FUNCTIONS, *CALLED)
        taken = set[str]()
        for kind in ("constants", "histories", "functions"):
            for name in getattr(self, kind):
                if name in reserved:
                    raise ValueError(f"{kind}.{name}: the name is reserved; choose another")
                if kind != "constants" and (name in taken or not name.isidentifier()):
                    reason = "must be a name of letters, digits and _ that no constant has"
                    raise ValueError(f"{kind}.{name}: {reason}")
                taken.add(name)
        for name, wall in self.walls.items():
            if (wall.velocity is None) == (wall.rotation is None):
                raise ValueError(f"walls.{name}: give velocity or rotation")
            if name not in self.domain.wall_names:
                names = ", ".join(self.domain.wall_names) or "none"
                raise ValueError(f"walls.{name}: there is no such wall; the walls are {names}")
        _ = self.domain
        check_axes(self)
        if self.slip == "free" and self.walls:
            raise ValueError("slip: moving walls need friction; set slip: none")
        if self.fluid is not None:
            if self.inflow is not None:
                raise ValueError("inflow: is not for fluid with a free surface; leave it out")
            if self.fluid.level is not None and "y" in self.box.periodic:
                raise ValueError("fluid.level: needs a floor; leave y out of box.periodic")
        self.check_at({})
        _ = self.term_rate
        return self

    @property
    def has_surface(self) -> bool:
        return self.fluid is not None

    @property
    def gravity(self) -> float:
        return 0.0 if self.fluid is None else self.fluid.gravity

    @property
    def free_slip(self) -> bool:
        return self.slip == "free"

    @property
    def until(self) -> float:
        """The end of runs [s], zero where it is not known."""
        return self._runs.until

    @property
    def resolved_length(self) -> float:
        return self.reference_length or self.domain.lengths[0]

    # Geometry

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of coordinates in expressions."""
        return ("x", "y", "z")[: len(self.box.lower)]

    @property
    def acceleration(self) -> tuple[float | str, ...]:
        """The components of the body force along all axes."""
        return self.body_force if any(self.body_force) else (0.0,) * len(self.axes)

    @cached_property
    def shapes(self) -> dict[str, BaseGeometry]:
        """The solids by name."""
        return _geometries("solids", self.solids)

    @cached_property
    def domain(self) -> Domain:
        """The box without its solids."""
        lower = self.box.lower
        upper = self.box.upper
        if len(lower) != len(upper):
            raise ValueError("box: lower and upper must have the same number of coordinates")
        if not all(low < high for low, high in zip(lower, upper, strict=True)):
            raise ValueError("box: upper must be above lower along all axes")
        periodic = tuple(axis in self.box.periodic for axis in self.axes)
        box: dict[str, Any] = {"lower": lower, "upper": upper, "periodic": periodic}
        if len(lower) > 2:
            return SpaceBox(**box)
        if not self.solids:
            return BoxDomain(**box, level=self._row_end)
        # Imported late, because it loads kernels that other scenes do not need.
        from sphrom.sph.polygon_domain import PolygonDomain

        try:
            return PolygonDomain(**box, solids=tuple(self.shapes.items()))
        except ValueError as error:
            hints = (f"; {where} {hint}" for where, hint in custom_checks.odd_units(self))
            raise ValueError(f"{error}{''.join(hints)}") from error

    @property
    def _row_end(self) -> float | None:
        """The level below the box's upper side that no constant changes [m], or None."""
        if self.fluid is None or self.fluid.level is None:
            return None
        level = self.level_at()
        expression = self.at().expression("fluid.level", self.fluid.level)
        constant = not expression.degree_in(self.constants)
        return level if constant and self.box.lower[1] < level < self.box.upper[1] else None

    def level_at(self, values: Mapping[str, float] = NONE) -> float:
        return self.at(values).level

    def fill(self, particle_spacing: float, values: Mapping[str, float] = NONE) -> Array:
        if self.fluid is None:
            return super().fill(particle_spacing, values)
        return self.fluid.fill(self.domain, particle_spacing, self.level_at(values))

    @property
    def called(self) -> dict[str, Function]:
        """Functions that expressions may call, by name."""
        return {name: Function(name, function_of(one)) for name, one in self.functions.items()}

    @property
    def added(self) -> dict[str, Term]:
        return {
            name: Term(**{kind: function_of(one) for kind, one in functions.items()})
            for name, functions in self.terms.items()
        }

    @property
    def has_functions(self) -> bool:
        return bool(self.functions or self.terms)

    @cached_property
    def term_rate(self) -> float:
        """The largest rate of linear terms [1/s]."""
        return custom_checks.largest_rate(self)

    @cached_property
    def places(self) -> Places:
        """The places at which expressions are evaluated and checked."""
        places = self._runs.places.reshape(-1, self.domain.n_dim)
        return Places(self.domain, self.shapes, places)

    # Drives and initial fields at values of the parameters

    @cached_property
    def _known(self) -> Callable[[tuple[tuple[str, float], ...]], Driving]:
        return lru_cache(MOST_KNOWN)(lambda values: Driving(self, dict(values)))

    def at(self, values: Mapping[str, float] = NONE) -> Driving:
        """Return the driving at values of the parameters, by default the scene's own."""
        return self._known(tuple(values.items()))

    def over(self, settings: Settings, particle_spacing: float, until: float) -> CustomScene:
        """Return the scene whose strip fits all values of its parameters, and times [s] of runs.

        Expressions are also checked at the places of particles with a spacing [m], and between.
        """
        given = (*self.acceleration, self.resistance)
        varied = bool(self.porous) or any(isinstance(value, str) for value in given)
        found = [np.empty((0, self.domain.n_dim)), *self._beside_jumps()]
        if varied and MOST_PLACES * particle_spacing**self.domain.n_dim > math.prod(
            self.domain.lengths
        ):
            found += [self.domain.fill(part * particle_spacing) for part in (1.0, 0.5)]
        keys = {name: getattr(self, name) for name in type(self).model_fields}
        other = self.model_construct(self.model_fields_set, **keys)
        other.__dict__.update(shapes=self.shapes, domain=self.domain)
        other._runs = Runs(settings, until, np.concatenate(found))
        return other

    def _beside_jumps(self) -> Iterator[Array]:
        """Yield places (n_places, 2) [m] beside jumps of the resistance, force and inflow."""
        here = self.at()
        parts = [here.expression("resistance", self.resistance, *self.axes)]
        vectors = (*self.acceleration, *(self.inflow.velocity if self.inflow else ()))
        parts += [here.expression(BODY_FORCE, part, *self.axes, "t") for part in vectors]
        for difference in (each for part in parts for each in part.compared()):
            if difference.depends_on and "t" not in difference.depends_on:
                yield self.places.beside(partial(at_places, difference))

    def flow(self, scales: Scales) -> Scene:
        here = self.at(scales.values)
        return CustomFlow(
            self.domain,
            {name: here.wall_velocity(name) for name in self.walls},
            here.begin(scales.density),
            here.force,
            self.slowing.resistance,
            here.wall_amplitudes,
            tuple(self.added.values()),
        )

    def starts_by(self, name: str) -> bool:
        level = None if self.fluid is None else self.fluid.level
        starts = (*self.at().start.values(), self.at().expression("fluid.level", level or 0.0))
        return any(part.degree_in([name]) > 0.0 for part in starts)

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return constants, rates of rotation, and factors of velocities and the body force."""
        factors = {
            name: wall.rotation if isinstance(wall.rotation, float) else 1.0
            for name, wall in self.walls.items()
        }
        return {**self.constants, **factors, **dict.fromkeys(self.at().factors, 1.0)}

    def driving(self, names: Collection[str]) -> tuple[str, ...]:
        fields = [part for drive in self.at().drives for part in drive.fields]
        return tuple(
            name
            for name in names
            if name in self.walls or any(part.degree_in([name]) > 0.0 for part in fields)
        )

    def scheduling(self, names: Collection[str]) -> tuple[str, ...]:
        knots = self.at().histories.values()
        driving = self.driving(names)
        return tuple(
            name
            for name in names
            if name not in driving and any(history.degree_in([name]) > 0.0 for history in knots)
        )

    @property
    def amplitudes(self) -> Mapping[str, str]:
        return self.at().amplitudes

    def largest_amplitude(self, until: float) -> float:
        here = self.at()
        return max((d.largest(here.times(until)) for d in here.walls.values()), default=1.0)

    def largest_wall_speed(self, values: Mapping[str, float], until: float = 0.0) -> float:
        """Return the largest speed of walls and the inflow [m/s], at values of the parameters."""
        return max(self.at(values).speeds(until).values(), default=0.0)

    def largest_head(self, final_time: float, values: Mapping[str, float] = NONE) -> float:
        return self.at(values).largest_head(final_time)

    def shortest_period(self, settings: Settings) -> float:
        """Return the shortest period [s] with which the driving oscillates at some values."""
        timed = [expression for _, expression in self.at().timed()]
        used = [n for n in self.constants if any(one.degree_in([n]) > 0.0 for one in timed)]
        chosen = {tuple(v.get(name, self.constants[name]) for name in used) for v in settings}
        some_values = sorted(chosen)[:: math.ceil(len(chosen) / MOST_SETTINGS)]
        return min(self.at(dict(zip(used, v, strict=True))).shortest_period for v in some_values)

    # Checks

    def check_at(self, values: Mapping[str, float]) -> None:
        here = self.at(values)
        custom_checks.check_walls(here)
        _ = here.force, here.initial, self.slowing.resistance
        custom_checks.check_surface(here)

    @property
    def checked_drivings(self) -> Iterator[Driving]:
        """The driving at some values of the parameters in the runs."""
        settings = self._runs.settings
        return map(self.at, settings[:: math.ceil(len(settings) / MOST_SETTINGS)])

    parameter_problems = custom_checks.parameter_problems
    problems = custom_checks.problems
    unknown_times = custom_checks.unknown_times
    unresolved = custom_checks.unresolved
    warnings = custom_checks.warnings

    # The inflow

    @cached_property
    def strip(self) -> Strip | None:
        """The strip of the inflow, the same at all values of the parameters."""
        if self.inflow is None:
            return None
        if INFLOW not in self.at().pushes:
            raise ValueError("inflow.velocity: is zero; leave inflow out")
        velocities = [self.at(values).inflow(self.until) for values in self._runs.settings]
        strip = self.inflow.strip_in(self.domain, velocities)
        if not connects_images(self.domain.fluid_with_images, self.domain.lengths, strip.axis):
            along = "xy"[strip.axis]
            raise ValueError(
                f"inflow: solids block the flow along {along}, so fluid that leaves the strip at "
                f"{along} = {strip.end if strip.speed > 0.0 else strip.start:g} m can't come back "
                "to it; leave a gap, or make the solid a porous body"
            )
        return strip

    @cached_property
    def strip_samples(self) -> Array:
        """Points of the fluid in the strip (n_points, 2) [m]; none without an inflow."""
        if self.inflow is None or self.strip is None:
            return np.empty((0, 2))
        return self.inflow.samples(self.domain, self.strip.axis)

    @cached_property
    def ramp(self) -> float:
        if self.inflow is None or (strip := self.strip) is None:
            return 0.0
        from_rest = self.initial == InitialSection()
        usual = self.domain.lengths[strip.axis] / abs(strip.speed) if from_rest else 0.0
        return usual if self.inflow.ramp is None else self.inflow.ramp

    # The resistance, which does not depend on parameters

    @cached_property
    def slowing(self) -> Slowing:
        """The resistance to the flow."""
        return Slowing(self, _geometries("porous", self.porous))

    def largest_resistance(self, viscosity: float) -> float:
        return self.slowing.largest(viscosity) + self.term_rate

    @property
    def porous_way(self) -> float:
        return self.slowing.way

    @property
    def porous_widths(self) -> dict[str, float]:
        return self.slowing.widths


def _geometries(where: str, sections: Mapping[str, ShapeSection]) -> dict[str, BaseGeometry]:
    """Return the shapes of sections by name. Raises ValueError with the name of the section."""
    shapes = {}
    for name, section in sections.items():
        try:
            shapes[name] = section.geometry()
        except ValueError as error:
            raise ValueError(f"{where}.{name}: {error}") from error
    return shapes
