"""What must hold between a case's geometry, its particles and its steps."""

from __future__ import annotations

import math
from collections.abc import Iterator

from sphrom.case.geometry import nearest_fitting_resolution
from sphrom.case.models import ROUNDING, Case
from sphrom.case.plan import (
    MAX_STEPS,
    WHOLE_STEPS_TOLERANCE,
    acoustic_limit,
    force_limit,
    recorded_time,
    spin_up_ratio,
    step_target,
    viscous_limit,
)
from sphrom.case.scenes import OpenCavityScene
from sphrom.case.yaml_reader import Problem
from sphrom.kernels.support import SUPPORT_RATIO
from sphrom.text import exact


def check_geometry(case: Case) -> Iterator[Problem]:
    """Check that walls lie on the lattice of particles, and stand where they are asked for."""
    scene, domain, length = case.scene, case.scene.domain, case.scene.resolved_length
    if isinstance(scene, OpenCavityScene) and scene.cavity_length >= scene.channel_length:
        yield Problem(("scene", "cavity_length"), f"must be below the channel's {length:g} m")
    elif domain.narrowest_gap <= 0.0:
        yield Problem(("scene",), "its lengths are so far apart that the smallest gets lost")
    elif not domain.fits_lattice(case.particle_spacing):
        fitting = nearest_fitting_resolution(case)
        remedy = f"the nearest that does is {fitting}" if fitting else "nor does any that is near"
        yield Problem(
            ("discretization", "resolution"),
            f"a spacing of {case.particle_spacing:g} m, from {case.discretization.resolution} "
            f"particles along {length:g} m, doesn't divide all lengths of the scene; {remedy}",
        )
    if case.walls_fit_lattice and case.packed:
        yield Problem(
            ("discretization", "initial_particles"),
            f"a scene of kind {case.scene.kind} has walls, which only a lattice fits; "
            "packing is for periodic boxes and solids of any shape",
        )
    if not domain.has_walls:
        yield from _check_no_wall_keys(case)


def _check_no_wall_keys(case: Case) -> Iterator[Problem]:
    walls = case.discretization.walls
    for key, field in type(walls).model_fields.items():
        if getattr(walls, key) != field.default:
            yield Problem(
                ("discretization", "walls", key), f"a scene of kind {case.scene.kind} has no walls"
            )


def check_support(case: Case) -> Iterator[Problem]:
    """Check that kernels reach no further than the fluid is wide."""
    domain = case.scene.domain
    walls, width, solid = domain.has_walls, domain.narrowest_gap, domain.thinnest_solid
    if width <= 0.0:
        return
    for section, smoothing_length in (
        ("discretization", case.smoothing_length),
        ("reference", case.reference_smoothing_length),
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
    ratio = most / (SUPPORT_RATIO * case.particle_spacing)
    least = math.ceil(case.discretization.resolution * radius / most * (1.0 - ROUNDING))
    return Problem(
        (section, "smoothing_length_ratio"),
        f"a support of radius {radius:g} m is larger than {where}; use at most {ratio:g}, or a "
        f"resolution of at least {least}",
    )


def check_steps(case: Case) -> Iterator[Problem]:
    """Check that runs are whole numbers of steps, and not absurdly many."""
    time = case.time
    if time.spin_up >= time.final_time:
        yield Problem(
            ("time", "final_time"),
            f"must be after time.spin_up, {exact(time.spin_up)} s; got {exact(time.final_time)}",
        )
        return
    steps = time.final_time / step_target(case)
    if steps > MAX_STEPS:
        yield Problem(("time",), f"a run of {steps:.3g} steps; at most {MAX_STEPS:g} are allowed")
        return
    recorded = recorded_time(case) / step_target(case)
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
    ratio, recorded = spin_up_ratio(case), recorded_time(case)
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
            f"only much shorter steps than those of {step_target(case):.4g} s fit both "
            f"{case.time.spin_up:g} s and the {recorded:g} s after it; {simple:.12g} s would do",
        )


def beyond_limits(case: Case) -> Iterator[str]:
    """Yield which limits the time step is beyond."""
    step = case.time.step
    limits = {
        "acoustic": (acoustic_limit(case), "1.5 h / c0, Eq. 2.19"),
        "viscous": (viscous_limit(case), "0.125 h^2 / nu, beside walls at most 0.22 h dx / nu"),
        "body-force": (force_limit(case), "0.25 sqrt(h / b)"),
    }
    for name, (limit, formula) in limits.items():
        if step != "auto" and step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            yield f"{step:g} s is beyond the {name} limit of {limit:.4g} s ({formula})"
