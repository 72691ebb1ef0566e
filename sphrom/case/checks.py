"""Checks of the rules between sections of a case; each section checks its own keys.

The loader calls `case_problems`. A check yields a key, such as `rom.0.basis`, and its problem.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np
import shapely
from shapely.affinity import translate

from sphrom.case import studies
from sphrom.case.custom_sections import SurfaceForce
from sphrom.case.measure_sections import MEASURES, FrequencyMeasure
from sphrom.case.models import Case
from sphrom.case.plan import LEAST_SNAPSHOTS
from sphrom.case.plan_times import MAX_STEPS, STEPS_PER_PERIOD, WHOLE_STEPS_TOLERANCE
from sphrom.case.points import REYNOLDS, ParameterPoint, nearest_point
from sphrom.case.sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.study_sections import FULL, ErrorFigure, FieldFigure, ModeFigure, OfModes, OfRuns
from sphrom.case.yaml_reader import Problem
from sphrom.errors import CaseError, SphromError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import ROUNDING
from sphrom.sph.polygons import periodic_shifts
from sphrom.text import exact, nearest, repeated

Found = Iterator[tuple[str, str]]

MOST_REFINED = 4
"""Largest factor of the resolution that is a remedy for a narrow place."""
COARSEST = 8
"""The lowest resolution."""
MOST_POINTS, MOST_COUNTED = 2e10, 2e7
"""Most points of a lattice over the box, and over one whose particles are counted one by one."""


def case_problems(case: Case, *, force: bool = False) -> list[Problem]:
    """Return the problems of a case; `force` accepts an unstable time step."""
    limits = () if force else (_check_limits,)
    # Later checks need valid names and sizes, and then valid steps and points.
    first = (_check_size, _check_names, _check_histories)
    for checks in (first, (_check_points,), (*_CHECKS, *limits), _SNAPSHOT_CHECKS):
        if problems := [problem for check in checks for problem in check(case)]:
            return [Problem(_path(key), reason) for key, reason in problems]
    return []


def _path(key: str) -> tuple[str | int, ...]:
    return tuple(int(part) if part.isdecimal() else part for part in key.split("."))


def _check_size(case: Case) -> Found:
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


def _check_names(case: Case) -> Found:
    """Check that all names that sections refer to exist in the case."""
    for key, kind, names, known in _references(case):
        for name in names:
            if name is not None and name not in known:
                yield key, f"no {kind} has the name {name}; {nearest(name, known)}"
    yield from _check_reynolds(case)
    for name, reason in case.scene.parameter_problems(case.plan.parameter_names):
        yield f"parameters.{name}", f"can't vary: {reason}"


def _check_reynolds(case: Case) -> Found:
    """Check that all points name the Reynolds number if training runs have several."""
    named: dict[str, Iterable[Collection[str]]] = {"parameters.test": case.parameters.test.named}
    if REYNOLDS not in case.plan.own_values:
        named |= {"parameters.train": case.parameters.train.named, "sweep": case.sweep.named}
        for i, model in enumerate(case.rom):
            # Numbers in a list are Reynolds numbers.
            named[f"rom.{i}.parameters"] = [v for v in model.parameters if isinstance(v, dict)]
    elif REYNOLDS not in case.training.ranges:
        return
    for key, points in named.items():
        if any(REYNOLDS not in names for names in points):
            yield f"{key}.{REYNOLDS}", "is missing, and training runs have several; give it"


def _references(case: Case) -> Iterator[tuple[str, str, Collection[str | None], Collection[str]]]:
    """Yield a key, the kind of its names, these names, and the existing names."""
    models = [model.name for model in case.rom]
    fast = [model.name for model in case.rom if model.from_operators]
    bases, parameters, varied = (ALL, *case.basis.subsets), "parameter", "parameter that varies"
    own = (REYNOLDS, *case.plan.own_values)
    varying = case.plan.parameter_names
    yield "parameters.train", parameters, case.parameters.train.names, own
    yield "parameters.test", parameters, case.parameters.test.names, own
    for name, subset in case.basis.subsets.items():
        yield f"basis.subsets.{name}.box", varied, subset.box or (), varying
    for i, model in enumerate(case.rom):
        yield f"rom.{i}.basis", "basis", [model.basis], (*bases, LOCAL)
        for values in () if isinstance(model.parameters, str) else model.parameters:
            if isinstance(values, dict):
                yield f"rom.{i}.parameters", varied, values, varying
    for i, figure in enumerate(case.compare.figures):
        if isinstance(figure, OfModes):
            yield f"compare.figures.{i}.basis", "basis", [figure.basis], bases
        else:
            known = [*models, FULL] if isinstance(figure, FieldFigure) else models
            names = list(dict.fromkeys(name for row in figure.runs for name in row))
            yield f"compare.figures.{i}.runs", "run", names, known
    for name, measured in case.scene.measure.items():
        if isinstance(measured, FrequencyMeasure):
            of = measured.frequency.of
            yield f"scene.measure.{name}.frequency.of", "history", [of], case.scene.columns
    yield "trade.measure", "quantity of scene.measure", [case.trade.measure], case.scene.measure
    yield "sweep.model", "model", [case.sweep.model], [FULL, *models]
    yield "sweep", varied, case.sweep.names, varying
    yield "fit.model", "model with evaluation: operators", [case.fit.model], fast
    yield "fit.parameters", varied, case.fit.parameters, varying
    yield "training.model", "model with evaluation: operators", [case.training.model], fast
    yield "training", "key or parameter", case.training.ranges, own


def _check_points(case: Case) -> Found:
    """Check that full runs differ in their values, and that each is possible."""
    train = case.plan.train_points
    test = case.plan.test_points
    for key, points in (("parameters.train", train), ("parameters.test", test)):
        yield from _check_repeated(key, points)
        for others in dict.fromkeys(point.others for point in points):
            try:
                case.plan.scene.check_at(dict(others))
            except ValueError as error:
                values = ", ".join(f"{name}={exact(value)}" for name, value in others)
                where, _, reason = str(error).partition(": ")
                yield (key, f"{values}: {error}") if values else (f"scene.{where}", reason)
                break
    for point in filter(set(train).__contains__, test):
        yield "parameters.test", f"{point.label} is a training value; test other values"


def _check_repeated(key: str, points: Iterable[ParameterPoint]) -> Found:
    for label in repeated(point.label for point in points):
        yield key, f"{label} is listed more than once"


def _check_geometry(case: Case) -> Found:
    domain = case.scene.domain
    length = case.scene.resolved_length
    plan = case.plan
    section = case.discretization
    wanted = length / section.resolution
    fits = domain.narrowest_gap > 0.0 and domain.fits_lattice(wanted)
    if domain.narrowest_gap <= 0.0:
        yield "scene", "its lengths differ so much that the smallest one is lost in rounding"
    elif not fits:
        reason = f"a spacing of {wanted:g} m doesn't divide all lengths of the scene to 0.5 %"
        nearest_one = nearest_fitting_resolution(case) or "none that is near"
        yield "discretization.resolution", f"{reason}; {nearest_one} does"
    for level in sorted({case.scene.level_at(dict(point.others)) for point in plan.points}):
        if not math.isfinite(level) or not domain.fills_box:
            continue
        pitch = domain.pitches(plan.particle_spacing)[1] if fits else wanted
        if (end := domain.row_end(level, pitch)) != level:
            reason = f"rows of particles {pitch:g} m apart don't end at {level:g} m"
            yield "scene.fluid.level", f"{reason}; they do at {end:g} m"
    if case.scene.has_surface and not plan.n_particles:
        yield "scene.fluid", "no particle is in it; raise discretization.resolution"
    if case.scene.has_surface and section.shifting.enabled:
        yield "discretization.shifting.enabled", "moves fluid out of a free surface; leave it out"
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
    for key, along_axes in {"no_slip": "paper", "continuity": "normal"}.items():
        shapes = domain.has_walls and not plan.walls_fit_lattice
        if shapes and getattr(section.walls, key) == along_axes:
            yield f"discretization.walls.{key}", f"{along_axes} is for walls that follow the axes"
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
        remedy = f"discretization.resolution: {next(enough, least)} would do"
        if least > MOST_REFINED * section.resolution:
            remedy = f"make it at least {radius:.3g} m thick"
            if most < solid:
                nearest_walls = narrow_place(domain, 2.0 * radius)
                remedy = nearest_walls or f"make it at least {2.0 * radius:.3g} m wide"
        yield (
            f"{'reference' if mapped > own else 'discretization'}.smoothing_length_ratio",
            f"a support of radius {radius:g} m is larger than {limit}: {remedy}",
        )


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
    remedy = "let them overlap, join them to one solid by `union`"
    if other in lines:
        remedy = f"let {name} dip into the wall"
    between = f"at ({x:.4g}, {y:.4g}) m, between {name} and {other}"
    return f"{between}: {remedy}, or leave {width:.3g} m between them"


def _images(domain: Domain, lines: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the sides of the box, and the solids with their periodic images, by name."""
    yield from lines.items()
    for shift in periodic_shifts(domain.lengths, domain.periodic):
        yield from ((name, translate(shape, *shift)) for name, shape in domain.polygons)


def nearest_fitting_resolution(case: Case) -> int | None:
    """Return the nearest resolution at which walls fit the lattice, or None if none is near."""
    domain = case.scene.domain
    length = case.scene.resolved_length
    resolution = case.discretization.resolution
    half = case.discretization.resolution // 2
    near = range(resolution - half + 1, 2 * resolution + 1)
    fitting = (number for number in near if domain.fits_lattice(length / number))
    return min(fitting, key=lambda number: (abs(number - resolution), -number), default=None)


def coarser_resolution(case: Case) -> int | None:
    """Return half the resolution, or None if particles would not fit the scene."""
    half = case.discretization.resolution // 2
    fits = half >= COARSEST and not any(_check_geometry(studies.at_resolution(case, half)))
    return half if fits else None


def _check_steps(case: Case) -> Found:
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
            if (problem := _not_whole(duration, time.step)) is not None:
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


def _not_whole(duration: float, step: float) -> str | None:
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
    stable = case.plan.limits
    limits = {
        "acoustic": (stable.acoustic, "1.5 h / c0, Eq. 2.19"),
        "viscous": (stable.viscous, "0.125 h^2 / nu, beside walls at most 0.22 h dx / nu"),
    }
    for name, (limit, formula) in limits.items():
        if step != "auto" and step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            yield f"{step:g} s is beyond the {name} limit of {limit:.4g} s ({formula})"


def _check_limits(case: Case) -> Found:
    for reason in beyond_limits(case):
        yield "time.step", f"{reason}; --force accepts it"


def _check_histories(case: Case) -> Found:
    for name, reason in case.scene.unknown_times(case.time.final_time):
        yield f"scene.{name}", reason


def _check_scene(case: Case) -> Found:
    for name, reason in case.plan.problems_until(case.time.final_time):
        yield f"scene.{name}", reason
    for name, measured in case.scene.measure.items():
        if (problem := measured.time_problem(case) or measured.problem(case)) is not None:
            yield f"scene.measure.{name}.{MEASURES.kind_of(measured)}", problem


def _check_bases(case: Case) -> Found:
    for name in repeated(name.casefold() for name in (ALL, LOCAL, *case.basis.subsets)):
        yield "basis.subsets", f"the name {name} is taken"
    trained = {point.reynolds for point in case.plan.train_points}
    for name, subset in case.basis.subsets.items():
        if not case.plan.bases[name]:
            yield f"basis.subsets.{name}", "none of the training values is in it"
        for value in set(subset.reynolds or ()) - trained:
            yield f"basis.subsets.{name}.reynolds", f"reynolds={exact(value)} is not trained on"


def _check_splines(case: Case) -> Found:
    """Refuse B-splines unless the reference points are a lattice that fills a box."""
    if not case.plan.lattice_splines:
        return
    if not case.scene.domain.fills_box:
        yield "psi.kind", "B-splines need fluid that fills the box; set psi.kind: polyharmonic"
    elif not case.plan.reference_lattice:
        yield "psi.kind", "B-splines need points of a lattice; set reference.points: lattice"
    if case.psi.order != type(case.psi).model_fields["order"].default:
        yield "psi.order", "is only for kind: polyharmonic, and auto means b-spline here"


def _check_models(case: Case) -> Found:
    for name in repeated(model.name.casefold() for model in case.rom):
        yield "rom", f"two reduced models have the name {name}"
    for i, model in enumerate(case.rom):
        yield from ((f"rom.{i}.{key}", reason) for key, reason in _model_problems(case, model))


def _model_problems(case: Case, model: ReducedModelSection) -> Found:
    plan = case.plan
    points = case.plan.rom_points(model)
    try:
        bases = plan.bases_for(model)
    except CaseError as error:
        yield "basis", str(error)
        return
    if model.from_operators and model.has_memory and plan.driving:
        reason = f"{model.projection} has operators for the viscosity alone, and"
        yield "projection", f"{reason} {plan.driving[0]} varies too; set projection: galerkin"
    if model.steady and (problem := steady_problem(case)) is not None:
        yield "steady", problem
    if not points:
        yield "parameters", f"there are no {model.parameters} values"
    if not isinstance(model.parameters, str):
        yield from _check_repeated("parameters", points)
        for point in () if model.from_operators else points:
            if point not in plan.points:
                closest = nearest_point(point, plan.points).label
                yield "parameters", f"{point.label} has no full run; the nearest is {closest}"
    if not model.from_operators:
        return
    alone = [name for name in bases if len(plan.bases[name]) == 1]
    if model.corrected is True and alone:
        yield "corrected", f"the basis {alone[0]} has one training run; two or more are needed"
    predicts = model.integrated_modes != AUTO and model.integrated_modes < model.size
    if predicts and not all(plan.is_corrected(model, name) for name in bases):
        reason = "only corrected models predict their other modes from training runs: it needs"
        yield "integrated_modes", f"{reason} corrected: auto and bases of two or more runs"


def steady_problem(case: Case) -> str | None:
    """Return the reason why a case has no steady states, or None."""
    force = case.plan.flow(case.plan.points[0]).body_force
    if case.scene.amplitudes:
        return "walls' velocities change with time, so there is no steady state"
    if force is None or not force.changes:
        return None
    return "the body force changes with time, so there is no steady state"


def _check_fixed_points(case: Case) -> Found:
    """Refuse variants of the equations that models on the reference points don't support."""
    section = case.discretization
    fast = (model.name for model in case.rom if model.from_operators)
    name = None if case.scene.has_surface else next(fast, None)
    for key, value, needed in (
        ("viscosity", section.viscosity, "laplacian"),
        ("walls.continuity", section.walls.continuity, "adjoint"),
        ("walls.no_slip", section.walls.no_slip, "linear"),
    ):
        if name is not None and value != needed:
            reason = f"must be {needed} for models with evaluation: operators, such as {name}"
            yield f"discretization.{key}", f"{reason}; got {value}"
    amplitudes = case.scene.amplitudes
    if name is not None and len(set(amplitudes.values())) > 1:
        found = " and ".join(f"{text} of {key}" for key, text in amplitudes.items())
        reason = f"must all have one amplitude in time, like forces, for models such as {name}"
        yield "scene.walls", f"{reason}; got {found}; set rom: [] for full runs alone"


def _check_surface(case: Case) -> Found:
    """Refuse scenes and keys that reduced models of a free surface don't support."""
    scene = case.scene
    domain = case.scene.domain
    if not (scene.has_surface and case.rom):
        return
    reason = "reduced models of a free surface"
    whole, plain = "are for a tank without solids, whose sides are walls", "is not for"
    if not domain.fills_box or any(domain.periodic):
        yield "scene", f"{reason} {whole}; set rom: []"
    if scene.largest_resistance(1.0):
        yield "scene.resistance", f"{plain} {reason}; leave it out"
    if not scene.gravity > 0.0:
        yield "scene.fluid.gravity", f"must be above zero for {reason}; got 0"
    for point in () if case.time.spin_up else case.plan.points:
        if domain.fills_box and (problem := _start_problem(case, point)) is not None:
            yield "scene.fluid", f"{point.label}: at the start, {problem}; set rom: []"
            break
    for point in case.plan.points[:1]:
        force = case.plan.flow(point).body_force
        parts = force.parts if isinstance(force, SurfaceForce) else ()
        if any(part.depends_on & {"x", "y"} for part in parts):
            yield "scene.body_force", f"must not depend on x and y for {reason}"
    if case.basis.subsets:
        yield "basis.subsets", f"{plain} {reason}, which have one basis; leave it out"
    if case.training.ranges:
        yield "training", f"needs estimates of errors, which {reason} don't have; leave it out"
    if case.sweep.sensitivities:
        yield "sweep.sensitivities", f"{plain} {reason}; set false"


def _start_problem(case: Case, point: ParameterPoint) -> str | None:
    """Return the reason why the fluid's shape at the start of a run is no graph, or None."""
    plan = case.plan
    scene = case.scene
    if math.isfinite(scene.level_at(point.factors)) or not plan.n_particles:
        return None
    from sphrom.metrics.elevation import find_elevation  # few cases need its slow imports

    position = scene.fill(plan.particle_spacing, point.factors)
    space = plan.stream_space
    volume = np.full(len(position), plan.particle_spacing**2)
    radius = 2.0 * plan.smoothing_length
    walls = space.left, space.right, space.bottom
    try:
        find_elevation(position, volume, plan.surface_columns, radius, walls)
    except SphromError as error:
        text = str(error).rstrip(".").replace("The column", "the column")
        return f"{text}, and reduced models need one surface above each x"
    return None


def _check_training_runs(case: Case) -> Found:
    """Refuse models that training runs can't teach anything."""
    plan = case.plan
    # A box of fluid that nothing describes yet is a template.
    is_template = case.scene == type(case.scene).model_validate({"kind": case.scene.kind})
    asked = "rom" in case.model_fields_set and case.rom and not is_template
    if asked and not any(map(plan.is_driven, plan.train_points)):
        reason = "nothing drives the fluid in any training run, so that there are no modes"
        yield "parameters.train", f"{reason}; drive it, or set rom: []"
    if plan.reference_bases and plan.driving:
        try:
            _ = plan.rest_and_units
        except CaseError as error:
            key, _, reason = str(error).partition(": ")
            yield key, reason
    short = plan.steps.n_snapshots < LEAST_SNAPSHOTS and not case.scene.has_surface
    for i, model in enumerate(case.rom if short else ()):
        key = "calibrated" if model.calibrated is True else "n_modes"
        if model.from_operators and (model.calibrated is True or model.n_modes == AUTO):
            needed = f"needs training runs of {LEAST_SNAPSHOTS} snapshots or more"
            yield f"rom.{i}.{key}", f"{_yaml(getattr(model, key))} {needed}; see snapshots.every"


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _check_modes(case: Case) -> Found:
    plan = case.plan
    # The default model of a case without `rom` is adjusted later.
    listed = case.rom if "rom" in case.model_fields_set else ()
    asked: list[tuple[str, Any, list[str]]] = [("basis.n_modes", case.basis.n_modes, [ALL])]
    asked += [(f"rom.{i}.n_modes", m.n_modes, plan.bases_for(m)) for i, m in enumerate(listed)]
    for i, figure in enumerate(case.compare.figures):
        if isinstance(figure, ModeFigure):
            asked.append((f"compare.figures.{i}.modes", max(figure.modes), [figure.basis]))
    for key, n_modes, bases in asked:
        smallest = min(bases, key=plan.n_basis_snapshots)
        most = plan.n_basis_snapshots(smallest)
        if n_modes == AUTO:
            if not case.scene.has_surface and not all(map(plan.has_error_estimate, bases)):
                remedy = "set operators.error_estimate: true, or a smaller basis.n_modes"
                yield key, f"auto needs the errors of training runs: {remedy}"
        elif (n_modes or 0) > most:
            reason = f"must be at most the number of snapshots of basis {smallest}, {most}"
            yield key, f"{reason}; got {n_modes}"
        elif (n_modes or 0) > plan.n_modes:
            yield key, f"must be at most basis.n_modes, {plan.n_modes}; got {n_modes}"


def _check_reduced_times(case: Case) -> Found:
    for i, model in enumerate(case.rom):
        try:
            end = case.plan.model_steps(model).end_time
            if model.until is not None:
                problems = case.plan.problems_until(end)
                yield from ((f"rom.{i}.until", f"scene.{key}: {why}") for key, why in problems)
        except CaseError as error:
            yield f"rom.{i}.until", str(error).removeprefix("final_time: ")
        if not isinstance(model.time_step, str):
            reason = _not_whole(case.plan.steps.snapshot_interval, model.time_step)
            yield from () if reason is None else ((f"rom.{i}.time_step", reason),)
            for point in case.plan.rom_points(model):
                if model.time_step > (longest := case.plan.longest_step(point)) * (1.0 + ROUNDING):
                    reason = f"{point.label}: the driving needs steps of at most {longest:.4g} s"
                    yield f"rom.{i}.time_step", reason
                    break


def _check_compare(case: Case) -> Found:
    section = case.compare
    domain = case.scene.domain
    end = case.time.final_time
    if section.from_time >= end:
        reason = f"must be before time.final_time, {exact(end)} s; got {exact(section.from_time)}"
        yield "compare.from_time", reason
    if section.exact and case.plan.flow(case.plan.points[0]).exact is None:
        yield "compare.exact", f"a scene of kind {case.scene.kind} has no exact solution"
    left = domain.lower[0]
    right = domain.upper[0]
    line = case.plan.probe_line
    if not left < line < right:
        reason = f"must be within the scene, between {left:g} and {right:g} m; got {line:g}"
        yield "compare.line", reason
    elif not domain.sections(line):
        yield "compare.line", f"there is no fluid at x = {line:g} m; give another x"
    strip = case.plan.strip
    if strip is not None and strip.axis == 0 and strip.start < line < strip.end:
        reason = f"x = {line:g} m is in the strip of the inflow; set it downstream of it"
        yield "compare.line", reason
    for name in repeated(figure.name.casefold() for figure in section.figures):
        yield "compare.figures", f"two figures have the name {name}"
    for i, figure in enumerate(section.figures):
        problems = _figure_problems(case, figure)
        yield from ((f"compare.figures.{i}.{key}", reason) for key, reason in problems)


def _figure_problems(case: Case, figure: OfModes | OfRuns) -> Found:
    start = case.time.spin_up
    end = case.time.final_time
    if isinstance(figure, OfModes):
        return
    for names, (_, points) in zip(figure.runs, studies.rows_of(case, figure), strict=True):
        missing = set(figure.reynolds or ()) - {point.reynolds for point in points}
        if missing or not points:
            at = f"at {exact(min(missing))} " if missing else ""
            yield "runs", f"{' and '.join(names)}: not run {at}beside a full run"
    if not isinstance(figure, ErrorFigure) and not start <= figure.time <= end:
        within = f"{exact(start)} s to {exact(end)} s"
        yield "time", f"must be within the recorded time, {within}; got {exact(figure.time)}"


def _check_trade(case: Case) -> Found:
    section = case.trade
    plan = case.plan
    if (size := max(section.n_modes or (0,))) > plan.n_modes:
        reason = f"must be at most basis.n_modes, {plan.n_modes}; got {size}"
        yield "trade.n_modes", reason
    for resolution in section.resolutions or ():
        for _, reason in _check_geometry(studies.at_resolution(case, resolution)):
            yield "trade.resolutions", f"{resolution}: {reason}"


def _check_sweep(case: Case) -> Found:
    model = studies.sweep_model(case)
    points = studies.sweep_points(case)
    steps = case.plan.steps
    if case.sweep.sensitivities and (model is None or not model.from_operators):
        reason = "needs a model with evaluation: operators, whose equations can be differentiated"
        yield "sweep.sensitivities", reason
    yield from _check_repeated("sweep", points)
    if model is None and points:
        thickest = min(points, key=lambda point: point.reynolds)
        limit = case.plan.step_limits(thickest).viscous
        if steps.time_step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            reason = f"is stable with steps below {limit:.4g} s only, and full runs of this case"
            remedy = "lower time.step, or list it in parameters.test"
            took = f"take steps of {steps.time_step:.4g} s"
            yield "sweep.reynolds", f"{thickest.label} {reason} {took}: {remedy}"
    elif model is not None:
        try:
            for point in points:
                studies.require_basis(case, model, point)
        except CaseError as error:
            yield "sweep", str(error)


def _check_training(case: Case) -> Found:
    section = case.training
    plan = case.plan
    model = studies.fast_section(case, section.model)
    if not section.ranges:
        return
    for name in plan.parameter_names:
        several = len({point.as_dict()[name] for point in plan.train_points}) > 1
        if name not in section.ranges and (several or name != REYNOLDS):
            yield "training", f"{name} varies in parameters; give its range, too, or one value"
    if (least := len(studies.Region(case).starts(())) + 1) > section.budget:
        reason = f"training starts from {least - 1} full runs, and tests its model at one more"
        yield "training.budget", f"must be at least {least}: {reason}; got {section.budget}"
    if model is None:
        yield "training", "needs a model with evaluation: operators, and rom has none"
    elif not plan.ends_with_case(model):
        reason = "has runs that end at another time than full runs; leave out until"
        yield "training", f"{model.name} {reason}"
    elif case.operators.error_estimate is False:
        reason = "training needs error estimates; leave it out, or set true"
        yield "operators.error_estimate", reason


_CHECKS: tuple[Callable[[Case], Found], ...] = (
    _check_geometry,
    _check_scene,
    _check_splines,
    _check_steps,
    _check_bases,
    _check_models,
    _check_fixed_points,
    _check_surface,
    _check_compare,
)
_SNAPSHOT_CHECKS: tuple[Callable[[Case], Found], ...] = (
    _check_training_runs,
    _check_modes,
    _check_reduced_times,
    _check_trade,
    _check_sweep,
    _check_training,
)
