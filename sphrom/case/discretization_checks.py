"""Checks of the discretisation: sizes, spacings, narrow places, and time steps.

They yield a key, such as `rom.0.basis`, and its problem; `sphrom.case.checks` calls them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import shapely
from shapely.affinity import translate

from sphrom.case import studies
from sphrom.case.models import Case
from sphrom.case.plan_times import MAX_STEPS, STEPS_PER_PERIOD, WHOLE_STEPS_TOLERANCE
from sphrom.kernels import SUPPORT_RATIO
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import ROUNDING
from sphrom.sph.polygons import periodic_shifts
from sphrom.sph.walls.kinds import KINDS

Found = Iterator[tuple[str, str]]

MOST_REFINED = 4
"""Largest factor of the resolution that is a remedy for a narrow place."""
COARSEST = 8
"""The lowest resolution."""
MOST_POINTS, MOST_COUNTED = 2e10, 2e7
"""Largest number of lattice points in a box, and in one whose particles are counted one by one."""


def check_size(case: Case) -> Found:
    """Refuse lattices of absurd sizes, and levels without a row, before lattices are made."""
    length = case.scene.resolved_length
    resolution = case.discretization.resolution
    spacing = length / resolution
    sides = case.scene.domain.lengths
    if (depth := case.scene.level_at() - case.scene.domain.lower[1]) < 0.5 * spacing:
        reason = f"is {depth:.3g} m above the floor, less than a row of particles, {spacing:.3g} m"
        yield "scene.fluid.level", f"{reason}; raise it, or discretization.resolution"
    strip = case.scene.strip
    if strip is not None and (width := strip.end - strip.start) < spacing:
        reason = f"is {width:.3g} m wide, less than the particle spacing of {spacing:.3g} m"
        yield "scene.inflow.strip", f"{reason}; make it 20 spacings wide"
    most = MOST_COUNTED if case.scene.has_surface else MOST_POINTS
    if (number := math.prod(side / spacing for side in sides)) > most:
        reason = f"a lattice {spacing:.3g} m apart has {number:.3g} points in the box; {most:.0e}"
        remedy = f"lower it, or check the length of {length:g} m and the box"
        yield "discretization.resolution", f"{reason} are allowed at most: {remedy}"


def check_geometry(case: Case) -> Found:
    domain = case.scene.domain
    length = case.scene.resolved_length
    plan = case.plan
    section = case.discretization
    wanted = length / section.resolution
    fits = domain.narrowest_gap > 0.0 and domain.fits_lattice(wanted)
    if domain.narrowest_gap <= 0.0:
        yield "scene", "its lengths differ so much that the shortest is lost to rounding"
    elif not fits:
        reason = f"a spacing of {wanted:g} m doesn't divide all lengths of the scene to 0.5 %"
        found = fitting_resolutions(case)
        remedy = f"{' and '.join(map(str, found))} {'does' if len(found) == 1 else 'do'}"
        yield "discretization.resolution", f"{reason}; {remedy if found else 'none near it does'}"
    for level in sorted({case.scene.level_at(dict(point.others)) for point in plan.points}):
        if not math.isfinite(level) or not domain.fills_box:
            continue
        pitch = domain.pitches(plan.particle_spacing)[1] if fits else wanted
        if (end := domain.row_end(level, pitch)) != level:
            reason = f"rows of particles {pitch:g} m apart don't end at {level:g} m"
            remedy = f"they do at {end:g} m, and elsewhere with another discretization.resolution"
            yield "scene.fluid.level", f"{reason}; {remedy}"
    if case.scene.has_surface and not plan.n_particles:
        yield "scene.fluid", "no particle is in it; raise discretization.resolution"
    if case.scene.has_surface and section.shifting.enabled:
        yield "discretization.shifting.enabled", "moves fluid out of a free surface; leave it out"
    as_printed = "paper" in (section.viscosity, section.shifting.transport)
    if section.pair_precision == "float32" and (as_printed or domain.n_dim > 2):
        reason = "float32 is for the default terms of pairs, in two dimensions; leave it out"
        yield "discretization.pair_precision", reason
    if case.scene.has_surface and section.initial_particles == "packed":
        reason = "fluid with a free surface starts on a lattice; leave initial_particles out"
        yield "discretization.initial_particles", reason
    elif plan.walls_fit_lattice and plan.packed:
        reason = f"a scene of kind {case.scene.kind} has walls, which only a lattice fits"
        yield "discretization.initial_particles", reason
    for key, field in () if domain.has_walls else type(section.walls).model_fields.items():
        if getattr(section.walls, key) != field.default:
            reason = f"a scene of kind {case.scene.kind} has no walls"
            yield f"discretization.walls.{key}", reason
    kind = section.walls.kind
    if domain.has_walls and not plan.walls_fit_lattice and KINDS[kind].along_axes:
        yield "discretization.walls.kind", f"{kind} is for walls that follow the axes"
    if case.scene.has_surface and not KINDS[kind].below_surfaces:
        yield "discretization.walls.kind", f"{kind} is for flows with no free surface; use adjoint"
    gap = domain.narrowest_gap
    solid = domain.thinnest_solid
    most = min(0.5 * gap, solid)
    narrow = f"half of the narrowest fluid, {gap:g} m wide"
    limit = f"the thinnest solid, {solid:g} m thick" if most == solid else narrow
    own = plan.smoothing_length
    mapped = plan.reference_smoothing_length
    radius = SUPPORT_RATIO * max(own, mapped)
    if gap > 0.0 and radius > most * (1.0 + ROUNDING):
        least = math.ceil(section.resolution * radius / most * (1.0 - ROUNDING))
        enough = (n for n in range(least, 2 * least) if domain.fits_lattice(length / n))
        resolution = next(enough, least)
        key = "discretization.resolution"
        remedy = f"{resolution} would do, or a smaller discretization.smoothing_length_ratio"
        if mapped > own:
            remedy = f"{key}: {resolution} would do"
            key = "reference.smoothing_length_ratio"
        if least > MOST_REFINED * section.resolution:
            remedy = f"make it at least {radius:.3g} m thick"
            if most < solid:
                nearest_walls = narrow_place(domain, 2.0 * radius)
                remedy = nearest_walls or f"make it at least {2.0 * radius:.3g} m wide"
        yield key, f"a support of radius {radius:g} m is larger than {limit}: {remedy}"


def narrow_place(domain: Domain, width: float) -> str | None:
    """Return the two walls that are nearest to each other, and remedies, if nearer than a width."""
    if not domain.polygons:
        return None
    frame = shapely.get_coordinates(shapely.box(*domain.lower, *domain.upper))
    # The corners begin at the right, at the bottom, and go around anticlockwise.
    sides = zip(("right", "top", "left", "bottom"), frame[:-1], frame[1:], strict=True)
    lines = {name: shapely.linestrings(ends) for name, *ends in sides if name in domain.wall_names}
    pairs = [
        (shapely.shortest_line(shape, moved), name, other)
        for (name, shape), (other, moved) in product(domain.polygons, _images(domain, lines))
        if name != other or not shapely.equals(shape, moved)
    ]
    line, name, other = min(pairs, key=lambda pair: (shapely.length(pair[0]), *pair[1:]))
    if not shapely.length(line) < width:
        return None
    x, y = shapely.get_coordinates(line).mean(axis=0)
    remedy = "let them overlap, join them into one solid by `union`"
    if other in lines:
        remedy = f"let {name} dip into the wall"
    between = f"at ({x:.4g}, {y:.4g}) m, between {name} and {other}"
    return f"{between}: {remedy}, or leave {width:.3g} m between them"


def _images(domain: Domain, lines: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the sides of the box, and the solids with their periodic images, by name."""
    yield from lines.items()
    for shift in periodic_shifts(domain.lengths, domain.periodic):
        yield from ((name, translate(shape, *shift)) for name, shape in domain.polygons)


def fitting_resolutions(case: Case) -> list[int]:
    """Return the nearest resolutions, below and above, at which walls fit the lattice.

    Both are the case's own if it fits. Those below its half and above its double are left out.
    """
    domain = case.scene.domain
    length = case.scene.resolved_length
    resolution = case.discretization.resolution
    below = range(resolution, max(resolution // 2, COARSEST - 1), -1)
    above = range(resolution, 2 * resolution + 1)
    fitting = [[n for n in near if domain.fits_lattice(length / n)][:1] for near in (below, above)]
    return [*fitting[0], *fitting[1]]


def coarser_resolution(case: Case) -> int | None:
    """Return half the resolution, or None if particles would not fit the scene."""
    half = case.discretization.resolution // 2
    fits = half >= COARSEST and not any(check_geometry(studies.at_resolution(case, half)))
    return half if fits else None


def check_steps(case: Case) -> Found:
    time = case.time
    plan = case.plan
    if not plan.step_target > 0.0:
        yield "time", "no step is short enough; the resistance or the inflow is too strong"
        return
    resolved = plan.shortest_period / STEPS_PER_PERIOD
    swings = f"the driving oscillates with a period of {plan.shortest_period:.4g} s"
    if (number := time.final_time / plan.step_target) > MAX_STEPS:
        why = f"; {swings}" if resolved <= plan.step_target else ""
        yield "time", f"a run of {number:.3g} steps; at most {MAX_STEPS:g} are allowed{why}"
        return
    if plan.step_target > resolved * (1.0 + WHOLE_STEPS_TOLERANCE):
        yield "time.step", f"{swings}, which needs steps of at most {resolved:.4g} s"
    number = max(1.0, plan.recorded_time / plan.step_target)
    if case.snapshots.every > number * (1.0 + WHOLE_STEPS_TOLERANCE):
        reason = f"must be at most the number of steps, {int(number)}; got {case.snapshots.every}"
        yield "snapshots.every", reason
    elif time.step != "auto":
        for key, duration in (("step", time.final_time), ("spin_up", time.spin_up)):
            if (problem := not_whole(duration, time.step)) is not None:
                yield f"time.{key}", problem
                return
    else:
        ratio = plan.spin_up_ratio
        recorded = plan.recorded_time
        apart = abs(float(ratio) * recorded - time.spin_up) > WHOLE_STEPS_TOLERANCE * time.spin_up
        if apart or math.lcm(case.snapshots.every, ratio.denominator) > number * (1.0 + ROUNDING):
            yield (
                "time.spin_up",
                f"no step near {plan.step_target:.4g} s fits both {time.spin_up:g} s and the "
                f"{recorded:g} s after it; {max(1, round(ratio)) * recorded:.12g} s would do",
            )


def not_whole(duration: float, step: float) -> str | None:
    """Return a problem with the nearest step if a duration is no whole number of steps, or None."""
    number = duration / step
    whole = max(1, round(number))
    if number <= MAX_STEPS and abs(number - round(number)) <= WHOLE_STEPS_TOLERANCE * number:
        return None
    return (
        f"{duration:g} s is not a whole number of steps of {step:g} s; the nearest step is "
        f"{duration / whole:.12g}"
    )


def beyond_limits(case: Case) -> Iterator[str]:
    """Yield the limits that the time step exceeds."""
    step = case.time.step
    plan = case.plan
    stable = plan.limits
    sizes = plan.discretization
    courant = stable.acoustic * plan.sound_speed / sizes.smoothing_length
    beside = f"beside walls at most {sizes.walls.viscous_limit:g} h dx / nu"
    limits = {
        "acoustic": (stable.acoustic, f"{courant:.3g} h / c0, Eq. 2.19"),
        "viscous": (stable.viscous, f"0.125 h^2 / nu, {beside}"),
    }
    for name, (limit, formula) in limits.items():
        if step != "auto" and step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            yield f"{step:g} s is beyond the {name} limit of {limit:.4g} s ({formula})"


def check_limits(case: Case) -> Found:
    for reason in beyond_limits(case):
        yield "time.step", f"{reason}; --force accepts it"
