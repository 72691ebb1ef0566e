"""Checks of bases, splines and reduced models.

They yield a key, such as `rom.0.basis`, and its problem; `sphrom.case.checks` calls them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from sphrom.case.custom_sections import SurfaceForce
from sphrom.case.discretization_checks import not_whole
from sphrom.case.model_sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.plan import LEAST_SNAPSHOTS
from sphrom.case.points import ParameterPoint, nearest_point
from sphrom.case.study_sections import ModeFigure
from sphrom.errors import CaseError, SphromError
from sphrom.sph.fluid import ROUNDING
from sphrom.sph.walls.kinds import KINDS
from sphrom.text import exact, repeated

Found = Iterator[tuple[str, str]]


def check_repeated(key: str, points: Iterable[ParameterPoint]) -> Found:
    for label in repeated(point.label for point in points):
        yield key, f"{label} is listed more than once"


def check_bases(case: Case) -> Found:
    for name in repeated(name.casefold() for name in (ALL, LOCAL, *case.basis.subsets)):
        yield "basis.subsets", f"the name {name} is taken"
    trained = {point.reynolds for point in case.plan.train_points}
    for name, subset in case.basis.subsets.items():
        if not case.plan.bases[name]:
            yield f"basis.subsets.{name}", "none of the training values is in it"
        for value in set(subset.reynolds or ()) - trained:
            yield f"basis.subsets.{name}.reynolds", f"reynolds={exact(value)} is not trained on"


def check_splines(case: Case) -> Found:
    """Refuse B-splines unless the reference points are a lattice that fills a box."""
    if not case.plan.lattice_splines:
        return
    if not case.scene.domain.fills_box:
        yield "psi.kind", "B-splines need fluid that fills the box; set psi.kind: polyharmonic"
    elif not case.plan.reference_lattice:
        yield "psi.kind", "B-splines need points of a lattice; set reference.points: lattice"
    if case.psi.order != type(case.psi).model_fields["order"].default:
        yield "psi.order", "is only for kind: polyharmonic, and auto means b-spline here"


def check_models(case: Case) -> Found:
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
    if model.settles_on_cycles:
        trained = (point for name in bases for point in plan.bases[name])
        if not any(plan.is_driven(point, after_start=True) for point in trained):
            reason = "nothing drives the fluid after the start, so it comes to rest"
            yield "calibrated", f"cycle needs periodic training runs, but {reason}"
    if model.steady and (problem := steady_problem(case)) is not None:
        yield "steady", problem
    if not points:
        yield "parameters", f"there are no {model.parameters} values"
    if not isinstance(model.parameters, str):
        yield from check_repeated("parameters", points)
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


def check_fixed_points(case: Case) -> Found:
    """Refuse variants of the equations that models on the reference points don't support."""
    section = case.discretization
    fast = (model.name for model in case.rom if model.from_operators)
    name = None if case.scene.has_surface else next(fast, None)
    for key, value, needed in (
        ("viscosity", section.viscosity, ["laplacian"]),
        ("walls.kind", section.walls.kind, [x for x in KINDS if KINDS[x].at_fixed_points]),
    ):
        if name is not None and value not in needed:
            choices = " or ".join(needed)
            reason = f"must be {choices} for models with evaluation: operators, such as {name}"
            yield f"discretization.{key}", f"{reason}; got {value}"
    for label, term in case.scene.added.items() if name is not None else ():
        reason = f"models with evaluation: operators, such as {name}"
        if term.acceleration is not None:
            remedy = "give a linear or quadratic one, or set rom: []"
            yield (
                f"scene.terms.{label}",
                f"its acceleration is any function, unlike {reason}; {remedy}",
            )
        if case.scene.measured_walls:
            remedy = "leave force_on out, or set rom: []"
            yield (
                f"scene.terms.{label}",
                f"would be missing in the forces on walls of {reason}; {remedy}",
            )
    amplitudes = case.scene.amplitudes
    if name is not None and len(set(amplitudes.values())) > 1:
        found = " and ".join(f"{text} of {key}" for key, text in amplitudes.items())
        reason = f"must all have the same amplitude in time, like forces, for models such as {name}"
        yield "scene.walls", f"{reason}; got {found}; set rom: [] for full runs alone"


def check_surface(case: Case) -> Found:
    """Refuse scenes and keys that reduced models of a free surface don't support."""
    scene = case.scene
    domain = case.scene.domain
    if not (scene.has_surface and case.rom):
        return
    reason = "reduced models of a free surface"
    whole, plain = "are for a tank without solids, whose sides are walls", "is not for"
    if not domain.fills_box or any(domain.periodic):
        yield "scene", f"{reason} {whole}; set rom: []"
    if scene.added:
        yield "scene.terms", f"{plain} {reason}; set rom: []"
    elif scene.largest_resistance(1.0):
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


def check_training_runs(case: Case) -> Found:
    """Refuse models whose training runs contain no motion to learn from."""
    plan = case.plan
    # A box of fluid that nothing describes yet is a template.
    is_template = case.scene == type(case.scene).model_validate({"kind": case.scene.kind})
    asked = "rom" in case.model_fields_set and case.rom and not is_template
    if asked and not any(map(plan.is_driven, plan.train_points)):
        reason = "nothing drives the fluid in any training run, so that there are no modes"
        remedy = (
            "drive it, let it start in motion (scene.initial: u and v, or {file: first.csv} with "
            "the first snapshot of runs that are imported), or set rom: []"
        )
        yield "parameters.train", f"{reason}; {remedy}"
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


def check_modes(case: Case) -> Found:
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


def check_reduced_times(case: Case) -> Found:
    for i, model in enumerate(case.rom):
        try:
            end = case.plan.model_steps(model).end_time
            if model.until is not None:
                problems = case.plan.problems_until(end)
                yield from ((f"rom.{i}.until", f"scene.{key}: {why}") for key, why in problems)
        except CaseError as error:
            yield f"rom.{i}.until", str(error).removeprefix("final_time: ")
        if not isinstance(model.time_step, str):
            reason = not_whole(case.plan.steps.snapshot_interval, model.time_step)
            yield from () if reason is None else ((f"rom.{i}.time_step", reason),)
            for point in case.plan.rom_points(model):
                if model.time_step > (longest := case.plan.longest_step(point)) * (1.0 + ROUNDING):
                    reason = f"{point.label}: the driving needs steps of at most {longest:.4g} s"
                    yield f"rom.{i}.time_step", reason
                    break
