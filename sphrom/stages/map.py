"""Stage `map`: the snapshots of full runs on the points of the reference space (Eq. 3.13-3.15)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction.reference_space import ReferenceMap, relative_error
from sphrom.sph.packing import lattice
from sphrom.stages import assembly
from sphrom.stages.check import require_room
from sphrom.stages.context import StageContext
from sphrom.stages.fom import initial_positions
from sphrom.stages.trajectory import require_complete
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]


def run(context: StageContext) -> None:
    """Map the full runs of the chosen parameter points."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only, "map")
    for point in context.chosen(context.case.points):
        target = workspace.mapped(point)
        if workspace.wanted(target):
            workspace.require(workspace.full_run(point))
            _map_point(workspace, point, reference_points(workspace))


def reference_points(workspace: Workspace) -> Array:
    """Return the points of the reference space (n_points, 2) [m].

    Raises
    ------
    ArtifactError
        When they are those of a full run that is not there.
    """
    case = workspace.case
    if case.reference.points == "lattice":
        return lattice(assembly.domain(case), case.particle_spacing)
    if case.reference.points == "relaxed":
        with workspace.open(workspace.full_run(case.train_points[0])) as run:
            require_complete(run)
            return np.asarray(run.dataset("position")[-1])
    return initial_positions(workspace)


def _map_point(workspace: Workspace, point: ParameterPoint, points: Array) -> None:
    case = workspace.case
    to_reference = assembly.map_onto(case, points)
    with workspace.open(workspace.full_run(point)) as trajectory:
        require_complete(trajectory)
        times = trajectory.read("time")
        attributes = {f"parameters/{name}": value for name, value in point.as_dict().items()}
        attributes |= {
            "reference_density": case.fluid.reference_density,
            "sound_speed": case.sound_speed,
        }
        with (
            workspace.create(workspace.mapped(point), attributes) as artifact,
            workspace.context.report.progress(f"map, {point.label}", len(times)) as advance,
        ):
            artifact.write("reference_position", points)
            artifact.write("time", times)
            started = time.perf_counter()
            densities = artifact.stream("density_fluctuation", points.shape[:1], len(times))
            velocities = artifact.stream("velocity", points.shape, len(times))
            for snapshot in range(len(times)):
                density, velocity = _mapped(to_reference, trajectory, snapshot)
                densities.append(density)
                velocities.append(velocity)
                advance(1)
            artifact.annotate("timing/map", time.perf_counter() - started)
            _report_errors(workspace, point, trajectory, to_reference, points, artifact)


def _mapped(to_reference: ReferenceMap, trajectory: Artifact, snapshot: int) -> tuple[Array, Array]:
    try:
        return to_reference(*snapshot_fields(trajectory, snapshot))
    except ValueError as error:
        raise CaseError(
            f"reference.smoothing_length_ratio: snapshot {snapshot}: {error}"
        ) from error


def snapshot_fields(trajectory: Artifact, snapshot: int) -> tuple[Array, Array, Array]:
    """Return position (N, 2), density fluctuation (N,) and velocity (N, 2) of one snapshot."""
    return (
        np.asarray(trajectory.dataset("position")[snapshot]),
        np.asarray(trajectory.dataset("density_fluctuation")[snapshot]),
        np.asarray(trajectory.dataset("velocity")[snapshot]),
    )


def _report_errors(
    workspace: Workspace,
    point: ParameterPoint,
    trajectory: Artifact,
    to_reference: ReferenceMap,
    points: Array,
    artifact: ArtifactWriter,
) -> None:
    """Store what the map loses of the exact solution, sampled where the particles ended."""
    flow = assembly.exact_flow(workspace.case, point)
    position = np.asarray(trajectory.dataset("position")[-1])
    end = float(trajectory.read("time")[-1])
    pressure, velocity = to_reference(
        position, flow.pressure(position, end), flow.velocity(position, end)
    )
    losses = {
        "velocity": 100.0 * relative_error(velocity, flow.velocity(points, end)),
        "pressure": 100.0 * relative_error(pressure, flow.pressure(points, end)),
    }
    for name, loss in losses.items():
        artifact.annotate(f"map_error/{name}", loss)
    workspace.context.report.info(
        f"{point.label}: of the exact solution on the particles the map loses "
        f"{losses['velocity']:.2g} % of the velocity and {losses['pressure']:.2g} % of the pressure"
    )
