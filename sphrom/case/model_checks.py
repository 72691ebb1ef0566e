"""What must hold between the bases, models, figures and studies of a case, and the rest of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sphrom.case.messages import Path, Problem, nearest
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS, WHOLE_STEPS_TOLERANCE, local_problem
from sphrom.case.points import REYNOLDS, ParameterPoint, impossible, near
from sphrom.case.sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.studies import rows_of, sweep_model, sweep_points, training_model
from sphrom.case.study_sections import FULL, ErrorFigure, FieldFigure, ModeFigure, OfModes, OfRuns
from sphrom.errors import CaseError
from sphrom.text import exact, repeated

_VALUES: Path = ("sweep", "reynolds")


def check_bases(case: Case) -> Iterator[Problem]:
    """Check names of bases, and that each learns from training values."""
    for name in repeated(name.casefold() for name in (ALL, LOCAL, *case.basis.subsets)):
        yield Problem(("basis", "subsets"), f"the name {name} is taken")
    trained = {point.reynolds for point in case.plan.train_points}
    for name, subset in case.basis.subsets.items():
        where: Path = ("basis", "subsets", name)
        if not case.plan.bases[name]:
            yield Problem(where, "none of the training values is in it")
        for value in subset.reynolds or ():
            if value not in trained:
                nearest_one = near(ParameterPoint(value), map(ParameterPoint, sorted(trained)))
                reason = f"reynolds={exact(value)} is not trained on; {nearest_one}"
                yield Problem((*where, "reynolds"), reason)


def check_splines(case: Case) -> Iterator[Problem]:
    """Refuse B-splines where points are no lattice that fills a box."""
    if not case.plan.lattice_splines:
        return
    scene, points = case.scene.kind, case.reference.points
    if not case.scene.domain.fills_box:
        yield Problem(
            ("psi", "kind"),
            f"B-splines are for fluid that fills a box, and the {scene}'s does not; set "
            "psi.kind: polyharmonic",
        )
    elif not case.plan.reference_lattice:
        yield Problem(
            ("psi", "kind"),
            f"B-splines are for points of a lattice, and with reference.points: {points} these "
            "are not; set reference.points: lattice",
        )
    here = ", and auto means b-spline here" if case.psi.kind == "auto" else ""
    if case.psi.order != type(case.psi).model_fields["order"].default:
        yield Problem(("psi", "order"), f"is only for kind: polyharmonic{here}")


def check_reduced_models(case: Case) -> Iterator[Problem]:
    """Check the names, bases and values of each reduced model."""
    for name in repeated(model.name.casefold() for model in case.rom):
        yield Problem(("rom",), f"two reduced models have the name {name}")
    for i, model in enumerate(case.rom):
        path = ("rom", i)
        yield from _check_basis(case, model, (*path, "basis"))
        if model.from_operators and model.has_memory and case.plan.driving:
            yield Problem(
                (*path, "projection"),
                f"{model.projection} has operators for the viscosity alone, and "
                f"{' and '.join(case.plan.driving)} vary too; set projection: galerkin, or "
                "evaluation: particles",
            )
        if model.steady and (reason := steady_problem(case)) is not None:
            yield Problem((*path, "steady"), reason)
        yield from _check_values(case, model, (*path, "parameters"))
        yield from _check_taught(case, model, path)


def steady_problem(case: Case) -> str | None:
    """Return why a case has no steady states, or None."""
    if case.plan.largest_body_force > 0.0 and case.scene.drive_changes:
        return "the scene's body force changes with time: there is no steady state"
    return None


def basis_problem(case: Case, model: ReducedModelSection, point: ParameterPoint) -> str | None:
    """Return why a model has no basis at a point that it may not be run at in the case, or None."""
    if model.basis != LOCAL:
        return None
    found = case.plan.local_bases(point)
    if len(found) != 1:
        return local_problem(point, found)
    if model.from_operators and found[0] not in case.plan.reference_bases:
        return (
            f"{point.label} has the local basis {found[0]}, at none of whose values {model.name} "
            "is run, so that it has no operators"
        )
    return None


def _check_values(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Check where a model is run: on particles, where a full run is."""
    points = case.plan.rom_points(model)
    listed = () if isinstance(model.parameters, str) else points
    for label in repeated(point.label for point in listed):
        yield Problem(path, f"{label} stands more than once")
    for point in listed:
        if point not in case.plan.points and model.on_particles:
            yield Problem(
                path,
                f"{point.label} is in neither parameters.train nor parameters.test; "
                f"{near(point, case.plan.points)}",
            )
    if not points:
        yield Problem(path, f"there are no {model.parameters} values")


def _check_basis(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    if model.basis == LOCAL:
        for point in case.plan.rom_points(model):
            found = case.plan.local_bases(point)
            if len(found) != 1:
                yield Problem(path, local_problem(point, found))
                return
    elif model.basis not in case.plan.bases:
        hint = nearest(model.basis, (*case.plan.bases, LOCAL))
        yield Problem(path, f"no basis has the name {model.basis}; {hint}")


def _check_taught(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Refuse to correct a model, or predict some of its modes, by a single training run."""
    if not model.from_operators:
        return
    names = {model.basis} if model.basis != LOCAL else set(case.basis.subsets)
    known = sorted(names & set(case.plan.bases))
    alone = [name for name in known if len(case.plan.bases[name]) == 1]
    if model.corrected is True and alone:
        reason = f"the basis {alone[0]} learns from one run; two or more are needed"
        yield Problem((*path, "corrected"), reason)
    integrated = model.integrated_modes
    uncorrected = [name for name in known if not case.plan.is_corrected(model, name)]
    if integrated != AUTO and integrated < model.size and uncorrected:
        yield Problem(
            (*path, "integrated_modes"),
            "training runs predict the other modes where a model is corrected: it needs "
            f"corrected: auto and a basis that learns from two runs or more, unlike "
            f"{uncorrected[0]}",
        )


def check_fixed_points(case: Case) -> Iterator[Problem]:
    """Refuse readings of the paper that models on the reference points don't have."""
    listed = case.rom if "rom" in case.model_fields_set else ()
    names = [model.name for model in listed if model.from_operators]
    for path, given, needed in _readings(case) if names else ():
        yield Problem(
            ("discretization", *path),
            f"must be {needed} for models on the reference points, such as {names[0]}; got {given}",
        )


def _readings(case: Case) -> list[tuple[Path, str, str]]:
    """Return key, value and what models on the reference points need, where it differs."""
    section = case.discretization
    readings: tuple[tuple[Path, str, str], ...] = (
        (("viscosity",), section.viscosity, "laplacian"),
        (("walls", "continuity"), section.walls.continuity, "adjoint"),
        (("walls", "no_slip"), section.walls.no_slip, "linear"),
    )
    return [reading for reading in readings if reading[1] != reading[2]]


def with_fitting_model(case: Case) -> Case:
    """Return a valid case, its model as its other keys allow where it lists none.

    That is one with operators, on particles where the full model is read in a way that the
    reference points don't have, and with no more modes than there are snapshots.
    """
    if "rom" in case.model_fields_set:
        return case
    (model,) = case.rom
    if _readings(case):
        model = ReducedModelSection(name="galerkin")
    most = min(model.n_modes, case.basis.n_modes or model.n_modes, case.plan.n_basis_snapshots(ALL))
    return case.model_copy(update={"rom": (model.model_copy(update={"n_modes": most}),)})


def check_modes(case: Case) -> Iterator[Problem]:
    """Check numbers of modes against snapshots and the basis."""
    if (case.basis.n_modes or 0) > case.plan.n_basis_snapshots(ALL):
        yield Problem(("basis", "n_modes"), _beyond_snapshots(case, ALL, case.plan.n_modes))
    listed = case.rom if "rom" in case.model_fields_set else ()  # another one is made to fit
    for i, model in enumerate(listed):
        path = ("rom", i, "n_modes")
        bases = {case.plan.basis_for(model, point): None for point in case.plan.rom_points(model)}
        smallest = min(bases, key=lambda name: case.plan.n_basis_snapshots(name))
        if model.n_modes == AUTO:
            if not all(case.plan.has_error_estimate(basis) for basis in bases):
                yield Problem(
                    path,
                    "auto needs the errors of training runs: set operators.error_estimate: true, "
                    "or a smaller basis.n_modes",
                )
        elif model.size > case.plan.n_basis_snapshots(smallest):
            yield Problem(path, _beyond_snapshots(case, smallest, model.size))
        elif model.size > case.plan.n_modes:
            yield Problem(
                path, f"must be at most basis.n_modes, {case.plan.n_modes}; got {model.n_modes}"
            )


def _beyond_snapshots(case: Case, basis: str, n_modes: int) -> str:
    n_runs = len(case.plan.bases[basis])
    runs = f"{n_runs} run{'s' if n_runs > 1 else ''} of {case.plan.steps.n_snapshots}"
    return (
        f"must be at most the number of snapshots of basis {basis}, "
        f"{case.plan.n_basis_snapshots(basis)} ({runs}); got {n_modes}"
    )


def check_reduced_times(case: Case) -> Iterator[Problem]:
    """Check when runs of reduced models end, and that their steps end on snapshots."""
    interval = case.plan.steps.snapshot_interval
    for i, model in enumerate(case.rom):
        try:
            case.plan.model_steps(model)
        except CaseError as error:
            yield Problem(("rom", i, "until"), str(error).removeprefix("final_time: "))
        number = case.plan.substeps(model.time_step)
        whole = max(1, round(number))
        if number > MAX_STEPS or abs(number - whole) > WHOLE_STEPS_TOLERANCE * whole:
            yield Problem(
                ("rom", i, "time_step"),
                f"the {interval:g} s between snapshots is not a whole number of steps of "
                f"{model.time_step:g} s; the nearest step is {interval / whole:.12g}",
            )


def check_figures(case: Case) -> Iterator[Problem]:
    """Check that what figures show is there."""
    names = [figure.name.casefold() for figure in case.compare.figures]
    for i, figure in enumerate(case.compare.figures):
        path = ("compare", "figures", i)
        if figure.name.casefold() in names[:i]:
            yield Problem((*path, "name"), f"two figures have the name {figure.name}")
        check = _check_figure_modes if isinstance(figure, OfModes) else _check_figure_runs
        yield from check(case, figure, path)  # type: ignore[arg-type]


def _check_figure_modes(case: Case, figure: OfModes, path: Path) -> Iterator[Problem]:
    if figure.basis not in case.plan.bases:
        hint = nearest(figure.basis, list(case.plan.bases))
        yield Problem((*path, "basis"), f"no basis has the name {figure.basis}; {hint}")
    if isinstance(figure, ModeFigure) and max(figure.modes) > case.plan.n_modes:
        yield Problem(
            (*path, "modes"),
            f"must be at most basis.n_modes, {case.plan.n_modes}; got {max(figure.modes)}",
        )


def _check_figure_runs(case: Case, figure: OfRuns, path: Path) -> Iterator[Problem]:
    known = [model.name for model in case.rom]
    if isinstance(figure, FieldFigure):
        known.append(FULL)
    unknown = {name: None for row in figure.runs for name in row if name not in known}
    for name in unknown:
        yield Problem((*path, "runs"), f"no run has the name {name}; {nearest(name, known)}")
    if not unknown:
        yield from _check_figure_values(case, figure, path)
    if not isinstance(figure, ErrorFigure):
        start, end = case.time.spin_up, case.time.final_time
        if not start <= figure.time <= end:
            yield Problem(
                (*path, "time"),
                f"must be within what is recorded, {exact(start)} s to {exact(end)} s; "
                f"got {exact(figure.time)}",
            )


def _check_figure_values(case: Case, figure: OfRuns, path: Path) -> Iterator[Problem]:
    for names, (_, points) in zip(figure.runs, rows_of(case, figure), strict=True):
        runs = " and ".join(names)
        known = {point.reynolds for point in points}
        for value in figure.reynolds or ():
            if value not in known:
                yield Problem(
                    (*path, "reynolds"), f"{runs}: not run at {exact(value)} beside a full run"
                )
        if not figure.reynolds and not points:
            yield Problem((*path, "runs"), f"{runs}: not run at a value beside a full run")


def check_sweep(case: Case) -> Iterator[Problem]:
    """Check that the model exists in the case, and can run at the values."""
    name = case.sweep.model
    known = (FULL, *(model.name for model in case.rom))
    if name is not None and name not in known:
        reason = f"no model has the name {name}; {nearest(name, known)}"
        yield Problem(("sweep", "model"), reason)
        return
    model = sweep_model(case)
    if case.sweep.sensitivities and (model is None or not model.from_operators):
        reason = "is for models with evaluation: operators, which have equations to differentiate"
        yield Problem(("sweep", "sensitivities"), reason)
    yield from _check_probes(case)
    yield from _check_swept(case)


def _check_probes(case: Case) -> Iterator[Problem]:
    domain = case.scene.domain
    for place in case.sweep.probes:
        at = np.array([place])
        inside = all(np.array(domain.lower) <= place) and all(place <= np.array(domain.upper))
        if not inside or (domain.has_walls and not domain.wall_distance(at)[0] > 0.0):
            reason = f"({place[0]:g}, {place[1]:g}) m is not in the fluid"
            yield Problem(("sweep", "probes"), reason)


def _check_swept(case: Case) -> Iterator[Problem]:
    model, points = sweep_model(case), sweep_points(case)
    for label in repeated(point.label for point in points):
        yield Problem(_VALUES, f"{label} stands more than once")
    for point in points:
        if (reason := impossible(REYNOLDS, point.reynolds)) is not None:
            yield Problem(("sweep",), f"{point.label}: reynolds {reason}")
            return
    if model is None:
        yield from _check_full(case, points)
    elif model.basis == LOCAL:
        for point in points:
            if (reason := basis_problem(case, model, point)) is not None:
                yield Problem(_VALUES, reason)
                return


def _check_full(case: Case, points: tuple[ParameterPoint, ...]) -> Iterator[Problem]:
    """Check that the case's time step, which all its runs have, is small enough for full runs."""
    if not points:
        return
    step = case.plan.steps.time_step
    thickest = min(points, key=lambda point: point.reynolds)
    limit = case.plan.step_limits(thickest).viscous
    if step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
        yield Problem(
            _VALUES,
            f"{thickest.label} is stable with steps below {limit:.4g} s only, and full runs of "
            f"this case take steps of {step:.4g} s: lower time.step, or list {thickest.label} in "
            "parameters.test",
        )


def check_fit(case: Case) -> Iterator[Problem]:
    """Check that the model exists in the case, and that there are parameters to look for."""
    name, path = case.fit.model, ("fit", "parameters")
    known = [model.name for model in case.rom if model.from_operators]
    if name is not None and name not in known:
        reason = f"no model with evaluation: operators has the name {name}; {nearest(name, known)}"
        yield Problem(("fit", "model"), reason)
    for parameter in case.fit.parameters:
        if parameter not in case.plan.parameter_names:
            hint = nearest(parameter, case.plan.parameter_names)
            yield Problem((*path, parameter), f"does not vary in the case; {hint}")


def check_training(case: Case) -> Iterator[Problem]:
    """Check the region, where there is one, and its model."""
    ranges = case.training.ranges
    known = case.plan.own_values
    for name in ranges:
        if name not in known:
            reason = f"the case has no such parameter or key; {nearest(name, known)}"
            yield Problem(("training", name), reason)
    for name in case.plan.parameter_names if ranges else ():
        if name in ranges:
            continue
        if name != REYNOLDS:
            reason = f"{name} varies in parameters: give its range too, or leave it out there"
            yield Problem(("training",), reason)
        elif len({point.reynolds for point in case.plan.train_points}) > 1:
            reason = "give a range of reynolds, as parameters.train has several"
            yield Problem(("training",), reason)
    if case.training.model is not None or ranges:
        yield from _check_training_model(case)


def _check_training_model(case: Case) -> Iterator[Problem]:
    name, fast = case.training.model, [m.name for m in case.rom if m.from_operators]
    if name is not None and name not in fast:
        known = nearest(name, fast) if fast else "there is none"
        reason = f"no model with evaluation: operators has the name {name}; {known}"
        yield Problem(("training", "model"), reason)
        return
    model = training_model(case)
    if model is None:
        reason = "is for models with evaluation: operators, and rom has none"
        yield Problem(("training",), reason)
    elif not case.plan.ends_with_case(model):
        reason = f"{model.name} has runs that end at another time than full runs: leave out until"
        yield Problem(("training", "model"), reason)
    elif case.operators.error_estimate is False:
        reason = "false leaves training nothing to go by: leave it out, or set true"
        yield Problem(("operators", "error_estimate"), reason)
