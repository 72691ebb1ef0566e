"""The driving of a scene of kind custom at values of its parameters, and its initial fields.

Walls, the body force and the inflow drive the fluid: each is a field times an amplitude in time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.custom_sections import SurfaceForce, ramp_share
from sphrom.case.fields import LARGEST
from sphrom.metrics.series import shortest_period
from sphrom.scenes.expressions import Expression, Function
from sphrom.scenes.flows import Amplitude, BodyForce
from sphrom.scenes.histories import History
from sphrom.sph.places import SAMPLES, Places
from sphrom.text import place_text

if TYPE_CHECKING:
    from sphrom.case.custom_scene import CustomScene

N_INSTANTS, N_CHECKED = 50, 4097
"""Numbers of times of a run at which a head is computed, which is slow, and an amplitude."""
N_PLACES = 16
"""Number of places at which a force is searched for oscillations."""
MOST_TIMES = 4096
"""Largest number of times with a cached amplitude."""
BODY_FORCE, INFLOW = "body_force", "inflow"
"""The names of their factors as parameters."""
KEYS = {BODY_FORCE: "body_force", INFLOW: "inflow.velocity"}
"""The keys of the parameters."""


@dataclass(frozen=True)
class Drive:
    """A force, an inflow or a moving wall: a field, with its amplitudes in time by their texts."""

    key: str
    """Its key in the scene."""
    fields: list[Expression]
    amplitudes: dict[str, Expression]
    """The only amplitude, or none if all values are zero."""

    def __call__(self, position: Array) -> Array:
        """Return the field (n_dim, n_positions) at positions (n_dim, n_positions) [m]."""
        return np.stack([at_places(field, position) for field in self.fields])

    def largest(self, times: Array) -> float:
        """Return the largest size of the amplitude at times (n_times,) [s].

        Times with an infinite amplitude don't count; they are refused with their own message.
        """
        sizes = [np.abs(amplitude(t=times)) for amplitude in self.amplitudes.values()]
        return float(np.max(sizes, initial=0.0, where=np.isfinite(sizes))) if sizes else 1.0


class Driving:
    """The driving of a scene and its initial fields, at values of the parameters."""

    def __init__(self, scene: CustomScene, values: Mapping[str, float]) -> None:
        self.scene, self.values = scene, values

    @cached_property
    def constants(self) -> dict[str, float]:
        """The values of the scene's constants."""
        usual = self.scene.constants
        return {name: self.values.get(name, value) for name, value in usual.items()}

    @cached_property
    def histories(self) -> dict[str, History]:
        """The histories by name. Raises ValueError, with the key."""
        found = {}
        for name, section in self.scene.histories.items():
            try:
                found[name] = section.at(self.constants)
            except ValueError as error:
                raise ValueError(f"histories.{name}.values: {error}") from error
        return found

    def expression(self, key: str, value: float | str, *variables: str) -> Expression:
        """Return the expression of a key. Raises ValueError, with the key."""
        text = value if isinstance(value, str) else repr(value)
        called: dict[str, History | Function] = {**self.histories, **self.scene.called}
        try:
            expression = Expression(text, variables, self.constants, called)
            # Except a force beside a surface, expressions in t are split into factors.
            split = "t" in variables and not (self.scene.has_surface and key == BODY_FORCE)
            for part in expression.separated("t") if split else (expression,):
                _ = part.compiled
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from error
        return expression

    # The initial state

    @cached_property
    def level(self) -> float:
        """The height of a level surface at rest [m]; infinite without one."""
        fluid = self.scene.fluid
        if fluid is None or fluid.level is None:
            return math.inf
        return float(self.expression("fluid.level", fluid.level)())

    @cached_property
    def start(self) -> dict[str, Expression]:
        """The expressions of u, v, w (in three dimensions) and p."""
        names = (*("u", "v", "w")[: len(self.scene.axes)], "p")
        values = {name: getattr(self.scene.initial, name) for name in names}
        axes = self.scene.axes
        return {n: self.expression(f"initial.{n}", v, *axes) for n, v in values.items()}

    @cached_property
    def initial(self) -> Callable[[Array], Array]:
        """A function for velocity [m/s] and pressure [Pa] (n_points, n_dim + 1) at positions."""
        section = self.scene.initial
        places = self.scene.places
        if section.file is not None:
            return lambda position: section.table(position)

        def at(position: Array) -> Array:
            place = places.wrapped(position.T)
            return np.stack([at_places(part, place) for part in self.start.values()], axis=1)

        for name, values in zip(self.start, at(places.samples).T, strict=True):
            require_finite(f"initial.{name}", values, places.samples)
        return at

    def begin(self, density: float) -> Callable[[Array], Array]:
        """Return the initial fields of runs, hydrostatic below a level, for a density [kg/m3]."""

        # They are evaluated when a run starts; they may be any function of constants.
        def at(position: Array) -> Array:
            fields = self.initial(position)
            if math.isfinite(self.level):
                fields[:, 2] += density * self.scene.gravity * (self.level - position[:, 1])
            return fields

        return at

    # Fields and amplitudes

    def _drive(self, key: str, values: Iterable[float | str], *variables: str) -> Drive:
        """Return the field and the amplitude of the components of a vector, or of a rate."""
        fields, moving = [], {}
        for value in values:
            product = self.expression(key, value, *variables)
            field, amplitude = product.separated("t")
            # A product that is split rounds differently, and walls may not do so.
            split = key in KEYS.values() or product.depends_on & {"t"}
            fields.append(field if split else product)
            if value != 0.0:  # zero components fit any amplitude
                moving[amplitude.text] = amplitude
        return Drive(key, fields, moving)

    @cached_property
    def walls(self) -> dict[str, Drive]:
        """The velocities, or rates of rotation, of moving walls, by their names."""
        walls = {}
        axes = self.scene.axes
        for name, wall in self.scene.walls.items():
            if wall.velocity is None:
                drive = self._drive(f"walls.{name}.rotation", [wall.rotation or 0.0], "t")
            else:
                drive = self._drive(f"walls.{name}.velocity", wall.velocity, *axes, "t")
            _require_one(drive.key, drive.amplitudes)
            walls[name] = drive
        return walls

    @cached_property
    def pushes(self) -> dict[str, Drive]:
        """The body force and the inflow, by the names of their factors as parameters."""
        if self.scene.has_surface:
            return {}  # components may have different amplitudes
        inflow = self.scene.inflow
        given = {BODY_FORCE: self.scene.acceleration, INFLOW: inflow.velocity if inflow else ()}
        return {
            name: self._drive(KEYS[name], values, *self.scene.axes, "t")
            for name, values in given.items()
            if any(value != 0.0 for value in values)
        }

    @property
    def drives(self) -> tuple[Drive, ...]:
        """All fields with an amplitude."""
        return (*self.walls.values(), *self.pushes.values())

    @cached_property
    def wall_amplitudes(self) -> dict[str, Amplitude]:
        """The amplitudes of walls whose velocity changes with time."""
        return {
            name: _remembered(partial(_at_times, amplitude))
            for name, drive in self.walls.items()
            for amplitude in drive.amplitudes.values()
            if amplitude.depends_on
        }

    @property
    def amplitudes(self) -> dict[str, str]:
        """The texts of amplitudes by key; empty unless walls change."""
        drives = self.drives if self.wall_amplitudes else ()
        found = {drive.key: text for drive in drives for text in drive.amplitudes}
        return found | ({KEYS[INFLOW]: "its ramp"} if found and INFLOW in self.pushes else {})

    @property
    def factors(self) -> tuple[str, ...]:
        """The name of the factor of the driving, empty unless either force or inflow drives."""
        # It is a factor of the amplitude, which may be that of walls.
        return tuple(self.pushes) if len(self.pushes) == 1 and not self.wall_amplitudes else ()

    def wall_velocity(self, name: str) -> Callable[[Array], Array]:
        """Return the velocity (n_points, 2) [m/s] of a wall at places on it (n_points, 2) [m]."""
        wall = self.scene.walls[name]
        drive = self.walls[name]
        factor = self.values.get(name, 1.0)
        if wall.velocity is not None:
            return lambda at: factor * drive(self.scene.places.wrapped(at.T)).T
        rate = factor * float(drive.fields[0]())
        if isinstance(wall.rotation, float):
            rate = self.values.get(name, wall.rotation)
        return lambda at: rate * self.scene.domain.arms(name, at)[:, ::-1] * (-1.0, 1.0)

    @cached_property
    def force(self) -> BodyForce | None:
        """The body force: a field times an amplitude, with a factor that may be a parameter."""
        scene = self.scene
        pushes = self.pushes
        places = scene.places
        if scene.fluid is not None:
            parts = [self.expression(BODY_FORCE, v, "x", "y", "t") for v in scene.body_force]
            force = SurfaceForce.of(tuple(parts), scene.fluid.gravity)
            self._require_finite_force(force.field)
            return force
        strip = scene.strip
        if not pushes:
            return None
        moving = {text: a for push in pushes.values() for text, a in push.amplitudes.items()}
        _require_one(" and ".join(KEYS[name] for name in pushes), moving)
        (amplitude,) = moving.values()

        def field(position: Array) -> Array:
            place = places.wrapped(position)
            fields = [
                push(place) if strip is None or name != INFLOW else strip.forcing(place, push)
                for name, push in pushes.items()
            ]
            return np.sum(fields, axis=0) if len(fields) > 1 else fields[0]

        if strip is not None:
            inside = places.particles[strip.contains(places.particles.T)]
            checked = np.concatenate([scene.strip_samples, inside])
            require_finite(KEYS[INFLOW], pushes[INFLOW](checked.T).T, checked)
        if BODY_FORCE in pushes:
            self._require_finite_force(pushes[BODY_FORCE])
        factor = next((self.values.get(name, 1.0) for name in self.factors), 1.0)

        def series(times: Array | float) -> Array:
            with np.errstate(invalid="ignore"):  # a check refuses amplitudes that are not finite
                return factor * ramp_share(scene.ramp, times) * amplitude(t=times)

        return BodyForce(field, _remembered(series), series, changes=bool(amplitude.depends_on))

    def _require_finite_force(self, field: Callable[[Array], Array]) -> None:
        places = self.scene.places
        require_finite(BODY_FORCE, field(places.all.T).T, places.all)
        if not self.values:  # for all values the same peaks
            finite_peak(BODY_FORCE, places, lambda at: np.abs(field(at)).sum(axis=0))

    # The driving over time

    def timed(self) -> Iterator[tuple[str, Expression]]:
        """Yield the expressions that may depend on time, with their keys."""
        for drive in self.drives:
            yield from ((drive.key, amplitude) for amplitude in drive.amplitudes.values())
        if isinstance(self.force, SurfaceForce):
            yield from ((BODY_FORCE, part) for part in self.force.parts)

    def signals(self) -> Iterator[tuple[str, Callable[[Array], Array]]]:
        """Yield functions for the driving (n_places, n_times) at times (n_times,) [s], by key."""
        samples = self.scene.places.samples
        axes = self.scene.axes
        places = samples[:: len(samples) // N_PLACES + 1].T[..., None]
        for key, part in self.timed():
            shown = places if part.depends_on & set(axes) else places[:, :1]
            if "t" in part.depends_on:
                yield key, partial(_at_times, part, **dict(zip(axes, shown, strict=True)))

    @cached_property
    def shortest_period(self) -> float:
        """The shortest period of the driving [s] in the scene's runs; infinite if steady."""
        periods = (shortest_period(signal, self.scene.until) for _, signal in self.signals())
        return min(periods, default=math.inf)

    def times(self, until: float, number: int = N_CHECKED) -> Array:
        """Return times of a run [s] with the extreme values of histories, ascending."""
        times = [np.linspace(0.0, until, number)]
        for history in self.histories.values():
            rows = history.rows[:, (history.rows[0] >= 0.0) & (history.rows[0] <= until)]
            times += [rows[0, [np.argmin(rows[1]), np.argmax(rows[1])]]] if rows.size else []
        return np.unique(np.concatenate(times)) if len(times) > 1 else times[0]

    def inflow(self, until: float) -> Callable[[Array], Array]:
        """Return the inflow (2, n_positions) [m/s] when it is fastest, apart from its ramp."""
        push = self.pushes[INFLOW]
        largest = self.values.get(INFLOW, 1.0)
        if until > 0.0:
            largest *= push.largest(self.times(until))
        return lambda position: largest * push(position)

    def speeds(self, until: float) -> dict[str, float]:
        """Return the largest speeds of walls and the inflow [m/s] until a time [s], by key."""
        velocities = {}
        times = self.times(until)
        for name, drive in self.walls.items():
            at_edge = self.wall_velocity(name)(self.scene.places.edge(name))
            velocities[f"walls.{name}"] = drive.largest(times) * at_edge
        if INFLOW in self.pushes:
            velocities[KEYS[INFLOW]] = self.inflow(until)(self.scene.strip_samples.T).T
        return {key: largest_norm(velocity) for key, velocity in velocities.items()}

    def largest_head(self, until: float) -> float:
        """Return a bound of the body force's head along the fluid until a time [m2/s2]."""
        domain = self.scene.domain
        samples = self.scene.places.samples
        times = self.times(until, N_INSTANTS)
        drive = self.force
        push = self.pushes.get(BODY_FORCE)
        if isinstance(drive, SurfaceForce):
            heights = np.array((domain.lengths[0], min(self.level, domain.upper[1])))
            pulls = [self._pull(drive(samples.T, t)) for t in times]
            largest = float(np.max(pulls @ (heights - (0.0, domain.lower[1]))))
            # The times miss peaks by a little, by other parts at other frequencies. Rounded, the
            # head is the same at all of them, and so is the speed of sound that follows.
            largest = float(f"{largest:.4g}")
        elif drive is None or push is None:  # the forcing of an inflow only makes up its deficit
            largest = 0.0
        else:
            field = push(samples.T)
            if domain.fills_box:
                n_dim = domain.n_dim
                rows = field.reshape(n_dim, *(SAMPLES[n_dim] + 1,) * n_dim)
                for axis in np.flatnonzero(domain.periodic):  # a mean adds no pressure there
                    rows[axis] -= rows[axis].mean(axis=n_dim - 1 - axis, keepdims=True)
            largest = float(np.dot(domain.lengths, np.abs(field).max(axis=1, initial=0.0)))
            largest *= float(np.abs([drive.amplitude(t) for t in times]).max())
        return largest if math.isfinite(largest) else 0.0  # other values are refused

    def _pull(self, force: Array) -> Array:
        """Return the largest magnitudes (2,) of a force's components (2, n_samples) [m/s2]."""
        if math.isfinite(self.level) or not self.scene.domain.fills_box:
            return np.abs(force).max(axis=1)
        # One-way means along lines: forces to a centre press from both sides.
        ways = np.maximum((force, -force), 0.0).reshape(2, 2, SAMPLES[2] + 1, -1)
        return np.array([ways[:, axis].mean(axis=-1 - axis).max() for axis in range(2)])


def require_finite(key: str, values: Array, place: Array) -> None:
    """Raise ValueError if values (n_places, ...) at places aren't finite, or too large."""
    good = (np.abs(values) <= LARGEST).reshape(len(values), -1).all(axis=1)
    for value, where in zip(values[~good][:1], place[~good], strict=False):
        finite = np.isfinite(value).all()
        problem = f"above {LARGEST:g} in size" if finite else "not a finite number"
        raise ValueError(f"{key}: is {problem} at {place_text(where)} m")


def finite_peak(key: str, places: Places, size: Callable[[Array], Array]) -> tuple[float, Array]:
    """Return a field's largest value and its place (2,) [m]. Raises ValueError if not finite."""
    value, place = places.peak(size)
    require_finite(key, np.array([value]), place[None])
    return value, place


def largest_norm(velocity: Array) -> float:
    """Return the largest size of vectors (n_points, 2)."""
    return float(np.linalg.norm(velocity, axis=1).max(initial=0.0))


def at_places(field: Expression, position: Array) -> Array:
    """Return a field (n_positions,) at positions (n_dim, n_positions) [m]."""
    return field(**dict(zip("xyz", position, strict=False)))


def _at_times(part: Expression, times: Array | float, **place: Array) -> Array:
    return part(t=times, **place)


def _remembered(series: Callable[[float], Array | float]) -> Amplitude:
    """Return a function for one value of a series, cached: all runs of a case have equal times."""
    return lru_cache(MOST_TIMES)(lambda time: float(series(time)))


def _require_one(keys: str, amplitudes: Mapping[str, Expression]) -> None:
    if len(amplitudes) > 1:
        texts = " and ".join(amplitudes)
        reason = f"all components must have the same amplitude in time; got {texts}"
        raise ValueError(f"{keys}: {reason}")
