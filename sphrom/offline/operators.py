"""Stage `operators`: right-hand sides on the reference points, projected once (Eq. 3.21-3.22)."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records.reduced_models import BasisOperators, HeldOut, WallForce
from sphrom.case.sections import AUTO
from sphrom.offline.training_data import held_out, residual_and_estimate
from sphrom.plots.tables import format_figure
from sphrom.reduction.held_out import best_size
from sphrom.reduction.memory_operators import project_memory_operators
from sphrom.reduction.mode_splines import ModeSplines, first_modes
from sphrom.reduction.operator_projection import project_forces, project_operators
from sphrom.reduction.polynomial_model import step_limit
from sphrom.reduction.reduced_measures import project_measures
from sphrom.reduction.reduced_operators import MemoryOperators, ReducedOperators
from sphrom.reduction.reduced_rates import spectrum
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.setup.particles import MeasuredFields
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.bases import mapped_runs, read_basis, read_points, read_splines
from sphrom.store.measured_quantities import read_forces
from sphrom.store.starts import starts_record
from sphrom.store.trained_operators import memory_timing, training_runs
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

N_STATES = 10
"""Training snapshots of a run, about, around which the step limit is looked at."""


def run(context: StageContext) -> None:
    """Project the operators onto every basis that a model on the reference points uses."""
    workspace = Workspace(context)
    names = context.case.plan.reference_bases
    if not names:
        context.report.info("no reduced model has evaluation: operators: no operators to project")
        return
    require_room(context.case, workspace.out, None, "operators")
    target = workspace.operators()
    if not workspace.must_make(target):
        return
    points = particles.fixed_points(context.case, read_points(workspace))
    with workspace.create(target, {"walls_driven": int(points.walls_driven)}) as artifact:
        started = time.perf_counter()
        for name in names:
            _project(workspace, artifact, points, name)
        write_record(artifact, starts_record(workspace), "starts")
        artifact.annotate("timing/projection", time.perf_counter() - started)


def _project(
    workspace: Workspace, artifact: ArtifactWriter, points: FixedPoints, name: str
) -> None:
    case = workspace.case
    basis = read_basis(workspace, name)
    splines = read_splines(workspace, name)
    with workspace.context.report.progress(f"operators, basis {name}", points.n_points) as advance:
        operators = project_operators(points, basis, splines, advance=advance)
    sizes = [n_modes for used, n_modes in case.plan.memory_models if used == name]
    fields = MeasuredFields.of(case)
    closures = _project_memory(workspace, artifact, points, name, basis, splines, sizes)
    states = _training_states(workspace, basis, name)
    taught = training_runs(workspace, basis, name) if name in case.plan.taught_bases else None
    residual, estimate = residual_and_estimate(
        workspace, points, name, basis, splines, operators, states
    )
    chosen = held_out(workspace, name, basis, operators, states, taught, estimate)
    stored = BasisOperators(
        rates=operators,
        states=states,
        training_runs=taught,
        residual=residual,
        estimate=estimate,
        held_out=chosen,
        memory=closures,
        training_means=_training_means(workspace, basis, name),
        wall_force=_wall_forces(workspace, points, basis, name),
        measure={}
        if fields is None
        else project_measures(basis, lambda *state: fields(points.position, *state)),
        skewness=operators.skewness,
    )
    write_record(artifact, stored, f"bases/{name}")
    _report(workspace, name, operators, states)
    if chosen is not None:
        _report_choice(workspace, name, chosen)


def _wall_forces(
    workspace: Workspace, points: FixedPoints, basis: TrialBasis, name: str
) -> dict[str, WallForce]:
    """Project the forces that a case measures, beside those that training runs recorded."""
    case = workspace.case
    walls = particles.driven_measured_walls(case)
    loads: dict[str, list[Array]] = {measured: [] for measured in walls}
    for point in case.plan.bases[name] if walls else ():
        with workspace.open(workspace.full_run(point)) as run:
            for measured, recorded in loads.items():
                recorded.append(read_forces(run, measured))
    found = {}
    for measured, (wall, circulations) in walls.items():
        force = project_forces(points, basis, wall, circulations)
        found[measured] = WallForce(**vars(force), training_loads=np.stack(loads[measured]))
    return found


def _training_means(workspace: Workspace, basis: TrialBasis, name: str) -> Array | None:
    """Return means (n_runs, n_snapshots) of mapped densities, where forces are calibrated."""
    if not workspace.case.scene.measured_walls:
        return None
    runs = mapped_runs(workspace, name)
    return np.stack([mean_density_fluctuation(basis, density[...]) for _, density, _ in runs])


def _project_memory(
    workspace: Workspace,
    artifact: ArtifactWriter,
    points: FixedPoints,
    name: str,
    basis: TrialBasis,
    splines: ModeSplines,
    sizes: Sequence[int],
) -> dict[str, MemoryOperators]:
    """Project the closure's term, for every number of modes that a model with it has."""
    case, found = workspace.case, dict[str, MemoryOperators]()
    if not sizes:
        return found
    text = f"memory operators, basis {name}"
    with workspace.context.report.progress(text, len(sizes)) as advance:
        for n_modes in sizes:
            started = time.perf_counter()
            found[str(n_modes)] = project_memory_operators(
                points,
                truncate(basis, n_modes),
                first_modes(splines, basis, n_modes),
                largest_viscosity=case.plan.largest_viscosity,
            )
            artifact.annotate(memory_timing(name, n_modes), time.perf_counter() - started)
            advance(1)
    return found


def _training_states(workspace: Workspace, basis: TrialBasis, name: str) -> Array:
    """Return coordinates (n_states, n_modes) of some training snapshots."""
    states = []
    for _, densities, velocities in mapped_runs(workspace, name):
        every = max(1, (len(densities) - 1) // N_STATES)
        states.append(project(basis, densities[::every], velocities[::every]))
    return np.concatenate(states)


def _report(workspace: Workspace, name: str, operators: ReducedOperators, states: Array) -> None:
    """Report the growth of sound in the operators, and the limit of steps."""
    case = workspace.case
    rows = []
    for point in case.plan.bases[name]:
        viscosity = case.plan.kinematic_viscosity(point)
        polynomial = operators.at(viscosity, factors=point.factors)
        at_rest = spectrum(polynomial.at_rest())
        limit = step_limit(polynomial, states)
        rows.append(
            (
                point.label,
                f"{at_rest.largest_real_part:.3g}",
                f"{at_rest.radius:.3g}",
                f"{limit:.3g}",
            )
        )
    workspace.context.report.table(
        f"operators of basis {name}, {operators.n_modes} modes: acoustic part skew to "
        f"{operators.skewness:.1e}",
        ("parameters", "largest real part [1/s]", "spectral radius [1/s]", "step limit [s]"),
        rows,
    )


def _report_choice(workspace: Workspace, name: str, chosen: HeldOut) -> None:
    """Say how many modes models have, and integrate, that leave it to the training runs."""
    case, told = workspace.case, workspace.context.report
    size = 0 if chosen.error is None else best_size(chosen.error)
    if chosen.error is not None:
        velocity, pressure = 100.0 * chosen.error[size - 1]
        told.info(
            f"basis {name}: {size} modes of {len(chosen.error)} predict training runs held out "
            f"best, velocity to {format_figure(velocity)} % and pressure to "
            f"{format_figure(pressure)} %"
        )
    for model in case.rom:
        is_chosen = model.n_modes == AUTO and chosen.error is not None
        n_modes = size if is_chosen else model.size
        chosen_here = model.integrated_modes == AUTO and model.is_calibrated
        used = name in {case.plan.basis_for(model, point) for point in case.plan.rom_points(model)}
        n_integrated = int(chosen.integrated[n_modes - 1])
        if used and chosen_here and case.plan.is_corrected(model, name) and n_integrated < n_modes:
            told.info(
                f"{model.name}, basis {name}: integrates {n_integrated} of {n_modes} modes; "
                "training runs predict the others"
            )
