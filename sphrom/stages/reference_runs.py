"""Reduced runs on the reference points, whose cost does not depend on the number of particles."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.plan import StepPlan, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.reduction.polynomial_model import (
    Amplitude,
    PolynomialModel,
    Runs,
    Schedule,
    step_limit,
    steps_per_snapshot,
)
from sphrom.reduction.trial_basis import (
    TrialBasis,
    kept_modes,
    mean_density_fluctuation,
    project,
    reconstruct,
    truncate,
)
from sphrom.sph import state_equation
from sphrom.stages import assembly
from sphrom.stages.fom import start
from sphrom.stages.operators import read_operators
from sphrom.stages.pod import read_basis
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]

N_TIMED = 5
"""Times that a run is repeated to say what it takes, which is far below a second."""


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    mean_density_fluctuation: float
    """[kg/m3], carried apart."""
    step_limit: float
    """[s], of the start and of some training states."""
    amplitude: Amplitude | None


def build_reference_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReferenceModel:
    """Return a model on the reference points at a parameter point, which need not be trained."""
    case = workspace.case
    name = case.basis_for(model, point)
    whole = read_basis(workspace, name)
    modes = kept_modes(whole, model.n_modes)
    basis = truncate(whole, model.n_modes)
    with workspace.open(workspace.operators()) as artifact:
        operators = read_operators(artifact, name, modes)
        states = artifact.read(f"bases/{name}/states")[:, modes]
    with workspace.open(workspace.basis()) as artifact:
        points = artifact.read("reference_position")
    begin = start(workspace, point)
    density, velocity = assembly.map_onto(case, points)(
        begin.position, begin.density_fluctuation, begin.velocity
    )
    coordinates = project(basis, density, velocity)
    polynomial = operators.at(case.kinematic_viscosity(point))
    return ReferenceModel(
        polynomial=polynomial,
        basis=basis,
        start=coordinates,
        mean_density_fluctuation=float(mean_density_fluctuation(basis, density)),
        step_limit=step_limit(polynomial, np.vstack((coordinates, states))),
        amplitude=_amplitude(workspace, point),
    )


def _amplitude(workspace: Workspace, point: ParameterPoint) -> Amplitude | None:
    drive = assembly.scene(workspace.case, point).body_force
    if drive is None:
        return None
    return lambda times: np.array([drive.amplitude(float(t)) for t in times])


def run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model on the reference points at a parameter point."""
    case = workspace.case
    workspace.require(workspace.operators())
    reduced = build_reference_model(workspace, model, point)
    plan = step_plan(case)
    every = _steps_per_snapshot(model, reduced, plan)
    attributes = assembly.run_attributes(case, point, plan.snapshot_interval / every)
    with workspace.create(workspace.reduced_run(model, point), attributes) as artifact:
        runs, seconds = _timed(reduced, plan, every)
        failure = _failure(runs)
        n_kept = int(np.isfinite(runs.coordinates[0]).all(axis=1).sum())
        _write(workspace, model, reduced, runs, n_kept, artifact)
        artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            artifact.annotate("status_detail", str(failure))
        artifact.annotate("timing/integration", seconds)
    report = workspace.context.report
    if failure is not None:
        report.warn(f"{model.name}, {point.label}: {failure}")
    else:
        n_steps = every * (plan.n_snapshots - 1)
        report.info(
            f"{model.name}, {point.label}: {n_steps} steps of {plan.snapshot_interval / every:.3g} "
            f"s in {1e3 * seconds:.3g} ms"
        )


def _steps_per_snapshot(model: ReducedModelSection, reduced: ReferenceModel, plan: StepPlan) -> int:
    if model.time_step == "fom":
        return plan.every
    if model.time_step == "auto":
        return steps_per_snapshot(plan.snapshot_interval, reduced.step_limit)
    return round(plan.snapshot_interval / model.time_step)


def _timed(reduced: ReferenceModel, plan: StepPlan, every: int) -> tuple[Runs, float]:
    """Run, and return what it took [s]: the median of some runs once all is compiled."""
    system = PolynomialModel([reduced.polynomial])
    schedule = Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time)
    seconds = []
    for _ in range(N_TIMED):
        started = time.perf_counter()
        runs = system.run(reduced.start[None], schedule, [every], reduced.amplitude)
        seconds.append(time.perf_counter() - started)
    return runs, float(np.median(seconds))


def _failure(runs: Runs) -> UnstableError | None:
    at = float(runs.diverged_at[0])
    if np.isnan(at):
        return None
    return UnstableError(f"unstable after t = {at:.6g} s: the coordinates grow without bound")


def _write(
    workspace: Workspace,
    model: ReducedModelSection,
    reduced: ReferenceModel,
    runs: Runs,
    n_kept: int,
    artifact: ArtifactWriter,
) -> None:
    coordinates = runs.coordinates[0][:n_kept]
    artifact.write("time", runs.time[:n_kept])
    artifact.write("generalized_coordinates", coordinates)
    artifact.annotate("mean_density_fluctuation", reduced.mean_density_fluctuation)
    artifact.annotate("step_limit", reduced.step_limit)
    growth = spectrum(reduced.polynomial.jacobian(reduced.start)).largest_real_part
    artifact.annotate("largest_real_part", growth)
    if model.output == "snapshots":
        _write_fields(workspace, reduced, coordinates, artifact)


def _write_fields(
    workspace: Workspace, reduced: ReferenceModel, coordinates: Array, artifact: ArtifactWriter
) -> None:
    """Rebuild and write the fields of every snapshot, one at a time."""
    with workspace.open(workspace.basis()) as basis:
        points = basis.read("reference_position")
    artifact.write("reference_position", points)
    n_snapshots, n_points = len(coordinates), len(points)
    densities = artifact.stream("density_fluctuation", (n_points,), n_snapshots)
    velocities = artifact.stream("velocity", (n_points, 2), n_snapshots)
    pressures = artifact.stream("pressure", (n_points,), n_snapshots)
    for state in coordinates:
        density, velocity = reconstruct(reduced.basis, state, reduced.mean_density_fluctuation)
        densities.append(density)
        velocities.append(velocity)
        pressures.append(state_equation.pressure(density, workspace.case.sound_speed))


class RebuiltRun:
    """The fields of a run on the reference points, snapshot by snapshot, as a trajectory has them.

    `artifact` is what the run wrote, `basis` the one it used.
    """

    def __init__(self, artifact: Artifact, basis: TrialBasis, sound_speed: float) -> None:
        self._coordinates = artifact.read("generalized_coordinates")
        self._mean = artifact.number("mean_density_fluctuation")
        self._basis = basis
        self._sound_speed = sound_speed
        self.time = artifact.read("time")
        self.mass = artifact.number("mass")

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n_points, 2) [m/s] and pressure (n_points,) [Pa] of one snapshot."""
        density, velocity = reconstruct(self._basis, self._coordinates[snapshot], self._mean)
        return velocity, state_equation.pressure(density, self._sound_speed)
