"""Stage `map`: the snapshots of full runs on the points of the reference space (Eq. 3.13-3.15)."""

from __future__ import annotations

import time

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.models.starts import initial_positions
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.setup import particles
from sphrom.setup.assembly import medium
from sphrom.store.trajectory import require_complete, snapshot_fields
from sphrom.store.workspace import Workspace


def reference_points(workspace: Workspace) -> Array:
    """Return the points of the reference space (n_points, 2) [m].

    Raises ArtifactError if they come from a full run that does not exist.
    """
    case = workspace.case
    if case.reference.points == "lattice":
        return case.scene.domain.fill(case.plan.particle_spacing)
    if case.reference.points == "relaxed":
        with workspace.open(workspace.full_run(case.plan.train_points[0])) as run:
            require_complete(run)
            return np.asarray(run.dataset("position")[-1])
    return initial_positions(workspace)


def map_point(workspace: Workspace, point: ParameterPoint) -> None:
    """Map the snapshots of a full run onto the points of the reference space."""
    case = workspace.case
    points = reference_points(workspace)
    to_reference = particles.map_onto(case, points)
    with workspace.open(workspace.full_run(point)) as trajectory:
        require_complete(trajectory)
        times = trajectory.read("time")
        with (
            workspace.create(workspace.mapped(point), medium(case, point)) as artifact,
            workspace.context.report.progress(f"map, {point.label}", len(times)) as advance,
        ):
            artifact.write("reference_position", points)
            artifact.write("time", times)
            started = time.perf_counter()
            densities = artifact.stream("density_fluctuation", points.shape[:1], len(times))
            velocities = artifact.stream("velocity", points.shape, len(times))
            for snapshot in range(len(times)):
                try:
                    density, velocity = to_reference(*snapshot_fields(trajectory, snapshot))
                except ValueError as error:
                    raise CaseError(
                        f"reference.smoothing_length_ratio: snapshot {snapshot}: {error}"
                    ) from error
                densities.append(density)
                velocities.append(velocity)
                advance(1)
            artifact.annotate("timing/map", time.perf_counter() - started)
            _report_errors(workspace, point, trajectory, to_reference, points, artifact)


def _report_errors(
    workspace: Workspace,
    point: ParameterPoint,
    trajectory: Artifact,
    to_reference: ReferenceMap,
    points: Array,
    artifact: ArtifactWriter,
) -> None:
    """Store the loss of the map: for the exact solution, or without one, for a map there and back.

    The mean pressure is left out, as no map changes it. Noise from particle to particle, such
    as that of the pressure next to a lid, counts as lost.
    """
    last = len(trajectory.read("time")) - 1
    position, density, velocity = snapshot_fields(trajectory, last)
    flow = workspace.case.plan.flow(point).exact
    if flow is None:
        kind, step = "round_trip_error", "the last snapshot, mapped there and back,"
        exact = density - density.mean(), velocity
        try:
            there = to_reference(position, *exact)
            mapped = particles.map_onto(workspace.case, position)(points, *there)
        except ValueError as error:
            raise CaseError(f"reference: snapshot {last}, there and back: {error}") from error
    else:
        kind, step = "map_error", "the exact solution, mapped from the particles,"
        end = float(trajectory.read("time")[-1])
        exact, sampled = (
            (flow.pressure(there, end), flow.velocity(there, end)) for there in (points, position)
        )
        mapped = to_reference(position, *sampled)
    losses = {}
    for name, k in (("velocity", 1), ("pressure", 0)):
        size = np.linalg.norm(exact[k]) or 1.0
        losses[name] = 100.0 * float(np.linalg.norm(mapped[k] - exact[k]) / size)
        artifact.annotate(f"{kind}/{name}", losses[name])
    lost = " and ".join(f"{loss:.2g} % of the {name}" for name, loss in losses.items())
    workspace.context.report.info(f"{point.label}: {step} loses {lost}")
