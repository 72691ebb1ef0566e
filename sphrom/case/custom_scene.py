"""The scene of kind custom: a box with solids of any shape, moving walls and a body force.

Walls' velocities and the force must be affine in the parameters, because operators are projected
once: each parameter that drives the flow has its own operators, which its value multiplies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import combinations
from typing import Any, ClassVar, Literal

import numpy as np
import shapely
from pydantic import PrivateAttr, ValidationInfo, model_validator
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.custom_sections import (
    HistorySection,
    InflowSection,
    PorousSection,
    Rate,
    SurfaceFluidSection,
    SurfaceForce,
    Value,
    Vector,
    hydrostatic,
    inverse_permeability,
    ramp_share,
    read_start,
    start_fields,
    with_digest,
)
from sphrom.case.expressions import CALLED, CONSTANTS, FUNCTIONS, MOST_QUOTED, Expression
from sphrom.case.fields import LARGEST, Coordinate, Place, Positive, SafeName, Section, key
from sphrom.case.scene_section import MEASURE, OF_WALLS, Defaults, Measures, SceneSection, Settings
from sphrom.case.shapes import ShapeSection
from sphrom.metrics.measures import midpoints
from sphrom.metrics.series import pole_of, sharpened, shortest_period
from sphrom.scenes.flows import Amplitude, BodyForce, CustomFlow, Scales, Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import SIDES, Domain
from sphrom.sph.fluid import NONE, Fluid, Resistance, Strip
from sphrom.sph.polygons import connects_images
from sphrom.text import shortened

N_SAMPLES = 200
"""Points along each edge of the box, or along a wall, at which expressions are checked."""
BESIDE, N_NEAREST = 1e-6, 4 * N_SAMPLES
"""Distance of places beside a jump from it, over that of samples, and samples that lead to it."""
N_INSTANTS = 50
"""Times of a run at which the head of a body force is computed."""
N_CHECKED = 4097
"""Times of a run at which a driving is checked."""
N_EACH = 16
"""Checked times from one whose amplitude gives a speed to the next."""
N_PEAKS = 16
"""Samples with the largest values, from which peaks of an expression are searched."""
MOST_PLACES = 200_000
"""Most places of particles at which expressions are checked, too."""
MOST_SETTINGS = 64
"""Most values of the parameters, evenly chosen, at which slow checks are made."""
FASTEST = 0.45
"""Largest speed over that of sound; the density then changes by 10 %, which ends a run."""
LARGEST_CHANGE = 0.1
"""Largest relative change of the density, which ends a run."""
THROUGH_WALL = 0.07
"""Largest initial speed through a wall over that of sound. Sound that a flat wall reflects changes
the density by this share, and more in corners; at 0.08 a box of 20 x 20 particles is unstable."""
ALONG = 0.02
"""Largest normal speed of a wall over its speed; it is not zero because circles are polygons."""
TOUCHING = 1e-6
"""Tolerated distance of a wall from the edge of the fluid, over its length."""
MOST_KNOWN = 4000
"""Most values of the parameters with a cached scene."""
BODY_FORCE, INFLOW = "body_force", "inflow"
"""The names of their factors as parameters."""
KEYS = {BODY_FORCE: "body_force", INFLOW: "inflow.velocity"}
"""The keys of the parameters."""
OTHER_UNIT = 100.0
"""Ratio of the widths of a solid and the box, or its inverse, that suggests another unit."""
MOST_AREAS = 4
"""Most areas that a warning about separate parts of the fluid lists."""
N_TIMES = 4096
"""Most times with a cached amplitude, and times at which histories are looked for."""


class BoxSection(Section):
    """The box that contains the flow."""

    lower: Place = key((0.0, 0.0), "lower left corner", unit="m")
    upper: Place = key((1.0, 1.0), "upper right corner", unit="m")
    periodic: tuple[Literal["x", "y"], ...] = key((), "periodic axes")


class MovingWallSection(Section):
    """The motion of a wall along itself."""

    velocity: Vector | None = key(None, "velocity, numbers or expressions in x, y, t", unit="m/s")
    rotation: Value | None = key(
        None,
        "rate of rotation about its centroid, anticlockwise, a number or an expression in t",
        unit="rad/s",
    )


class InitialSection(Section):
    """The initial fields of runs: numbers or expressions in x, y, or a file of points."""

    u: Value = key(0.0, "velocity along x", unit="m/s")
    v: Value = key(0.0, "velocity along y", unit="m/s")
    p: Value = key(0.0, "pressure", unit="Pa")
    file: str | None = key(
        None,
        "a CSV file with columns x, y, u, v and optionally p, instead of expressions; fields are "
        "linear between its points, and beyond them those of the nearest point",
    )
    sha256: str | None = key(None, "digest of that file; computed if it is missing")

    @model_validator(mode="before")
    @classmethod
    def _with_digest(cls, values: Any, info: ValidationInfo) -> Any:
        """Add the digest of the file, so that the case identifies its content."""
        return with_digest(values, info, read_start)

    @model_validator(mode="after")
    def _file_alone(self) -> InitialSection:
        if self.file is not None and any(value != 0.0 for value in (self.u, self.v, self.p)):
            raise ValueError("file can't be combined with u, v and p; give one or the other")
        return self


class CustomScene(SceneSection):
    """A flow of your own: a box without solids, with moving walls, a force and initial fields."""

    title: ClassVar[str] = "A flow of your own"
    defaults: ClassVar[Defaults] = {
        **OF_WALLS,
        "discretization": {"smoothing_length_ratio": 2.0, "resolution": 20},
    }

    kind: Literal["custom"] = key(..., "kind of flow")
    box: BoxSection = key(BoxSection(), "the box that contains the flow")
    solids: dict[SafeName, ShapeSection] = key({}, "solids in the box, by name")
    walls: dict[SafeName, MovingWallSection] = key(
        {}, "moving walls: sides of the box (left, right, bottom, top) and solids, by name"
    )
    constants: dict[SafeName, Coordinate] = key({}, "constants for expressions, by name")
    histories: dict[SafeName, HistorySection] = key(
        {}, "measured histories, by name; for one named sway, expressions in t may contain sway(t)"
    )
    body_force: Vector = key(
        (0.0, 0.0), "acceleration, numbers or expressions in x, y, t", unit="m/s2"
    )
    fluid: SurfaceFluidSection | None = key(
        None, "the part of the box that fluid with a free surface fills; null fills all of it"
    )
    slip: Literal["none", "free"] = key("none", "whether fluid sticks to the walls or slips freely")
    resistance: Rate = key(
        0.0, "rate of resistance to the flow, a number or an expression in x, y", unit="1/s"
    )
    porous: dict[SafeName, PorousSection] = key({}, "porous bodies in the box, by name")
    inflow: InflowSection | None = key(None, "inflow of an open box")
    initial: InitialSection = key(InitialSection(), "initial fields of runs")
    reference_length: Positive | None = key(
        None, "L of the Reynolds number; null is the width of the box", unit="m"
    )
    measure: Measures = MEASURE
    _values: Mapping[str, float] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> CustomScene:
        """Refuse inconsistent keys, and scenes that can't be built."""
        for name in (*self.constants, *self.histories):
            kind = "constants" if name in self.constants else "histories"
            if name in ("x", "y", "t", *CONSTANTS, *FUNCTIONS, *CALLED):
                raise ValueError(f"{kind}.{name}: the name is reserved; choose another")
            if name in self.histories and (name in self.constants or not name.isidentifier()):
                reason = "must be a name of letters, digits and _ that no constant has"
                raise ValueError(f"histories.{name}: {reason}")
        for name, wall in self.walls.items():
            if (wall.velocity is None) == (wall.rotation is None):
                raise ValueError(f"walls.{name}: give velocity or rotation")
            if name not in self.domain.wall_names:
                names = ", ".join(self.domain.wall_names) or "none"
                raise ValueError(f"walls.{name}: there is no such wall; the walls are {names}")
        _ = self.domain
        if self.slip == "free" and self.walls:
            raise ValueError("slip: moving walls need friction; set slip: none")
        if self.fluid is not None:
            if self.inflow is not None:
                raise ValueError("inflow: is not for fluid with a free surface; leave it out")
            if self.fluid.level is not None and "y" in self.box.periodic:
                raise ValueError("fluid.level: needs a floor; leave y out of box.periodic")
        self.check_at({})
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

    def level_at(self, values: Mapping[str, float] = NONE) -> float:
        if self.fluid is None or self.fluid.level is None:
            return math.inf
        return float(self._at(values)._expression("fluid.level", self.fluid.level)())

    def fill(self, particle_spacing: float, values: Mapping[str, float] = NONE) -> Array:
        if self.fluid is None:
            return super().fill(particle_spacing, values)
        return self.fluid.fill(self.domain, particle_spacing, self.level_at(values))

    def _check_surface(self) -> None:
        """Raise ValueError unless the fluid with a free surface is in the box."""
        if self.fluid is None:
            return
        low, high = self.domain.lower[1], self.domain.upper[1]
        if self.fluid.level is None:
            if not self.domain.fluid.buffer(TOUCHING).contains(self.fluid.geometry()):
                raise ValueError("fluid: must lie within the box and outside of solids")
        elif not low < (level := self.level_at(self._values)) < high:
            raise ValueError(
                f"fluid.level: must be above {low:g} and below {high:g}; got {level:g}"
            )
        force = self._force
        if force is not None:
            _require_finite("body_force", force(self._places.T, 0.0).T, self._places)
        if force is not None and not self._values:  # for all values the same peaks
            self._peak("body_force", lambda at: np.abs(force(at, 0.0)).sum(axis=0))

    @cached_property
    def _shapes(self) -> dict[str, BaseGeometry]:
        return _geometries("solids", self.solids)

    @cached_property
    def domain(self) -> Domain:
        """The box less its solids."""
        lower, upper = self.box.lower, self.box.upper
        if not all(low < high for low, high in zip(lower, upper, strict=True)):
            raise ValueError("box: upper must be above lower along both axes")
        corners = (lower[0], lower[1]), (upper[0], upper[1])
        periodic = ("x" in self.box.periodic, "y" in self.box.periodic)
        if not self.solids:
            return BoxDomain(*corners, periodic, level=self._row_end)
        # Imported late, because it loads kernels that other scenes do not need.
        from sphrom.sph.polygon_domain import PolygonDomain

        try:
            return PolygonDomain(*corners, periodic, tuple(self._shapes.items()))
        except ValueError as error:
            hints = "".join(f"; solids.{name} {hint}" for name, hint in self._odd_units())
            raise ValueError(f"{error}{hints}") from error

    @property
    def _row_end(self) -> float | None:
        """The level below the box's upper side that no constant changes [m], or None."""
        if self.fluid is None or self.fluid.level is None:
            return None
        constant = not self._expression("fluid.level", self.fluid.level).degree_in(self.constants)
        level = self.level_at() if constant else math.inf
        return level if self.box.lower[1] < level < self.box.upper[1] else None

    def _odd_units(self) -> Iterator[tuple[str, str]]:
        """Yield solids whose coordinates seem to have another unit than the box, with reasons."""
        width = max(high - low for low, high in zip(self.box.lower, self.box.upper, strict=True))
        for name, shape in self._shapes.items():
            ratio = max(np.subtract(shape.bounds[2:], shape.bounds[:2])) / width
            if not 1.0 / OTHER_UNIT < ratio < OTHER_UNIT:
                yield name, f"is {ratio:.2g} times as wide as the box; `scale` changes units"

    def warnings(self) -> Iterator[tuple[str, str]]:
        """Warn of solids in another unit, and of solids that divide the fluid."""
        yield from ((f"solids.{name}", hint) for name, hint in self._odd_units())
        if len(areas := self.domain.separate_areas) > 1:
            sizes = ", ".join(f"{area:.4g}" for area in areas[:MOST_AREAS])
            yield "solids", f"divide the fluid into {len(areas)} parts, of {sizes} m2"
        read = {name for _, expression in self._timed() for name, _ in expression.read()}
        for name in self.histories.keys() - read:
            yield f"histories.{name}", f"is not used; write {name}(t) in an expression"
        if (strip := self.strip) is None:
            return
        # Solids may cross the strip if their width is constant, like walls.
        ends = np.tile(np.array([self.domain.lower, self.domain.upper]), (N_SAMPLES + 1, 1, 1))
        ends[..., strip.axis] = np.linspace(strip.start, strip.end, N_SAMPLES + 1)[:, None]
        for name, shape in self._shapes.items():
            widths = shapely.length(shapely.intersection(shape, shapely.linestrings(ends)))
            if np.ptp(widths) > TOUCHING * max(self.domain.lengths):
                yield f"solids.{name}", "is in the strip of the inflow, which forces the flow there"

    def flow(self, scales: Scales) -> Scene:
        here = self._at(scales.values)
        # Initial fields are evaluated when a run starts; they may be any function of constants.
        return CustomFlow(
            here.domain,
            {name: here._wall_velocity(name) for name in here.walls},
            here._begin(scales.density),
            here._force,
            self._resistance,
            here._wall_amplitudes,
        )

    def _begin(self, density: float) -> Callable[[Array], Array]:
        """Return the initial fields of runs, for a density of the fluid [kg/m3]."""
        level = self.level_at(self._values)
        if self.fluid is None or math.isinf(level):
            return lambda at: self._initial(at)
        weight = density * self.fluid.gravity
        return hydrostatic(lambda at: self._initial(at), level, weight)

    def over(self, settings: Settings, particle_spacing: float, until: float) -> CustomScene:
        """Return the scene whose strip fits all values of its parameters, and times [s] of runs.

        Expressions are also checked at the places of particles with a spacing [m], and between.
        """
        other = self._copied("strip", "inflow_ramp", "_resistance")
        other.__dict__["_settings"] = settings
        other.__dict__["_until"] = until
        given = (*self.body_force, self.resistance)
        varied = bool(self.porous) or any(isinstance(value, str) for value in given)
        if varied and MOST_PLACES * particle_spacing**2 > math.prod(self.domain.lengths):
            fills = (self.domain.fill(part * particle_spacing) for part in (1.0, 0.5))
            other.__dict__["_extra"] = np.concatenate([*fills])
        return other

    @cached_property
    def _settings(self) -> Settings:
        """The values of the parameters at all points, where these are known."""
        return [{}]

    @cached_property
    def _until(self) -> float:
        """The end of runs [s], where it is known."""
        return 0.0

    @cached_property
    def _extra(self) -> Array:
        """The places of particles (n_places, 2) [m], where these are known."""
        return np.empty((0, 2))

    @cached_property
    def _periods(self) -> dict[tuple[float, ...], float]:
        """The shortest periods of the driving [s], by its final time and parameters."""
        return {}

    def _copied(self, *without: str) -> CustomScene:
        """Return a copy that does not share some cached parts."""
        other = self.model_copy()
        timed = "_force", "_pushes", "_motions", "_wall_amplitudes"
        for built in (*without, *timed, "_start", "_initial", "_known"):
            other.__dict__.pop(built, None)
        return other

    @cached_property
    def _known(self) -> Callable[[tuple[tuple[str, float], ...]], CustomScene]:
        """Returns the scene at values of the parameters, from a cache."""
        return lru_cache(MOST_KNOWN)(lambda values: self._changed(dict(values)))

    def _at(self, values: Mapping[str, float]) -> CustomScene:
        """Return the scene at values of its parameters, by default its own."""
        return self._known(tuple(values.items())) if values else self

    def _changed(self, values: Mapping[str, float]) -> CustomScene:
        # Build the parts that do not depend on parameters, so that copies share them.
        _ = self.domain, self._shapes, self._resistance
        other = self._copied()
        other._values = values
        return other

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return constants, rates of rotation, and factors of velocities and the body force."""
        rates = ((name, wall.rotation) for name, wall in self.walls.items())
        own = {name: rate if isinstance(rate, float) else 1.0 for name, rate in rates}
        return {**self.constants, **own, **dict.fromkeys(self._factor, 1.0)}

    @property
    def _factor(self) -> tuple[str, ...]:
        """The name of the factor of the driving, empty unless either force or inflow drives."""
        # It is a factor of the amplitude, which may be that of walls.
        return tuple(self._pushes) if len(self._pushes) == 1 and not self._wall_amplitudes else ()

    def parameter_problems(self, names: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield constants in which walls or the force aren't affine, and ambiguous names."""
        varied = [name for name in names if name in self.constants]
        slowed = self._expression("resistance", self.resistance, "x", "y")
        for name in (name for name in varied if slowed.degree_in([name]) > 0.0):
            yield name, "resistance depends on it, which no parameter changes"
        for where, timed in self._timed():
            for name in varied:
                if any(time.degree_in([name]) > 0.0 for _, time in timed.read()):
                    yield name, f"{where} reads a history at times that depend on it"
        for name in varied:
            if name in (*self.walls, BODY_FORCE, INFLOW):
                yield name, "is a constant's name and a wall's or the force's; rename the constant"
        for where, factor, expression in self._drives():
            used = [one for one in varied if expression.degree_in([one]) > 0.0]
            if expression.degree_in(varied) + (factor in names) <= 1.0:
                continue
            if used and factor in names:
                yield used[0], f"multiplies {factor}, which also varies, in {where}; vary only one"
            elif used:
                text = shortened(expression.text, MOST_QUOTED)
                yield (
                    used[0],
                    f"{where} must be a constant part plus multiples of {', '.join(used)}, because "
                    f"operators are projected once for all values; got '{text}'",
                )

    def driving(self, names: Collection[str]) -> tuple[str, ...]:
        drives = [expression for _, _, expression in self._drives()]
        return tuple(
            name
            for name in names
            if name in self.walls or any(each.degree_in([name]) > 0.0 for each in drives)
        )

    def _drives(self) -> Iterator[tuple[str, str, Expression]]:
        """Yield all driving expressions, with their key and the parameter that multiplies them."""
        for name, motion in self._motions.items():
            yield from ((motion.key, name, field) for field in motion.fields)
        for push in self._pushes.values():
            yield from ((push.key, "", field) for field in push.fields)

    def check_at(self, values: Mapping[str, float]) -> None:
        here = self._at(values)
        for name in here.walls:
            here._check_along(name)
        _ = here._force, here._initial, here._resistance
        here._check_surface()

    def largest_wall_speed(self, values: Mapping[str, float], until: float = 0.0) -> float:
        """Return the largest speed of walls and the inflow [m/s], at values of the parameters."""
        here = self._at(values)
        largest = here.largest_amplitude(until)
        velocities = [largest * here._wall_velocity(name)(here._edge(name)) for name in here.walls]
        if here.inflow is not None and (strip := here.strip) is not None:
            inside = here.inflow.samples(here.domain, strip.axis, N_SAMPLES + 1).T
            velocities.append(here._inflow_field(inside).T)
        return max((float(np.linalg.norm(each, axis=1).max()) for each in velocities), default=0.0)

    @property
    def resolved_length(self) -> float:
        return self.reference_length or self.domain.lengths[0]

    def _expression(self, where: str, value: float | str, *variables: str) -> Expression:
        text = value if isinstance(value, str) else repr(value)
        try:
            constants = {name: self._values.get(name, own) for name, own in self.constants.items()}
            expression = Expression(text, variables, constants, self.histories)
            # Except a force beside a surface, expressions in t are split into factors.
            apart = "t" in variables and not (self.has_surface and where == BODY_FORCE)
            parts = expression.separated("t") if apart else (expression,)
            _ = [part.compiled for part in parts]
            return expression
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error

    @cached_property
    def _samples(self) -> Array:
        """Sample points (n_points, 2) of the fluid all over the box [m]."""
        # Points on the edge of the box are included, where expressions like 1/x aren't finite.
        axes = [
            np.linspace(low, high, N_SAMPLES + 1)
            for low, high in zip(self.domain.lower, self.domain.upper, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        return points[self.domain.contains(points)]

    @property
    def _places(self) -> Array:
        """The samples, places of particles, and places beside jumps."""
        return np.concatenate([self._samples, self._jumps, self._extra])

    @cached_property
    def _jumps(self) -> Array:
        """Places (n_places, 2) [m] beside jumps of the resistance and the body force."""
        parts = [self._expression("resistance", self.resistance, "x", "y")]
        parts += [self._expression(BODY_FORCE, part, "x", "y", "t") for part in self.body_force]
        width, found = np.array(self.domain.lengths) / N_SAMPLES, [self._samples[:0]]
        beside = BESIDE * np.concatenate([np.diag(width), -np.diag(width)])
        for difference in (each for part in parts for each in part.compared()):
            if difference.depends_on and "t" not in difference.depends_on:

                def nearness(place: Array, compared: Expression = difference) -> Array:
                    return -np.abs(compared(x=place[0], y=place[1], t=0.0))

                order = np.argsort(-nearness(self._samples.T), kind="stable")
                _, edge = sharpened(nearness, self._samples[order[:N_NEAREST]].T, width)
                found.extend(edge.T + offset for offset in beside)
        places = np.clip(np.concatenate(found), self.domain.lower, self.domain.upper)
        return places[self.domain.contains(places)]

    def _peak(self, where: str, size: Callable[[Array], Array]) -> tuple[float, Array]:
        """Return the largest value of an expression in the fluid, and its place (2,) [m].

        Peaks narrower than the distance between samples are found from their feet.

        Raises ValueError if it is infinite or not a number.
        """

        low = np.array(self.domain.lower)[:, None]
        high = np.array(self.domain.upper)[:, None]

        def inside(place: Array) -> Array:
            within = np.clip(place, low, high)
            # Walls themselves are samples; beside them a place may be in the solid by rounding.
            fluid = self.domain.wall_distance(within.T) > TOUCHING * max(self.domain.lengths)
            return np.where(fluid, size(within), -np.inf)

        highest = self._places[np.argsort(-size(self._places.T), kind="stable")[:N_PEAKS]]
        found, place = sharpened(inside, highest.T, np.array(self.domain.lengths) / N_SAMPLES)
        best = int(np.argmax(found))
        place = np.clip(place, low, high)
        _require_finite(where, found[[best]], place[:, best][None])
        return float(found[best]), place[:, best]

    @cached_property
    def _start(self) -> dict[str, Expression]:
        """The expressions of u, v and p."""
        values = {name: getattr(self.initial, name) for name in ("u", "v", "p")}
        return {n: self._expression(f"initial.{n}", v, "x", "y") for n, v in values.items()}

    @cached_property
    def _initial(self) -> Callable[[Array], Array]:
        """A function for u, v [m/s] and p [Pa] (n_points, 3) at positions (n_points, 2) [m]."""
        if self.initial.file is not None:
            return partial(start_fields, self.initial.file, str(self.initial.sha256))

        def at(position: Array) -> Array:
            x, y = self._in_box(position.T)
            return np.stack([part(x=x, y=y) for part in self._start.values()], axis=1)

        for name, values in zip(self._start, at(self._samples).T, strict=True):
            _require_finite(f"initial.{name}", values, self._samples)
        return at

    def starts_by(self, name: str) -> bool:
        level = None if self.fluid is None else self.fluid.level
        starts = (*self._start.values(), self._expression("fluid.level", level or 0.0))
        return any(part.degree_in([name]) > 0.0 for part in starts)

    def _wall_velocity(self, name: str) -> Callable[[Array], Array]:
        """Return the velocity (n_points, 2) [m/s] of a wall at places on it (n_points, 2) [m]."""
        wall, motion, factor = self.walls[name], self._motions[name], self._values.get(name, 1.0)
        if wall.velocity is None:
            rate = factor * float(motion.fields[0]())
            if isinstance(wall.rotation, float):
                rate = self._values.get(name, wall.rotation)
            centre = shapely.get_coordinates(self._shapes[name].centroid)[0]
            return lambda at: rate * np.stack((centre[1] - at[:, 1], at[:, 0] - centre[0]), axis=1)
        return lambda at: factor * motion(self._in_box(at.T)).T

    @cached_property
    def _motions(self) -> dict[str, _Push]:
        """The velocities, or rates of rotation, of moving walls, by their names."""
        motions = {}
        for name, wall in self.walls.items():
            if wall.velocity is None:
                motion = self._push(f"walls.{name}.rotation", [wall.rotation or 0.0], "t")
            else:
                motion = self._push(f"walls.{name}.velocity", wall.velocity, "x", "y", "t")
            if len(motion.amplitudes) > 1:
                amplitudes = " and ".join(motion.amplitudes)
                reason = f"both components must have the same amplitude in time; got {amplitudes}"
                raise ValueError(f"{motion.key}: {reason}")
            motions[name] = motion
        return motions

    @cached_property
    def _wall_amplitudes(self) -> dict[str, Amplitude]:
        """The amplitudes of walls whose velocity changes with time, one for each expression."""
        known, found = dict[str, Amplitude](), {}
        for name, motion in self._motions.items():
            for text, amplitude in motion.amplitudes.items():
                if amplitude.depends_on:
                    at = lru_cache(N_TIMES)(lambda t, value=amplitude: float(value(t=t)))
                    found[name] = known.setdefault(text, at)
        return found

    @property
    def amplitudes(self) -> Mapping[str, str]:
        drives = [*self._motions.values(), *self._pushes.values()] if self._wall_amplitudes else []
        found = {drive.key: text for drive in drives for text in drive.amplitudes}
        return found | ({KEYS[INFLOW]: "its ramp"} if found and self.inflow is not None else {})

    def largest_amplitude(self, until: float) -> float:
        changing, times = self._wall_amplitudes, self._instants(until).tolist()
        largest = [1.0] if len(changing) < len(self.walls) else []  # of steady walls
        largest += [abs(amplitude(time)) for amplitude in changing.values() for time in times]
        return max(largest, default=1.0)

    def _timed(self) -> Iterator[tuple[str, Expression]]:
        """Yield the expressions that may read histories, with their keys."""
        for drive in (*self._motions.values(), *self._pushes.values()):
            yield from ((drive.key, amplitude) for amplitude in drive.amplitudes.values())
        if isinstance(self._force, SurfaceForce):
            yield from ((BODY_FORCE, part) for part in self._force.parts)

    def _instants(self, until: float) -> Array:
        """Return times of a run [s] at which its driving is checked, in rising order."""
        times = [np.linspace(0.0, until, N_INSTANTS)]
        for history in self.histories.values():
            rows = history.rows[:, (history.rows[0] >= 0.0) & (history.rows[0] <= until)]
            times += [rows[0, [np.argmin(rows[1]), np.argmax(rows[1])]]] if rows.size else []
        return np.unique(np.concatenate(times)) if self.histories else times[0]

    def _edge(self, name: str) -> Array:
        """Return points (n_points, 2) [m] of a wall that touch the fluid, except corners."""
        if name in self._shapes:
            edge = self._shapes[name].boundary
        else:
            axis = 0 if name in SIDES[0] else 1
            ends = np.array([self.domain.lower, self.domain.upper])
            ends[:, axis] = ends[SIDES[axis].index(name), axis]
            edge = shapely.linestrings(ends)
        pieces = [
            shapely.get_coordinates(shapely.segmentize(line, edge.length / N_SAMPLES))
            for line in shapely.get_parts(edge)
        ]
        place = np.concatenate([0.5 * (piece[1:] + piece[:-1]) for piece in pieces])
        touched = np.abs(self.domain.distance_and_normal(place)[0]) < TOUCHING * edge.length
        touched &= np.all((place >= self.domain.lower) & (place <= self.domain.upper), axis=1)
        if not touched.any():
            raise ValueError(f"walls.{name}: no fluid touches it")
        return place[touched]

    def _check_along(self, name: str) -> None:
        """Raise ValueError unless a wall's velocity is finite and along the wall."""
        if name not in self._shapes and self.walls[name].rotation is not None:
            raise ValueError(f"walls.{name}.rotation: a side of the box can't rotate")
        place = self._edge(name)
        velocity = self._wall_velocity(name)(place)
        _require_finite(f"walls.{name}.velocity", velocity, place)
        normal = self.domain.distance_and_normal(place)[1]
        across = np.abs(np.sum(velocity * normal, axis=1))
        worst = int(np.argmax(across))
        if across[worst] > ALONG * float(np.max(np.hypot(*velocity.T))):
            x, y = place[worst]
            raise ValueError(
                f"walls.{name}: its velocity at ({x:g}, {y:g}) m has a normal component of "
                f"{across[worst]:.3g} m/s; walls may only move along themselves"
            )

    def _in_box(self, position: Array) -> Array:
        """Return positions (2, n_positions) [m], wrapped into the box along periodic axes."""
        low, high = (np.array(end)[:, None] for end in (self.domain.lower, self.domain.upper))
        left = ((position < low) | (position > high)).any(axis=0)
        return np.where(left, self.domain.wrap(position.T).T, position) if left.any() else position

    @cached_property
    def _pushes(self) -> dict[str, _Push]:
        """The body force and the inflow, by the names of their factors as parameters."""
        if self.has_surface:
            return {}  # components may have different amplitudes
        pushes, inflow = {}, () if self.inflow is None else self.inflow.velocity
        for name, values in {BODY_FORCE: self.body_force, INFLOW: inflow}.items():
            if any(value != 0.0 for value in values):
                pushes[name] = self._push(KEYS[name], values, "x", "y", "t")
        return pushes

    def _push(self, where: str, values: Iterable[float | str], *variables: str) -> _Push:
        """Return the fields and amplitudes of expressions."""
        fields, moving = [], {}
        for value in values:
            whole = self._expression(where, value, *variables)
            field, amplitude = whole.separated("t")
            # A product that is split rounds differently, and walls may not do so.
            fields.append(field if where in KEYS.values() or whole.depends_on & {"t"} else whole)
            if value != 0.0:  # zero components fit any amplitude
                moving[amplitude.text] = amplitude
        return _Push(where, fields, moving)

    @cached_property
    def _force(self) -> BodyForce | None:
        """The body force: a field times an amplitude, with a factor that may be a parameter."""
        if self.fluid is not None:
            parts = [self._expression(BODY_FORCE, v, "x", "y", "t") for v in self.body_force]
            return SurfaceForce.of(tuple(parts), self.fluid.gravity)
        pushes, strip = self._pushes, self.strip
        moving = {text: a for push in pushes.values() for text, a in push.amplitudes.items()}
        if not moving:
            return None
        if len(moving) > 1:
            keys, amplitudes = " and ".join(KEYS[name] for name in pushes), " and ".join(moving)
            raise ValueError(
                f"{keys}: both components must have the same amplitude in time; got {amplitudes}"
            )
        (amplitude,) = moving.values()

        def field(position: Array) -> Array:
            place = self._in_box(position)
            fields = [
                push(place) if strip is None or name != INFLOW else strip.forcing(place, push)
                for name, push in pushes.items()
            ]
            return np.sum(fields, axis=0) if len(fields) > 1 else fields[0]

        for name, push in pushes.items():
            places = self._places
            if strip is not None and self.inflow is not None and name == INFLOW:
                places = self.inflow.samples(self.domain, strip.axis, N_SAMPLES + 1)
            _require_finite(KEYS[name], push(places.T).T, places)
        if BODY_FORCE in pushes and not self._values:  # for all values the same peaks
            self._peak("body_force", lambda at: np.abs(pushes[BODY_FORCE](at)).sum(axis=0))
        factor = next((self._values.get(name, 1.0) for name in self._factor), 1.0)
        share = partial(ramp_share, self.inflow_ramp)
        # Cached, because all runs of a case use the same times.
        at = lru_cache(N_TIMES)(lambda t: factor * float(share(t)) * float(amplitude(t=t)))

        def series(times: Array) -> Array:
            return factor * (share(times) * amplitude(t=times))

        return BodyForce(field, at, series, changes=bool(amplitude.depends_on))

    def _inflow_field(self, position: Array) -> Array:
        """Return the inflow (2, n_positions) [m/s] when it is fastest, before its ramp."""
        push = self._pushes[INFLOW]
        largest = self._values.get(INFLOW, 1.0)
        if self._until > 0.0:
            times = np.linspace(0.0, self._until, N_CHECKED)
            sizes = [np.abs(amplitude(t=times)) for amplitude in push.amplitudes.values()]
            # Amplitudes that are not finite are refused later, with their times.
            largest *= max(float(size.max(initial=0.0, where=size <= LARGEST)) for size in sizes)
        return largest * push(position)

    @cached_property
    def strip(self) -> Strip | None:
        """The strip of the inflow, the same at all values of the parameters."""
        if self.inflow is None:
            return None
        if INFLOW not in self._pushes:
            raise ValueError("inflow.velocity: is zero; leave inflow out")
        velocities = []
        for values in self._settings:
            other = self._copied()
            other._values = values
            velocities.append(other._inflow_field)
        strip = self.inflow.strip_in(self.domain, N_SAMPLES + 1, velocities)
        if not connects_images(self.domain.fluid_with_images, self.domain.lengths, strip.axis):
            along = "xy"[strip.axis]
            raise ValueError(
                f"inflow: solids block the flow along {along}, so fluid that leaves the strip at "
                f"{along} = {strip.end if strip.speed > 0.0 else strip.start:g} m can't come back "
                "to it; leave a gap, or make the solid a porous body"
            )
        return strip

    @cached_property
    def inflow_ramp(self) -> float:
        """The time in which the inflow reaches its speed [s]; 0 without an inflow."""
        if self.inflow is None or (strip := self.strip) is None:
            return 0.0
        from_rest = self.initial == InitialSection()
        usual = self.domain.lengths[strip.axis] / abs(strip.speed) if from_rest else 0.0
        return usual if self.inflow.ramp is None else self.inflow.ramp

    @property
    def ramp(self) -> float:
        return self.inflow_ramp

    @cached_property
    def _resistance(self) -> Resistance | None:
        """The resistance to the flow, which does not depend on parameters."""
        own, shapes = None, _geometries("porous", self.porous)
        solid = shapely.union_all(list(self._shapes.values()))
        fluid = shapely.box(*self.box.lower, *self.box.upper).difference(solid)
        for name, shape in shapes.items():
            if not fluid.intersection(shape).area > 0.0:
                raise ValueError(
                    f"porous.{name}: contains no fluid; it is in solids or out of the box"
                )
        if self.resistance != 0.0:
            expression = self._expression("resistance", self.resistance, "x", "y")
            rate = expression(x=self._places[:, 0], y=self._places[:, 1])
            _require_finite("resistance", rate, self._places)

            def own(at: Array) -> Array:
                return expression(x=at[0], y=at[1])

            self._peak("resistance", own)
            least, (x, y) = self._peak("resistance", lambda at: -own(at))
            if rate.min() < 0.0:
                x, y = self._places[np.argmin(rate)]
            if min(rate.min(), -least) < 0.0:
                raise ValueError(f"resistance: is negative at ({x:g}, {y:g}) m")

        inverse = inverse_permeability((self.porous[name], shape) for name, shape in shapes.items())
        if own is None and inverse is None and self.strip is None:
            return None
        return Resistance(own, inverse, self.strip, self._in_box)

    def largest_resistance(self, viscosity: float) -> float:
        resistance = self._resistance
        if resistance is None:
            return 0.0
        return resistance.largest(self._slowest.T, viscosity)

    @cached_property
    def _slowest(self) -> Array:
        """Places (n_places, 2) [m] that include those with the largest resistance."""
        places = [self._places]
        if self._resistance is not None and self._resistance.own is not None:
            places.append(self._peak("resistance", self._resistance.own)[1][None])
        # Samples miss thin bodies.
        parts = list(self._porous_parts.values())
        shared = (one.intersection(other) for one, other in combinations(parts, 2))
        inside = [part.representative_point() for part in (*parts, *shared) if part.area > 0.0]
        return np.concatenate([*places, shapely.get_coordinates(inside)])

    @cached_property
    def _porous_parts(self) -> dict[str, BaseGeometry]:
        """The parts of porous bodies in the fluid, by name."""
        shapes = _geometries("porous", self.porous)
        return {name: self.domain.fluid.intersection(shape) for name, shape in shapes.items()}

    @cached_property
    def porous_way(self) -> float:
        """The least integral of 1/k along lines through the box [1/m], the larger of x and y."""
        shapes = self._porous_parts
        ways = [0.0]
        lower, upper = np.array(self.domain.lower), np.array(self.domain.upper)
        for axis in range(2) if shapes else ():
            ends = np.tile(np.array([lower, upper]), (N_SAMPLES, 1, 1))
            ends[..., 1 - axis] = midpoints(lower[1 - axis], upper[1 - axis], N_SAMPLES)[:, None]
            lines = shapely.intersection(self.domain.fluid, shapely.linestrings(ends))
            lines = lines[shapely.length(lines) > 0.0]
            parts = (
                shapely.length(shapely.intersection(shape, lines)) / self.porous[name].permeability
                for name, shape in shapes.items()
            )
            ways.append(float(sum(parts).min(initial=math.inf)))
        return max(ways)

    @property
    def porous_widths(self) -> dict[str, float]:
        """The width [m] of each porous body, the diameter of the largest circle in it."""
        parts = self._porous_parts.items()
        circles = {name: shapely.maximum_inscribed_circle(part) for name, part in parts}
        return {name: 2.0 * float(circle.length) for name, circle in circles.items()}

    def largest_head(self, final_time: float, values: Mapping[str, float] = NONE) -> float:
        here = self._at(values)
        times = self._instants(final_time)
        if here.has_surface and here._force is not None:
            heights = self.domain.lengths[0], min(self.level_at(values), self.domain.upper[1])
            reach = np.array(heights) - (0.0, self.domain.lower[1])
            pulls = [here._pull(here._force(self._samples.T, t)) for t in times]
            largest = float(np.max(pulls @ reach))
            return largest if math.isfinite(largest) else 0.0
        drive, push = here._force, here._pushes.get(BODY_FORCE)
        if drive is None or push is None:  # the forcing of an inflow only makes up its deficit
            return 0.0
        field = push(self._samples.T)
        if self.domain.fills_box:
            rows = field.reshape(2, N_SAMPLES + 1, -1)
            for axis in np.flatnonzero(self.domain.periodic):  # a mean adds no pressure there
                rows[axis] -= rows[axis].mean(axis=1 - axis, keepdims=True)
        largest = float(np.dot(self.domain.lengths, np.abs(field).max(axis=1, initial=0.0)))
        largest *= float(np.abs([drive.amplitude(t) for t in times]).max())
        return largest if math.isfinite(largest) else 0.0  # `problems` refuses other values

    def _pull(self, force: Array) -> Array:
        """Return the largest magnitudes (2,) of a force's components (2, n_samples) [m/s2]."""
        if math.isfinite(self.level_at()) or not self.domain.fills_box:
            return np.asarray(np.abs(force).max(axis=1))
        # One-way means along lines: forces to a centre press from both sides.
        ways = np.maximum((force, -force), 0.0).reshape(2, 2, N_SAMPLES + 1, -1)
        return np.array([ways[:, axis].mean(axis=-1 - axis).max() for axis in range(2)])

    def unknown_times(self, final_time: float) -> Iterator[tuple[str, str]]:
        times = np.linspace(0.0, final_time, N_TIMES)
        for where, expression in self._timed():
            for name, time in expression.read():
                if (problem := self.histories[name].lacks(time(t=times))) is not None:
                    yield where, f"{name}: {problem}"
                    return

    def problems(self, final_time: float, fluid: Fluid) -> Iterator[tuple[str, str]]:
        """Refuse a driving that isn't finite at all times, and an inflow that ramps too long.

        Also speeds near that of sound, and an initial velocity through a wall.
        """
        sound_speed = fluid.sound_speed
        if self.inflow_ramp >= final_time:
            yield "inflow.ramp", f"takes {self.inflow_ramp:g} s, until time.final_time or longer"
        times = np.linspace(0.0, final_time, N_CHECKED)
        step = math.ceil(len(self._settings) / MOST_SETTINGS)
        for here in map(self._at, self._settings[::step]):
            for where, signal in here._signals().items():
                if (pole := pole_of(signal, times)) is not None:
                    yield where, f"is not finite at t = {pole:.4g} s"
                    return
            for where, speed in here._speeds(times):
                if speed > FASTEST * sound_speed:
                    yield (
                        where,
                        f"reaches {speed:.4g} m/s, {speed / sound_speed:.2g} times the speed of "
                        f"sound; set fluid.reference_speed: {speed:.3g}, or lower it",
                    )
                    return
            speed, wall = here._through_wall()
            pressure = np.abs(here._initial(here._samples)[:, 2]).max()
            if pressure > LARGEST_CHANGE * fluid.reference_density * fluid.sound_speed**2:
                yield "initial.p", f"{pressure:.3g} Pa changes the density by more than 10 %"
                return
            if speed > THROUGH_WALL * sound_speed:
                yield (
                    "initial",
                    f"goes through the wall {wall} with {speed:.3g} m/s, which makes a shock of "
                    "sound; start at rest, or with a velocity along the walls, or lower "
                    "fluid.mach_number",
                )
                return

    def _signals(self) -> dict[str, Callable[[Array], Array]]:
        """Return what drives the flow (..., n_times) at times (n_times,) [s], by key."""
        force, signals = self._force, dict[str, Callable[[Array], Array]]()
        for name, motion in self._motions.items():
            for amplitude in motion.amplitudes.values():
                if amplitude.depends_on:
                    signals[f"walls.{name}"] = partial(_at_times, amplitude)
        if not isinstance(force, SurfaceForce):
            if force is not None and force.series is not None and force.changes:
                signals[KEYS[next(iter(self._pushes))]] = force.series
            return signals
        moving = [part for part in force.parts if "t" in part.depends_on]
        x, y = self._samples[:: len(self._samples) // N_PEAKS + 1].T[..., None]
        if not any(part.depends_on & {"x", "y"} for part in moving):
            x, y = x[:1], y[:1]
        signal = lambda t: np.concatenate([part(x=x, y=y, t=t) for part in moving])  # noqa: E731
        return signals | ({BODY_FORCE: signal} if moving else {})

    def shortest_period(self, final_time: float, settings: Settings) -> float:
        """Return the shortest period [s] with which the driving oscillates at some values."""
        force = self._force
        drives = (*self._motions.values(), *self._pushes.values())
        timed = [amplitude for drive in drives for amplitude in drive.amplitudes.values()]
        timed += force.parts if isinstance(force, SurfaceForce) else ()
        used = [n for n in self.constants if any(each.degree_in([n]) > 0.0 for each in timed)]
        chosen = {tuple(v.get(n, self.constants[n]) for n in used): v for v in settings}
        shortest = math.inf
        for values in sorted(chosen)[:: math.ceil(len(chosen) / MOST_SETTINGS)]:
            if (known := (final_time, *values)) not in self._periods:
                signals = self._at(chosen[values])._signals().values()
                periods = (shortest_period(signal, final_time) for signal in signals)
                self._periods[known] = min(periods, default=math.inf)
            shortest = min(shortest, self._periods[known])
        return shortest

    def _speeds(self, times: Array) -> Iterator[tuple[str, float]]:
        """Yield the largest given speeds [m/s] at times [s], with their keys."""
        speeds = {}
        for name in self.walls:
            amplitude = self._wall_amplitudes.get(name, lambda time: 1.0)
            largest = max(abs(amplitude(time)) for time in times[::N_EACH].tolist())
            speeds[f"walls.{name}"] = largest * self._wall_velocity(name)(self._edge(name))
        strip, force = self.strip, self._force
        if strip is not None and self.inflow is not None and force is not None:
            places = self.inflow.samples(self.domain, strip.axis, N_SAMPLES + 1)
            largest = max(abs(force.amplitude(time)) for time in times[::N_EACH])
            speeds[KEYS[INFLOW]] = largest * self._pushes[INFLOW](places.T).T
        wet = self._samples[self._samples[:, 1] <= self.level_at(self._values)]
        speeds["initial"] = self._initial(wet)[:, :2]
        for where, velocity in speeds.items():
            yield where, float(np.linalg.norm(velocity, axis=1).max(initial=0.0))

    def _through_wall(self) -> tuple[float, str]:
        """Return the largest initial speed [m/s] normal to a wall, and its place in words."""
        largest, where = 0.0, ""
        at_rest = self.initial == InitialSection()
        for name in () if at_rest or self.fluid is not None else self.domain.wall_names:
            with suppress(ValueError):  # no fluid touches this wall
                place = self._edge(name)
                normal = self.domain.distance_and_normal(place)[1]
                across = np.abs(np.sum(self._initial(place)[:, :2] * normal, axis=1))
                x, y = place[np.argmax(across)]
                if across.max() > largest:
                    largest, where = float(across.max()), f"{name} at ({x:.4g}, {y:.4g}) m"
        return largest, where


@dataclass(frozen=True)
class _Push:
    """A force, an inflow or a moving wall: a field, with its amplitudes in time by their texts."""

    key: str
    """Its key in the scene."""
    fields: list[Expression]
    amplitudes: dict[str, Expression]

    def __call__(self, position: Array) -> Array:
        """Return the field (2, n_positions) at positions (2, n_positions) [m]."""
        return np.stack([field(x=position[0], y=position[1]) for field in self.fields])


def _at_times(amplitude: Expression, times: Array) -> Array:
    return amplitude(t=times)


def _geometries(where: str, sections: Mapping[str, ShapeSection]) -> dict[str, BaseGeometry]:
    """Return the shapes of sections by name. Raises ValueError with the name of the section."""
    shapes = {}
    for name, section in sections.items():
        try:
            shapes[name] = section.geometry()
        except ValueError as error:
            raise ValueError(f"{where}.{name}: {error}") from error
    return shapes


def _require_finite(where: str, values: Array, position: Array) -> None:
    """Raise ValueError if values (n_points, ...) at positions aren't finite, or too large."""
    finite = np.abs(values) <= LARGEST
    bad = np.flatnonzero(~finite.all(axis=tuple(range(1, finite.ndim))))
    if bad.size:
        x, y = position[bad[0]]
        what = (
            f"above {LARGEST:g} in size"
            if np.isfinite(values[bad[0]]).all()
            else "not a finite number"
        )
        raise ValueError(f"{where}: is {what} at ({x:g}, {y:g}) m")
