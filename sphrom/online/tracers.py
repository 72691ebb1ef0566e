"""Positions of particles beside the coordinates of runs on the reference points (Eq. 3.23)."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.tracers import modal_flow, path_lines
from sphrom.store.splines import read_model_splines
from sphrom.store.start import start
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def write_tracers(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    artifact: ArtifactWriter,
    times: Array,
    coordinates: Array,
) -> None:
    """Carry the full run's particles along, and write their positions at all snapshots.

    `times` (n_snapshots,) [s] and `coordinates` (n_snapshots, n_modes) are those of the run.
    """
    began = time.perf_counter()
    begin = start(workspace, workspace.case.plan.start_point(point)).position
    positions = artifact.stream("position", begin.shape, len(times))
    report = workspace.context.report
    with report.progress(f"tracers of {model.name}, {point.label}", len(times)) as advance:
        for position in _positions(workspace, model, point, begin, times, coordinates):
            positions.append(position)
            advance(1)
    artifact.annotate("timing/tracers", time.perf_counter() - began)


def _positions(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    begin: Array,
    times: Array,
    coordinates: Array,
) -> Iterator[Array]:
    case = workspace.case
    if len(times) == 1:
        return iter((begin,))
    splines = read_model_splines(workspace, case.plan.basis_for(model, point), model.size)
    # In a step a particle goes as far as its neighbour, which is well within a spline's cell.
    spacings = case.plan.steps.snapshot_interval * case.fluid.reference_speed
    n_steps = max(1, math.ceil(spacings / case.plan.particle_spacing))
    flow = modal_flow(splines, times, coordinates)
    return path_lines(flow, begin, times, n_steps, case.scene.domain)
