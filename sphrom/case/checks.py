"""What must hold between the sections of a case: the full model's, and all together.

Each section checks itself; `sphrom.case.model_checks` has the reduced models and the studies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.case.messages import Path, Problem, nearest
from sphrom.case.model_checks import (
    check_bases,
    check_figures,
    check_fit,
    check_fixed_points,
    check_modes,
    check_reduced_models,
    check_reduced_times,
    check_splines,
    check_sweep,
    check_training,
)
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS, ROUNDING, WHOLE_STEPS_TOLERANCE
from sphrom.case.points import REYNOLDS, GivenPoints, ParameterPoint, impossible
from sphrom.case.scene_section import KINDS, MeasureSection
from sphrom.case.studies import at_resolution
from sphrom.kernels import SUPPORT_RATIO
from sphrom.text import exact, repeated

Array = NDArray[np.float64]

WITHIN_WALL = 0.1
"""How far a place may be in the solid, over the particles' spacing: a circle is a polygon."""
PER_SPACING = 4
"""Places along a segment that are looked at, for each spacing of the particles."""
MOST_LOOKED_AT = 100_000


def case_problems(case: Case, *, force: bool = False) -> list[Problem]:
    """Return what makes a case invalid; `force` insists on an unstable time step."""
    if problems := list(_check_names(case)):
        return problems
    problems = [problem for check in _CHECKS for problem in check(case)]
    if not force:
        problems += [
            Problem(("time", "step"), f"{reason}; --force insists on it")
            for reason in beyond_limits(case)
        ]
    # Snapshots can only be counted once steps and parameters make sense.
    return problems or [problem for check in _SNAPSHOT_CHECKS for problem in check(case)]


def _check_names(case: Case) -> Iterator[Problem]:
    """Check that what varies is there and can vary, before anything asks for the points.

    Other sections may name the parameters of `parameters.train` and `test` only.
    """
    known = case.plan.own_values
    for group in ("train", "test"):
        given: GivenPoints = getattr(case.parameters, group)
        path: Path = ("parameters", group)
        for name in given.names:
            if name not in known:
                reason = f"the case has no such parameter; {nearest(name, known)}"
                yield Problem((*path, name), reason)
    if not _has_reynolds(case):
        yield Problem(
            ("parameters", "test", REYNOLDS),
            "is missing, and parameters.train has several: name one or more",
        )
    for name, reason in case.scene.parameter_problems(case.plan.parameter_names):
        yield Problem(("parameters", name), f"can't vary: {reason}")
    for path, values in _elsewhere(case):
        for name in values:
            if name not in case.plan.parameter_names:
                reason = f"{name} varies in neither parameters.train nor parameters.test"
                yield Problem(path, f"{reason}; {', '.join(case.plan.parameter_names)} do")


def _has_reynolds(case: Case) -> bool:
    """Whether points that name no Reynolds number may have that of the case, as it has one."""
    train, test = case.parameters.train, case.parameters.test
    named = (train, test) if test.lists.keys() != {REYNOLDS} or test.points or test.sample else ()
    return len(train.reynolds) == 1 or all(
        REYNOLDS in point for given in named for point in (*given.points, *_names_of(given))
    )


def _names_of(given: GivenPoints) -> Sequence[Mapping[str, object]]:
    """Return the parameters of a sample or a grid, as one point."""
    if given.sample is not None:
        return [given.sample.ranges]
    if given.points:
        return []
    return [{name: values for name, values in given.lists.items() if values}]


def _elsewhere(case: Case) -> Iterator[tuple[Path, Mapping[str, object]]]:
    """Yield the values by name that other sections list."""
    for i, model in enumerate(case.rom):
        for values in model.parameters if not isinstance(model.parameters, str) else ():
            if isinstance(values, Mapping):
                yield ("rom", i, "parameters"), values
    for name, subset in case.basis.subsets.items():
        yield ("basis", "subsets", name, "box"), subset.box or {}
    key = "parameters" if case.sweep.sample is None else "sample"
    yield ("sweep", key), dict.fromkeys(case.sweep.names)


def _check_points(case: Case) -> Iterator[Problem]:
    """Check that full runs are of different values, and that each can be made."""
    for group in ("train", "test"):
        points = case.plan.train_points if group == "train" else case.plan.test_points
        for label in repeated(point.label for point in points):
            yield Problem(_path(case, group), f"{label} stands more than once")
        yield from _check_values(case, points, ("parameters", group))
    trained = {point.label for point in case.plan.train_points}
    for point in case.plan.test_points:
        if point.label in trained:
            yield Problem(_path(case, "test"), f"{point.label} is trained on; test elsewhere")


def _path(case: Case, group: str) -> Path:
    """Return the key that a group's values stand in."""
    given: GivenPoints = getattr(case.parameters, group)
    return ("parameters", group, REYNOLDS) if given.is_list else ("parameters", group)


def _check_values(case: Case, points: Sequence[ParameterPoint], path: Path) -> Iterator[Problem]:
    for point in points:
        if (reason := impossible(REYNOLDS, point.reynolds)) is not None:
            yield Problem(path, f"{point.label}: reynolds {reason}")
    for others in dict.fromkeys(point.others for point in points):
        try:
            case.scene.check_at(dict(others))
        except ValueError as error:
            label = ", ".join(f"{name}={exact(value)}" for name, value in others)
            yield Problem(path, f"{label}: {error}")
            return


def check_geometry(case: Case) -> Iterator[Problem]:
    """Check that walls lie on the lattice of particles, and stand where they are asked for."""
    domain, length = case.scene.domain, case.scene.resolved_length
    if domain.narrowest_gap <= 0.0:
        yield Problem(("scene",), "its lengths are so far apart that the smallest gets lost")
    elif not domain.fits_lattice(case.plan.particle_spacing):
        fitting = nearest_fitting_resolution(case)
        remedy = f"the nearest that does is {fitting}" if fitting else "nor does any that is near"
        yield Problem(
            ("discretization", "resolution"),
            f"a spacing of {case.plan.particle_spacing:g} m, from {case.discretization.resolution} "
            f"particles along {length:g} m, doesn't divide all lengths of the scene; {remedy}",
        )
    if case.plan.walls_fit_lattice and case.plan.packed:
        yield Problem(
            ("discretization", "initial_particles"),
            f"a scene of kind {case.scene.kind} has walls, which only a lattice fits; "
            "packing is for periodic boxes and solids of any shape",
        )
    if not domain.has_walls:
        walls = case.discretization.walls
        for key, field in type(walls).model_fields.items():
            if getattr(walls, key) != field.default:
                reason = f"a scene of kind {case.scene.kind} has no walls"
                yield Problem(("discretization", "walls", key), reason)


def nearest_fitting_resolution(case: Case) -> int | None:
    """Return the resolution nearest to the case's at which walls fit the lattice, if one is near.

    It is at most half as coarse, or twice as fine.
    """
    domain, length = case.scene.domain, case.scene.resolved_length
    resolution = case.discretization.resolution
    for distance in range(resolution // 2):
        for candidate in (resolution + distance, resolution - distance):
            if domain.fits_lattice(length / candidate):
                return candidate
    return None


def check_support(case: Case) -> Iterator[Problem]:
    """Check that kernels reach no further than the fluid is wide."""
    domain = case.scene.domain
    walls, width, solid = domain.has_walls, domain.narrowest_gap, domain.thinnest_solid
    if width <= 0.0:
        return
    for section, smoothing_length in (
        ("discretization", case.plan.smoothing_length),
        ("reference", case.plan.reference_smoothing_length),
    ):
        radius = SUPPORT_RATIO * smoothing_length
        if radius > 0.5 * width * (1.0 + ROUNDING):
            where = "fluid between walls" if walls else "periodic box"
            where = f"half of the {where} of {width:g} m"
            yield _support_problem(case, section, radius, where, 0.5 * width)
        elif radius > solid * (1.0 + ROUNDING):
            where = f"the solid between fluid and fluid of {solid:g} m"
            yield _support_problem(case, section, radius, where, solid)


def _support_problem(case: Case, section: str, radius: float, where: str, most: float) -> Problem:
    ratio = most / (SUPPORT_RATIO * case.plan.particle_spacing)
    least = math.ceil(case.discretization.resolution * radius / most * (1.0 - ROUNDING))
    return Problem(
        (section, "smoothing_length_ratio"),
        f"a support of radius {radius:g} m is larger than {where}; use at most {ratio:g}, or a "
        f"resolution of at least {least}",
    )


def _check_steps(case: Case) -> Iterator[Problem]:
    """Check that runs are whole numbers of steps, and not absurdly many."""
    time = case.time
    steps = time.final_time / case.plan.step_target
    if steps > MAX_STEPS:
        yield Problem(("time",), f"a run of {steps:.3g} steps; at most {MAX_STEPS:g} are allowed")
        return
    recorded = case.plan.recorded_time / case.plan.step_target
    if time.step != "auto":
        yield from _check_whole_steps(case, time.step)
    if case.snapshots.every > max(1.0, recorded) * (1.0 + WHOLE_STEPS_TOLERANCE):
        yield Problem(
            ("snapshots", "every"),
            f"must be at most the number of steps, {max(1, int(recorded))}; "
            f"got {case.snapshots.every}",
        )
    elif time.step == "auto":
        yield from _check_spin_up(case, recorded)


def _check_whole_steps(case: Case, step: float) -> Iterator[Problem]:
    final_time, spin_up = case.time.final_time, case.time.spin_up
    whole = max(1, round(final_time / step))
    if not _is_whole(final_time / step):
        yield Problem(
            ("time", "step"),
            f"{final_time:g} s is not a whole number of steps of {step:g} s; "
            f"the nearest step is {final_time / whole:.12g}, or end at {whole * step:.12g} s",
        )
    elif not _is_whole(spin_up / step):
        yield Problem(
            ("time", "spin_up"),
            f"{spin_up:g} s is not a whole number of steps of {step:g} s; "
            f"the nearest is {round(spin_up / step) * step:.12g} s",
        )


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= WHOLE_STEPS_TOLERANCE * number


def _check_spin_up(case: Case, steps: float) -> Iterator[Problem]:
    """Check that one automatic step fits both the spin-up and what is recorded after it."""
    ratio, recorded = case.plan.spin_up_ratio, case.plan.recorded_time
    fitting = float(ratio) * recorded
    if abs(fitting - case.time.spin_up) > WHOLE_STEPS_TOLERANCE * case.time.spin_up:
        yield Problem(
            ("time", "spin_up"),
            f"no step fits both {case.time.spin_up:g} s and the {recorded:g} s after it; the "
            f"nearest that has one is {fitting:.12g} s",
        )
    elif math.lcm(case.snapshots.every, ratio.denominator) > max(1.0, steps) * (1.0 + ROUNDING):
        simple = max(1, round(ratio)) * recorded
        yield Problem(
            ("time", "spin_up"),
            f"only much shorter steps than those of {case.plan.step_target:.4g} s fit both "
            f"{case.time.spin_up:g} s and the {recorded:g} s after it; {simple:.12g} s would do",
        )


def beyond_limits(case: Case) -> Iterator[str]:
    """Yield which limits the time step is beyond."""
    step, known = case.time.step, case.plan.limits
    limits = {
        "acoustic": (known.acoustic, "1.5 h / c0, Eq. 2.19"),
        "viscous": (known.viscous, "0.125 h^2 / nu, beside walls at most 0.22 h dx / nu"),
        "body-force": (known.body_force, "0.25 sqrt(h / b)"),
    }
    for name, (limit, formula) in limits.items():
        if step != "auto" and step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            yield f"{step:g} s is beyond the {name} limit of {limit:.4g} s ({formula})"


def _check_scene(case: Case) -> Iterator[Problem]:
    """Check the scene, that its measured walls are there, and that places are in the fluid."""
    for name, reason in case.scene.problems(case.time.final_time):
        yield Problem(("scene", name), reason)
    for name, measured in case.scene.measure.items():
        kind = next(kind for kind in KINDS if getattr(measured, kind) is not None)
        if (problem := _measure_problem(case, measured)) is not None:
            yield Problem(("scene", "measure", name, kind), problem)


def _measure_problem(case: Case, measured: MeasureSection) -> str | None:
    if measured.force_on is not None:
        names = case.scene.domain.wall_names
        if measured.force_on in names:
            return None
        return f"there is no such wall; the walls are {', '.join(names) or 'none'}"
    if measured.probe is not None:
        return outside_fluid(case, np.array([measured.probe]))
    assert measured.segment is not None
    start, end = np.array(measured.segment)
    length = math.dist(start, end)
    if not length > 0.0:
        return "its ends are one place"
    number = min(2 + math.ceil(PER_SPACING * length / case.plan.particle_spacing), MOST_LOOKED_AT)
    along = np.linspace(0.0, 1.0, number)[:, None]
    return outside_fluid(case, start + along * (end - start))


def outside_fluid(case: Case, place: Array) -> str | None:
    """Return which of some places (n_places, 2) is out of the box or in a solid, in words."""
    domain = case.scene.domain
    slack = WITHIN_WALL * case.plan.particle_spacing
    beyond = (place < np.array(domain.lower)) | (place > np.array(domain.upper))
    for x, y in place[beyond.any(axis=1)][:1]:
        return f"({x:g}, {y:g}) m is outside of the box"
    in_solid = domain.distance_and_normal(place)[0] < -slack
    for x, y in place[in_solid][:1]:
        more = "; give a segment for each part of the fluid" if len(place) > 1 else ""
        return f"({x:g}, {y:g}) m is in a solid{more}"
    return None


def _check_compare(case: Case) -> Iterator[Problem]:
    if case.compare.from_time >= case.time.final_time:
        yield Problem(
            ("compare", "from_time"),
            f"must be before time.final_time, {exact(case.time.final_time)} s; "
            f"got {exact(case.compare.from_time)}",
        )
    if case.compare.exact and not case.scene.has_exact_solution:
        yield Problem(
            ("compare", "exact"), f"a scene of kind {case.scene.kind} has no exact solution"
        )
    left, right = case.scene.domain.lower[0], case.scene.domain.upper[0]
    line = case.plan.probe_line
    if not left < line < right:
        yield Problem(
            ("compare", "line"),
            f"must be within the scene, between {left:g} and {right:g} m; got {line:g}",
        )


def _check_trade(case: Case) -> Iterator[Problem]:
    """Check that the models to be weighed exist in the case."""
    section = case.trade
    if section.measure is not None and section.measure not in case.scene.measure:
        known = tuple(case.scene.measure)
        hint = nearest(section.measure, known) if known else "scene.measure is empty"
        reason = f"nothing measured has the name {section.measure}; {hint}"
        yield Problem(("trade", "measure"), reason)
    for size in section.n_modes or ():
        if size > case.plan.n_modes:
            reason = (
                f"the basis keeps {case.plan.n_modes} modes; got {size}; basis.n_modes keeps more"
            )
            yield Problem(("trade", "n_modes"), reason)
    for resolution in section.resolutions or ():
        coarser = at_resolution(case, resolution)
        for problem in (*check_geometry(coarser), *check_support(coarser)):
            yield Problem(("trade", "resolutions"), f"{resolution}: {problem.reason}")


def coarser_resolution(case: Case) -> int | None:
    """Return half the resolution, or None where particles would not fit the scene then."""
    half = case.discretization.resolution // 2
    if half < 8:
        return None
    coarser = at_resolution(case, half)
    fits = not any((*check_geometry(coarser), *check_support(coarser)))
    return half if fits else None


_Check = Callable[[Case], Iterable[Problem]]
_CHECKS: tuple[_Check, ...] = (
    _check_points,
    check_geometry,
    _check_scene,
    check_splines,
    check_support,
    _check_steps,
    check_bases,
    check_reduced_models,
    check_fixed_points,
    _check_compare,
    check_figures,
)
_SNAPSHOT_CHECKS: tuple[_Check, ...] = (
    check_modes,
    check_reduced_times,
    _check_trade,
    check_sweep,
    check_fit,
    check_training,
)
