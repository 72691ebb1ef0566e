"""What must hold between a case's reduced models and its other keys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from sphrom.case.messages import nearest, repeated
from sphrom.case.model_kinds import EVALUATIONS, PROJECTIONS, Evaluation, Projection
from sphrom.case.models import Case, local_problem
from sphrom.case.plan import n_basis_snapshots
from sphrom.case.points import ParameterPoint, near
from sphrom.case.schema import Path
from sphrom.case.sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.yaml_reader import Problem

ROWS = ("full", "map", "exact")
"""Names of rows of the comparison that no reduced model may have."""
BEST = "best"
"""How the names of other such rows begin."""
_KINDS: dict[str, Mapping[str, Projection | Evaluation]] = {
    "projection": PROJECTIONS,
    "evaluation": EVALUATIONS,
}
"""What a reduced model has to be for some of its keys to mean something."""


def check_reduced_models(case: Case) -> Iterator[Problem]:
    """Check the names, bases, keys and values of each reduced model."""
    for name in repeated(model.name.casefold() for model in case.rom):
        yield Problem(("rom",), f"two reduced models have the name {name}")
    for i, model in enumerate(case.rom):
        path = ("rom", i)
        if model.name.casefold() in ROWS or model.name.casefold().startswith(BEST):
            yield Problem(
                (*path, "name"),
                f"the comparison has rows of its own that are called {', '.join(ROWS)} or begin "
                f"with {BEST}; choose another name than {model.name}",
            )
        yield from _check_basis(case, model, (*path, "basis"))
        yield from _check_keys(model, path)
        if model.from_operators and model.has_memory and case.driving:
            yield Problem(
                (*path, "projection"),
                f"{model.projection} has operators for the viscosity alone, and "
                f"{' and '.join(case.driving)} vary too; set projection: galerkin, or "
                "evaluation: particles",
            )
        if model.steady and (reason := steady_problem(case)) is not None:
            yield Problem((*path, "steady"), reason)
        yield from _check_values(case, model, (*path, "parameters"))
        yield from _check_corrected(case, model, (*path, "corrected"))
        yield from _check_integrated(case, model, (*path, "integrated_modes"))


def steady_problem(case: Case) -> str | None:
    """Return why a case has no steady states, or None."""
    if case.largest_body_force > 0.0 and case.scene.drive_changes:
        return "the scene's body force changes with time: there is no steady state"
    return None


def basis_problem(case: Case, model: ReducedModelSection, point: ParameterPoint) -> str | None:
    """Return why a model has no basis at a point that it may not be run at in the case, or None."""
    if model.basis != LOCAL:
        return None
    found = case.local_bases(point)
    if len(found) != 1:
        return local_problem(point, found)
    if model.from_operators and found[0] not in case.reference_bases:
        return (
            f"{point.label} has the local basis {found[0]}, at none of whose values {model.name} "
            "is run, so that it has no operators"
        )
    return None


def _check_values(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Check where a model is run: on particles, where a full run is."""
    points = case.rom_points(model)
    listed = () if isinstance(model.parameters, str) else points
    for label in repeated(point.label for point in listed):
        yield Problem(path, f"{label} stands more than once")
    for point in listed:
        if point not in case.points and model.on_particles:
            yield Problem(
                path,
                f"{point.label} is in neither parameters.train nor parameters.test; "
                f"{near(point, case.points)}",
            )
    if not points:
        yield Problem(path, f"there are no {model.parameters} values")


def _check_keys(model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Refuse keys that mean nothing for a kind of reduced model; what is off means nothing ever."""
    fields = type(model).model_fields
    given = {key: getattr(model, key) for key in fields}
    changed = [k for k, v in given.items() if v is not False and v != fields[k].default]
    for name, kinds in _KINDS.items():
        for key in changed:
            owners = [kind for kind, known in kinds.items() if key in known.keys]
            if owners and getattr(model, name) not in owners:
                yield Problem((*path, key), f"is only for {name}: {' or '.join(owners)}")
    projections = EVALUATIONS[model.evaluation].projections
    if model.projection not in projections:
        yield Problem((*path, "evaluation"), f"is only for projection: {' or '.join(projections)}")


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
    most = min(model.n_modes, case.basis.n_modes or model.n_modes, n_basis_snapshots(case, ALL))
    return case.model_copy(update={"rom": (model.model_copy(update={"n_modes": most}),)})


def _check_corrected(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Refuse to correct a model with what a single training run says."""
    names = {model.basis} if model.basis != LOCAL else set(case.basis.subsets)
    alone = [name for name in sorted(names & set(case.bases)) if len(case.bases[name]) == 1]
    if model.corrected is True and model.from_operators and alone:
        yield Problem(path, f"the basis {alone[0]} learns from one run; two or more are needed")


def _check_integrated(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Refuse to predict modes where no training runs can, or of a closure that needs them all."""
    if model.integrated_modes == AUTO or not model.from_operators:
        return
    if model.n_modes == AUTO:
        yield Problem(path, "where n_modes is auto, training runs choose integrated_modes too")
    elif model.integrated_modes > model.size:
        yield Problem(path, f"is at most n_modes, {model.n_modes}; got {model.integrated_modes}")
    elif model.integrated_modes < model.size:
        names = {model.basis} if model.basis != LOCAL else set(case.basis.subsets)
        known = sorted(names & set(case.bases))
        alone = [name for name in known if not case.is_corrected(model, name)]
        if model.has_memory:
            yield Problem(path, f"projection: {model.projection} integrates all modes")
        elif alone:
            yield Problem(
                path,
                "training runs predict the other modes where a model is corrected: it needs "
                f"corrected: auto and a basis that learns from two runs or more, unlike {alone[0]}",
            )


def _check_basis(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    if model.basis == LOCAL:
        for point in case.rom_points(model):
            found = case.local_bases(point)
            if len(found) != 1:
                yield Problem(path, local_problem(point, found))
                return
    elif model.basis not in case.bases:
        hint = nearest(model.basis, (*case.bases, LOCAL))
        yield Problem(path, f"no basis has the name {model.basis}; {hint}")
