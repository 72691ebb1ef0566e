"""Operators and projected training runs in their artifacts, and starts on the reference points.

A model of any size is calibrated when it is trained. The closure of Eq. 3.22 is stored for each
number of modes: it contains the residual of the projection onto these modes alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.artifacts.records.reduced_models import BasisOperators, Starts, TrainedModel
from sphrom.case.model_sections import AUTO, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Quantities, with_coefficients
from sphrom.models.reference.stored import mapped_runs, read_points
from sphrom.models.starts import RunStarts, start
from sphrom.plots.tables import format_figure
from sphrom.reduction.calibration import Calibration, TrainingRun, calibrate
from sphrom.reduction.cycle_fits import fitted_cycle
from sphrom.reduction.held_out import best_size
from sphrom.reduction.limit_cycles import CycleClosure, TrainedCycles
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.trained_basis import ALL_MODES, TrainedBasis
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.setup import assembly
from sphrom.store.trajectory import totals
from sphrom.store.workspace import Workspace

STEADY_SHARE = 0.3
"""Fluctuations of a steady run relative to the largest ones of training runs; the rest is noise."""
N_BLOCK_SNAPSHOTS = 16
"""Number of snapshots that are projected at once."""


def stored_model(workspace: Workspace, model: ReducedModelSection) -> TrainedModel | None:
    """Return a trained model from its artifact; None if there is no valid one."""
    target = workspace.model(model)
    if workspace.reason_to_make(target) is not None:
        return None
    with workspace.open(target) as artifact:
        return read_record(artifact, TrainedModel)


def stored_starts(workspace: Workspace) -> Starts | None:
    """Return the starts in the artifact of operators, if it has any."""
    with workspace.open(workspace.operators()) as artifact:
        if "starts/parameters" in artifact:
            return read_record(artifact, Starts, "starts")
    return None


def training_runs(workspace: Workspace, basis: TrialBasis, name: str) -> Array:
    """Return the projected training snapshots of a basis (n_runs, n_snapshots, n_modes)."""
    runs = []
    for _, densities, velocities in mapped_runs(workspace, name):
        firsts = range(0, len(densities), N_BLOCK_SNAPSHOTS)
        blocks = [slice(first, first + N_BLOCK_SNAPSHOTS) for first in firsts]
        parts = [project(basis, densities[some], velocities[some]) for some in blocks]
        runs.append(np.concatenate(parts))
    return np.stack(runs)


def calibrated(
    case: Case, points: Sequence[ParameterPoint], operators: ReducedOperators, runs: Array
) -> Calibration:
    """Calibrate operators with training runs (n_runs, n_snapshots, n_modes) at some points.

    Raises ValueError if they have too few snapshots.
    """
    times = snapshot_times(case)
    trained = []
    for point, coordinates in zip(points, runs, strict=True):
        viscosity = case.plan.kinematic_viscosity(point)
        amplitude = assembly.amplitude_of(case, point)
        rates = operators.at(viscosity, factors=point.factors)
        driven = None if amplitude is None else amplitude(times)
        factors = case.plan.fitted_factors(point)
        trained.append(TrainingRun(rates, coordinates, viscosity, driven, factors))
    interval = case.plan.steps.snapshot_interval
    return calibrate(trained, interval, case.plan.longest_sound_period)


def cycle_closure(
    case: Case, points: Sequence[ParameterPoint], operators: ReducedOperators, runs: Array
) -> CycleClosure:
    """Return the closure by the limit cycles of training runs; see `calibrated` for arguments.

    Raises ValueError that names the run if one is not periodic.
    """
    times = snapshot_times(case)
    cycles = []
    amplitude = assembly.amplitude_of(case, points[0])
    sizes = np.linalg.norm(runs - runs.mean(axis=1, keepdims=True), axis=(1, 2))
    shares = sizes / sizes.max()
    for point, run, share in zip(points, runs, shares.tolist(), strict=True):
        try:
            cycles.append(fitted_cycle(times, run))
        except ValueError as error:
            remedy = "see time.spin_up and time.final_time"
            if share < STEADY_SHARE:
                remedy = (
                    f"it is steady: its fluctuations are {100.0 * share:.0f} % of those of others"
                )
                remedy += "; leave it out of parameters.train"
            raise ValueError(f"the training run at {point.label}: {error}; {remedy}") from error
    viscosities = np.array([case.plan.kinematic_viscosity(point) for point in points])
    pushed = 0.0 if amplitude is None else float(amplitude(times[-1:])[0])
    factors = [point.factors for point in points]
    return CycleClosure(operators, TrainedCycles.of_runs(viscosities, factors, cycles, pushed))


def report_onset(workspace: Workspace, model: str, basis: str, trained: TrainedBasis) -> None:
    """Report the Reynolds number of the onset, with the other parameters as in the first run."""
    closure = trained.rates[ALL_MODES].closure
    if not isinstance(closure, CycleClosure):
        return
    report = workspace.context.report
    point = workspace.case.plan.bases[basis][0]
    scale = point.reynolds * workspace.case.plan.kinematic_viscosity(point)
    found = closure.onsets(point.factors)
    if math.isinf(found[0]):
        report.warn(f"{model}, basis {basis}: the training runs do not determine an onset")
        return
    onset, low, high = (format_figure(scale / x, 3) for x in (found[0], max(found), min(found)))
    report.note(
        f"{model}, basis {basis}: oscillates from reynolds={onset} on; estimates of this onset are "
        f"from {low} to {high}"
    )


def snapshot_times(case: Case) -> Array:
    """Return the times of the snapshots of a case's runs (n_snapshots,) [s]."""
    steps = case.plan.steps
    numbers = np.arange(steps.n_snapshots, dtype=np.float64)
    return steps.start_time + steps.snapshot_interval * numbers


def read_operators(workspace: Workspace, name: str) -> BasisOperators:
    """Read the operators of all modes of a basis, with the data of its training runs."""
    with workspace.open(workspace.operators()) as artifact:
        stored = read_record(artifact, BasisOperators, f"bases/{name}")
        driven = artifact.number("walls_driven") == 1.0
    rates = replace(stored.rates, walls_driven=driven)
    residual = stored.residual and replace(stored.residual, walls_driven=driven)
    return replace(stored, rates=rates, residual=residual)


def recorded_of(case: Case, stored: BasisOperators) -> dict[str, Quantities]:
    """Return the measurements (n_runs, n_snapshots, ...) of a basis's full training runs."""
    recorded: dict[str, Quantities] = {
        name: {q: measure.training[f"training_{q}"] for q in measure.quantities}
        for name, measure in stored.measure.items()
    }
    n_dim = case.scene.domain.n_dim
    for name, force in stored.wall_force.items():
        recorded[name] = totals(force.training_loads, n_dim)
    ordered = {name: recorded[name] for name in case.scene.recorded}
    return with_coefficients(ordered, case.plan.coefficients)


def memory_timing(basis: str, n_modes: int) -> str:
    """Return the attribute with the time spent on the memory operators for a number of modes."""
    return f"timing/memory-{basis}-{n_modes}"


def sized(workspace: Workspace, model: ReducedModelSection, basis: str) -> ReducedModelSection:
    """Return a model with its number of modes in a basis, chosen by training runs if automatic."""
    if model.n_modes != AUTO:
        return model
    with workspace.open(workspace.operators()) as artifact:
        error = artifact.read(f"bases/{basis}/held_out/error")
    return model.model_copy(update={"n_modes": best_size(error)})


Fields = tuple[Array, Array]
"""Density fluctuation (n_points,) [kg/m3] and velocity (n_points, 2) [m/s]."""


def starts_record(workspace: Workspace) -> Starts:
    """Map the starts of the training runs; without a spin-up they are alike, and one is mapped."""
    case = workspace.case
    mapped = mapped_starts(workspace)
    points = case.plan.train_points if case.time.spin_up > 0.0 else case.plan.train_points[:1]
    fields = [mapped.at(point) for point in points]
    return Starts(
        parameters=np.array([list(point.as_dict().values()) for point in points]),
        density_fluctuation=np.stack([density for density, _ in fields]),
        velocity=np.stack([velocity for _, velocity in fields]),
    )


def mapped_starts(
    workspace: Workspace, points: Array | None = None, stored: Starts | None = None
) -> RunStarts[Fields]:
    """Return stored starts, if there are any, and others mapped onto points (n_points, 2) [m].

    By default the points are those of the case's bases.
    """

    def mapped(begin: ParameterPoint) -> Fields:
        from sphrom.setup.particles import map_onto

        to_points = map_onto(workspace.case, read_points(workspace) if points is None else points)
        return to_points(**vars(start(workspace, begin)))

    if stored is None:
        return RunStarts(workspace, mapped)
    known = zip(stored.density_fluctuation, stored.velocity, strict=True)
    return RunStarts(workspace, mapped, stored.parameters, known)
