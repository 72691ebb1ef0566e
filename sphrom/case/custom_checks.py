"""Checks of a scene of kind custom. Generators yield a key of the scene and its problem."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import shapely

from sphrom.arrays import Array
from sphrom.case.custom_sections import ShapedFluid, SurfaceForce
from sphrom.case.driving import (
    BODY_FORCE,
    INFLOW,
    KEYS,
    N_CHECKED,
    Driving,
    largest_norm,
    require_finite,
)
from sphrom.metrics.series import pole_of
from sphrom.scenes.expressions import MOST_QUOTED
from sphrom.sph.fluid import Fluid
from sphrom.sph.places import N_SAMPLES, TOUCHING
from sphrom.text import place_text, shortened

if TYPE_CHECKING:
    from sphrom.case.custom_scene import CustomScene

Found = Iterator[tuple[str, str]]

FASTEST = 0.45
"""Largest speed relative to that of sound; the density then changes by 10 %, which ends a run."""
LARGEST_CHANGE = 0.1
"""Largest relative change of the density, which ends a run."""
THROUGH_WALL = 0.07
"""Largest initial speed through a wall relative to that of sound. Sound that a flat wall reflects
changes the density by this share, and more in corners; at 0.08 a box of 20 x 20 particles is
unstable."""
MISSED = 0.7
"""Share of a field that particles miss, from which it changes within a spacing. It is 0.4 for waves
of four spacings, 0.75 for waves of two, and 0.5 for a band of two with its edges at particles."""
ALONG = 0.02
"""Tolerated normal speed of a wall over its speed; it is not zero because circles are polygons."""
OTHER_UNIT = 100.0
"""Ratio of the widths of a solid and the box, or its inverse, that suggests another unit."""
MOST_AREAS = 4
"""Largest number of areas in a warning about separate parts of the fluid."""


def check_walls(driving: Driving) -> None:
    """Raise ValueError unless walls' velocities are finite and along the walls."""
    scene = driving.scene
    for name, wall in scene.walls.items():
        if name not in scene.shapes and wall.rotation is not None:
            raise ValueError(f"walls.{name}.rotation: a side of the box can't rotate")
        place = scene.places.edge(name)
        velocity = driving.wall_velocity(name)(place)
        require_finite(f"walls.{name}.velocity", velocity, place)
        normal = scene.domain.distance_and_normal(place)[1]
        across = np.abs(np.sum(velocity * normal, axis=1))
        worst = int(np.argmax(across))
        if across[worst] > ALONG * float(np.max(np.hypot.reduce(velocity.T))):
            raise ValueError(
                f"walls.{name}: its velocity at {place_text(place[worst])} m has a normal "
                f"component of {across[worst]:.3g} m/s; walls may only move in their own direction"
            )


def check_surface(driving: Driving) -> None:
    """Raise ValueError unless the fluid with a free surface is in the box, if there is one."""
    scene = driving.scene
    level = driving.level
    if scene.fluid is None:
        return
    low, high = scene.domain.lower[1], scene.domain.upper[1]
    if isinstance(scene.fluid, ShapedFluid):
        if not scene.domain.fluid.buffer(TOUCHING).contains(scene.fluid.geometry()):
            raise ValueError("fluid: must lie within the box and outside of solids")
    elif not low < level < high:
        raise ValueError(f"fluid.level: must be above {low:g} and below {high:g}; got {level:g}")


def largest_rate(scene: CustomScene) -> float:
    """Return the largest rate of linear terms [1/s]. Raises ValueError for impossible terms."""
    largest = 0.0
    places = scene.places.all
    for name, term in scene.added.items():
        try:
            matrices = term.matrices(places)
            values = term(places, np.ones_like(places.T), 0.0)
        except (TypeError, ValueError) as error:
            raise ValueError(f"terms.{name}: {error}") from error
        require_finite(f"terms.{name}", values.T, places)
        largest += float(np.linalg.norm(matrices, axis=(0, 1)).max())
    return largest


def parameter_problems(scene: CustomScene, names: Collection[str]) -> Found:
    """Yield constants in which walls or the force aren't affine, and ambiguous names."""
    driving = scene.at()
    varied = [name for name in names if name in scene.constants]
    slowed = driving.expression("resistance", scene.resistance, *scene.axes)
    for name in (name for name in varied if slowed.degree_in([name]) > 0.0):
        yield name, "resistance depends on it, but parameters can't change resistance"
    for key, timed in driving.timed():
        for name in varied:
            if any(time.degree_in([name]) > 0.0 for _, time in timed.read()):
                yield name, f"{key} reads a history at times that depend on it"
    for name in varied:
        if name in (*scene.walls, BODY_FORCE, INFLOW):
            yield name, "is the name of a constant and of a wall or force; rename the constant"
    # A push has no parameter that multiplies its field.
    factors = (*driving.walls, *[""] * len(driving.pushes))
    for factor, drive in zip(factors, driving.drives, strict=True):
        for expression in drive.fields:
            used = [one for one in varied if expression.degree_in([one]) > 0.0]
            if expression.degree_in(varied) + (factor in names) <= 1.0 or not used:
                continue
            reason = f"multiplies {factor}, which also varies, in {drive.key}; vary only one"
            if factor not in names:
                text = shortened(expression.text, MOST_QUOTED)
                reason = (
                    f"{drive.key} must be a constant part plus multiples of {', '.join(used)}, "
                    f"because operators are projected once for all values; got '{text}'"
                )
            yield used[0], reason


def unknown_times(scene: CustomScene, final_time: float) -> Found:
    """Yield the first key whose history doesn't contain all times of runs [s]."""
    times = np.linspace(0.0, final_time, N_CHECKED)
    for key, expression in scene.at().timed():
        for name, time in expression.read():
            if (problem := scene.at().histories[name].lacks(time(t=times))) is not None:
                yield key, f"{name}: {problem}"
                return


def problems(scene: CustomScene, final_time: float, fluid: Fluid) -> Found:
    """Refuse a driving that isn't finite at all times, and an inflow that ramps too long.

    Speeds near that of sound, and an initial velocity through a wall, are refused too. If several
    values of the parameters have a problem, the first is refused. Driving can't be evaluated at
    times that a history does not contain.
    """
    if found := list(unknown_times(scene, final_time)):
        yield from found
        return
    if scene.ramp >= final_time:
        yield "inflow.ramp", f"takes {scene.ramp:g} s, until time.final_time or longer"
    for driving in scene.checked_drivings:
        if found := list(_problems_at(driving, final_time, fluid)):
            yield found[0]
            return


def _problems_at(driving: Driving, final_time: float, fluid: Fluid) -> Found:
    times = np.linspace(0.0, final_time, N_CHECKED)
    sound_speed = fluid.sound_speed
    for key, signal in driving.signals():
        if (pole := pole_of(signal, times)) is not None:
            yield key, f"is not finite at t = {pole:.4g} s"
            return
    samples = driving.scene.places.samples
    start = driving.initial(samples[samples[:, 1] <= driving.level])
    speeds = {**driving.speeds(final_time), "initial": largest_norm(start[:, :-1])}
    for key, speed in speeds.items():
        if speed > FASTEST * sound_speed:
            yield (
                key,
                f"reaches {speed:.4g} m/s, {speed / sound_speed:.2g} times the speed of "
                f"sound; set fluid.reference_speed: {speed:.3g}, or lower it",
            )
    pressure = np.abs(driving.initial(samples)[:, -1]).max()
    density = fluid.reference_density
    if pressure > LARGEST_CHANGE * density * sound_speed**2:
        yield (
            "initial.p",
            f"{pressure:.3g} Pa changes the density by more than 10 % at {density:g} kg/m3 and a "
            f"speed of sound of {sound_speed:.3g} m/s; check fluid.reference_density, or raise "
            "fluid.reference_speed",
        )
    speed, wall = _through_wall(driving)
    if speed > THROUGH_WALL * sound_speed:
        yield (
            "initial",
            f"goes through the wall {wall} with {speed:.3g} m/s, which causes a strong sound "
            "wave; start at rest, or with a velocity along the walls, or lower "
            "fluid.mach_number",
        )


def unresolved(scene: CustomScene, particle_spacing: float) -> Iterator[str]:
    """Yield the keys of fields that change within a spacing [m], so that particles miss it."""
    driving = scene.at()
    resistance = scene.slowing.resistance
    place = scene.places.scattered
    place = place[place[:, 1] <= driving.level]
    fields: dict[str, Callable[[Array], Array]] = {d.key: d for d in driving.pushes.values()}
    if isinstance(force := driving.force, SurfaceForce):
        weight = np.array([[0.0], [force.gravity]])
        fields[BODY_FORCE] = lambda at: force(at, scene.until) + weight
    if resistance is not None and resistance.own is not None:
        fields["resistance"] = resistance.own
    for key, field in fields.items():
        at = place
        if key == KEYS[INFLOW] and scene.strip is not None:
            at = place[scene.strip.contains(place.T)]
        lower = np.array(scene.domain.lower)
        centre = lower + (np.floor((at - lower) / particle_spacing) + 0.5) * particle_spacing
        exact = field(at.T)
        seen = field(centre.T)
        if np.abs(exact - seen).sum() > MISSED * np.abs(exact).sum():
            yield key


def _through_wall(driving: Driving) -> tuple[float, str]:
    """Return the largest initial speed [m/s] normal to a wall, and its place in words."""
    scene = driving.scene
    largest, where = 0.0, ""
    at_rest = scene.initial == type(scene.initial)()
    for name in () if at_rest or scene.fluid is not None else scene.domain.wall_names:
        with suppress(ValueError):  # no fluid touches this wall
            place = scene.places.edge(name)
            normal = scene.domain.distance_and_normal(place)[1]
            across = np.abs(np.sum(driving.initial(place)[:, :-1] * normal, axis=1))
            if across.max() > largest:
                largest = float(across.max())
                where = f"{name} at {place_text(place[np.argmax(across)], '.4g')} m"
    return largest, where


def odd_units(scene: CustomScene) -> Found:
    """Yield solids whose coordinates seem to have another unit than the box."""
    width = max(np.subtract(scene.box.upper, scene.box.lower))
    for name, shape in scene.shapes.items():
        ratio = max(np.subtract(shape.bounds[2:], shape.bounds[:2])) / width
        if not 1.0 / OTHER_UNIT < ratio < OTHER_UNIT:
            hint = f"is {ratio:.2g} times as wide as the box; `scale` changes units"
            yield f"solids.{name}", hint


def warnings(scene: CustomScene) -> Found:
    """Warn of solids in another unit, or that divide the fluid or cross an inflow."""
    yield from odd_units(scene)
    if len(areas := scene.domain.separate_areas) > 1:
        sizes = ", ".join(f"{area:.4g}" for area in areas[:MOST_AREAS])
        yield "solids", f"divide the fluid into {len(areas)} parts, of {sizes} m2"
    read = {name for _, expression in scene.at().timed() for name, _ in expression.read()}
    for name in scene.histories.keys() - read:
        yield f"histories.{name}", f"is not used; write {name}(t) in an expression"
    if (strip := scene.strip) is None:
        return
    # Solids may cross the strip if their width is constant, like walls.
    lines = scene.places.lines(strip.axis, np.linspace(strip.start, strip.end, N_SAMPLES + 1))
    for name, shape in scene.shapes.items():
        widths = shapely.length(shapely.intersection(shape, lines))
        if np.ptp(widths) > TOUCHING * max(scene.domain.lengths):
            yield f"solids.{name}", "is in the strip of the inflow, which forces the flow there"
