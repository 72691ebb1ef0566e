"""Artifacts of flows with a free surface: their bases and trained models, and where it is."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.surfaces import SurfaceModels
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, AUTO, ReducedModelSection
from sphrom.metrics.samples import Samples
from sphrom.reduction.graph_model import SurfaceBasis
from sphrom.reduction.graph_training import TrainedGraph, chosen_size
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.setup.assembly import surface_columns
from sphrom.store.workspace import Workspace


def read_surface_basis(workspace: Workspace) -> SurfaceBasis:
    """Read the basis of a case with a free surface."""
    with workspace.open(workspace.basis()) as artifact:
        return read_record(artifact, SurfaceBasis, f"bases/{ALL}")


def read_trained(
    workspace: Workspace, model: ReducedModelSection
) -> tuple[ReducedModelSection, TrainedGraph]:
    """Read a trained model; training runs choose the number of modes of its section, if asked."""
    with workspace.open(workspace.operators()) as artifact:
        trained = read_record(artifact, SurfaceModels).sizes
    if model.n_modes == AUTO:
        size = chosen_size({int(size): each for size, each in trained.items()})
        model = model.model_copy(update={"n_modes": size})
    return model, trained[str(model.size)]


def surface_of(workspace: Workspace, point: ParameterPoint, x: Array) -> Array:
    """Return the height of a full run's surface (n_snapshots, n_places) [m] at places x [m]."""
    columns = surface_columns(workspace.case)
    with workspace.open(workspace.mapped(point)) as mapped:
        elevation = mapped.read("elevation")
    return np.stack([np.interp(x, columns, heights) for heights in elevation])


def sample_mapped_surface(mapped: Artifact, points: Array) -> tuple[Array, Array]:
    """Return time [s] and velocity (n_snapshots, n_points, 2) [m/s] of mapped snapshots."""
    space = read_record(mapped, StreamSpace, "space")
    return mapped.read("time"), space.velocity(mapped.read("stream_function"), points)


def dried(samples: Samples, points: Array, surface: Array) -> Samples:
    """Return samples that are zero at points (n_points, 2) above a surface (n_snapshots, n_points)."""
    wet = points[:, 1] <= surface[: len(samples.time)]
    return Samples(
        samples.time,
        np.where(wet[..., None], samples.velocity, 0.0),
        np.where(wet, samples.pressure, 0.0),
        samples.measured,
    )
