"""The scene of kind custom: a box with solids of any shape, moving walls and a body force.

Walls' velocities and the force must be affine in the parameters, because operators are projected
once: each parameter that drives the flow has its own operators, which its value multiplies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import shapely
from pydantic import PrivateAttr, ValidationInfo, model_validator
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.custom_sections import (
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
)
from sphrom.case.expressions import CONSTANTS, FUNCTIONS, MOST_QUOTED, Expression
from sphrom.case.fields import Coordinate, Place, Positive, SafeName, Section, key
from sphrom.case.scene_section import MEASURE, OF_WALLS, Defaults, Measures, SceneSection
from sphrom.case.shapes import ShapeSection
from sphrom.scenes.flows import BodyForce, CustomFlow, Scales, Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import SIDES, Domain
from sphrom.sph.fluid import NONE, Resistance, Strip
from sphrom.text import shortened

N_SAMPLES = 200
"""Points along each edge of the box, or along a wall, at which expressions are checked."""
N_INSTANTS = 50
"""Times of a run at which a body force is checked."""
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
"""Most times with a cached amplitude of the body force."""


class BoxSection(Section):
    """The box that contains the flow."""

    lower: Place = key((0.0, 0.0), "lower left corner", unit="m")
    upper: Place = key((1.0, 1.0), "upper right corner", unit="m")
    periodic: tuple[Literal["x", "y"], ...] = key((), "periodic axes")


class MovingWallSection(Section):
    """The motion of a wall along itself."""

    velocity: Vector | None = key(None, "velocity, numbers or expressions in x, y", unit="m/s")
    rotation: Coordinate | None = key(
        None, "rate of rotation about its centroid, anticlockwise", unit="rad/s"
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
        name = values.get("file") if isinstance(values, dict) else None
        folder = (info.context or {}).get("folder")
        # The case in an artifact is read without its files, and does not start runs.
        if not isinstance(name, str) or (folder is None and values.get("sha256") is not None):
            return values
        digest = read_start(Path(folder or "") / name)
        if values.get("sha256") not in (None, digest):
            raise ValueError(f"{name} has changed since its sha256 was taken")
        return {**values, "sha256": digest}

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
        for name in self.constants:
            if name in ("x", "y", "t", *CONSTANTS, *FUNCTIONS):
                raise ValueError(f"constants.{name}: the name is reserved; choose another")
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
            _require_finite("body_force", force(self._samples.T, 0.0).T, self._samples)

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
        if (strip := self._strip) is None:
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
        )

    def _begin(self, density: float) -> Callable[[Array], Array]:
        """Return the initial fields of runs, for a density of the fluid [kg/m3]."""
        level = self.level_at(self._values)
        if self.fluid is None or math.isinf(level):
            return lambda at: self._initial(at)
        weight = density * self.fluid.gravity
        return hydrostatic(lambda at: self._initial(at), level, weight)

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
        other = self.model_copy()
        other._values = values
        for built in ("_force", "_pushes", "_start", "_initial", "_known"):
            other.__dict__.pop(built, None)
        return other

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return constants, rates of rotation, and factors of velocities and the body force."""
        own = {name: 1.0 if w.rotation is None else w.rotation for name, w in self.walls.items()}
        return {**self.constants, **own, **dict.fromkeys(self._factor, 1.0)}

    @property
    def _factor(self) -> tuple[str, ...]:
        """The name of the factor of the driving, empty unless either force or inflow drives."""
        return tuple(self._pushes) if len(self._pushes) == 1 else ()

    def parameter_problems(self, names: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield constants in which walls or the force aren't affine, and ambiguous names."""
        varied = [name for name in names if name in self.constants]
        slowed = self._expression("resistance", self.resistance, "x", "y")
        for name in (name for name in varied if slowed.degree_in([name]) > 0.0):
            yield name, "resistance depends on it, which no parameter changes"
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
        for name, wall in self.walls.items():
            for value in wall.velocity or ():
                where = f"walls.{name}.velocity"
                yield where, name, self._expression(where, value, "x", "y")
        for name, push in self._pushes.items():
            yield from ((KEYS[name], "", field) for field in push.fields)

    def check_at(self, values: Mapping[str, float]) -> None:
        here = self._at(values)
        for name in here.walls:
            here._check_along(name)
        _ = here._force, here._initial, here._resistance
        here._check_surface()

    def largest_wall_speed(self, values: Mapping[str, float]) -> float:
        """Return the largest speed of walls and the inflow [m/s], at values of the parameters."""
        here = self._at(values)
        velocities = [here._wall_velocity(name)(here._edge(name)) for name in here.walls]
        if here.inflow is not None and (strip := here._strip) is not None:
            inside = here._samples[strip.contains(here._samples.T)].T
            velocities.append(here._values.get(INFLOW, 1.0) * here._pushes[INFLOW](inside).T)
        return max((float(np.linalg.norm(each, axis=1).max()) for each in velocities), default=0.0)

    @property
    def resolved_length(self) -> float:
        return self.reference_length or self.domain.lengths[0]

    def _expression(self, where: str, value: float | str, *variables: str) -> Expression:
        text = value if isinstance(value, str) else repr(value)
        try:
            constants = {name: self._values.get(name, own) for name, own in self.constants.items()}
            expression = Expression(text, variables, constants)
            # Without a surface, expressions in t are split into factors of space and time.
            apart = "t" in variables and not self.has_surface
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
        wall = self.walls[name]
        if wall.velocity is None:
            rate = self._values.get(name, wall.rotation or 0.0)
            centre = shapely.get_coordinates(self._shapes[name].centroid)[0]
            return lambda at: rate * np.stack((centre[1] - at[:, 1], at[:, 0] - centre[0]), axis=1)
        where = f"walls.{name}.velocity"
        parts = [self._expression(where, value, "x", "y") for value in wall.velocity]
        factor = self._values.get(name, 1.0)

        def velocity(place: Array) -> Array:
            x, y = self._in_box(place.T)
            return factor * np.stack([part(x=x, y=y) for part in parts], axis=1)

        return velocity

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
        if across[worst] > ALONG * float(np.max(np.linalg.norm(velocity, axis=1))):
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
                wholes = [self._expression(KEYS[name], value, "x", "y", "t") for value in values]
                parts = [whole.separated("t") for whole in wholes]
                # Zero components fit any amplitude.
                moving = {a.text: a for v, (_, a) in zip(values, parts, strict=True) if v != 0.0}
                pushes[name] = _Push([field for field, _ in parts], moving)
        return pushes

    @cached_property
    def _force(self) -> BodyForce | None:
        """The body force: a field times an amplitude, with a factor that may be a parameter."""
        if self.fluid is not None:
            parts = [self._expression(BODY_FORCE, v, "x", "y", "t") for v in self.body_force]
            return SurfaceForce.of(tuple(parts), self.fluid.gravity)
        pushes, strip = self._pushes, self._strip
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
            _require_finite(KEYS[name], push(self._samples.T).T, self._samples)
        factor = next((self._values.get(name, 1.0) for name in self._factor), 1.0)
        share = partial(ramp_share, self.inflow_ramp)
        # Cached, because all runs of a case use the same times.
        at = lru_cache(N_TIMES)(lambda t: factor * float(share(t)) * float(amplitude(t=t)))

        def series(times: Array) -> Array:
            return factor * (share(times) * amplitude(t=times))

        return BodyForce(field, at, series, changes=bool(amplitude.depends_on))

    @cached_property
    def _strip(self) -> Strip | None:
        """The strip of the inflow, which does not depend on parameters."""
        if self.inflow is None:
            return None
        if INFLOW not in self._pushes:
            raise ValueError("inflow.velocity: is zero; leave inflow out")
        return self.inflow.strip_in(self.domain, self._samples, self._pushes[INFLOW])

    @cached_property
    def inflow_ramp(self) -> float:
        """The time in which the inflow reaches its speed [s]; 0 without an inflow."""
        if self.inflow is None or (strip := self._strip) is None:
            return 0.0
        from_rest = self.initial == InitialSection()
        usual = self.domain.lengths[strip.axis] / abs(strip.speed) if from_rest else 0.0
        return usual if self.inflow.ramp is None else self.inflow.ramp

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
            rate = expression(x=self._samples[:, 0], y=self._samples[:, 1])
            _require_finite("resistance", rate, self._samples)
            if rate.min() < 0.0:
                x, y = self._samples[np.argmin(rate)]
                raise ValueError(f"resistance: is negative at ({x:g}, {y:g}) m")

            def own(at: Array) -> Array:
                return expression(x=at[0], y=at[1])

        inverse = inverse_permeability((self.porous[name], shape) for name, shape in shapes.items())
        if own is None and inverse is None and self._strip is None:
            return None
        return Resistance(own, inverse, self._strip, self._in_box)

    def largest_resistance(self, viscosity: float) -> float:
        resistance = self._resistance
        return 0.0 if resistance is None else resistance.largest(self._samples.T, viscosity)

    @property
    def porous_way(self) -> float:
        """The least integral of 1/k along lines through the box [1/m], the larger of x and y."""
        if self._resistance is None or (inverse := self._resistance.inverse_permeability) is None:
            return 0.0
        inverses, ways = inverse(self._samples.T), []
        for across, length in zip(self._samples.T[::-1], self.domain.lengths, strict=True):
            line = np.unique(across, return_inverse=True)[1]
            ways.append(length * float((np.bincount(line, inverses) / np.bincount(line)).min()))
        return max(ways)

    def largest_head(self, final_time: float, values: Mapping[str, float] = NONE) -> float:
        here = self._at(values)
        times = np.linspace(0.0, final_time, N_INSTANTS)
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

    def problems(self, final_time: float) -> Iterator[tuple[str, str]]:
        """Refuse a driving that isn't finite at all times, and an inflow that ramps too long."""
        if self.inflow_ramp >= final_time:
            yield "inflow.ramp", f"takes {self.inflow_ramp:g} s, until time.final_time or longer"
        if self._force is not None:
            for time in np.linspace(0.0, final_time, N_INSTANTS):
                amplitude = self._force.amplitude(time)
                if self.has_surface:
                    amplitude = float(self._force(self._samples.T, time).sum())
                if not math.isfinite(amplitude):
                    yield (
                        KEYS[next(iter(self._pushes), BODY_FORCE)],
                        f"is not finite at t = {time:.4g} s",
                    )
                    return


@dataclass(frozen=True)
class _Push:
    """A body force or inflow: a field, with its amplitudes in time by their texts."""

    fields: list[Expression]
    amplitudes: dict[str, Expression]

    def __call__(self, position: Array) -> Array:
        """Return the field (2, n_positions) at positions (2, n_positions) [m]."""
        return np.stack([field(x=position[0], y=position[1]) for field in self.fields])


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
    """Raise ValueError if values (n_points, ...) at positions aren't finite."""
    finite = np.isfinite(values)
    bad = np.flatnonzero(~finite.all(axis=tuple(range(1, finite.ndim))))
    if bad.size:
        x, y = position[bad[0]]
        raise ValueError(f"{where}: is not a finite number at ({x:g}, {y:g}) m")
