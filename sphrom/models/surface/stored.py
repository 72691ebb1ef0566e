"""Artifacts of flows with a free surface: bases, trained models, and the height of the surface."""

from __future__ import annotations

from collections.abc import Callable

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.artifacts.records.reduced_models import SurfaceModels
from sphrom.case.model_sections import ALL, AUTO, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.elevation import find_elevation
from sphrom.models.contract import SURFACE, Measured
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph, chosen_size
from sphrom.sph.fluid import volume_of
from sphrom.store.workspace import Workspace


def read_surface_basis(workspace: Workspace) -> SurfaceBasis:
    """Read the basis of a case with a free surface."""
    with workspace.open(workspace.basis()) as artifact:
        return read_record(artifact, SurfaceBasis, f"bases/{ALL}")


def trained_size(
    workspace: Workspace, section: ReducedModelSection
) -> tuple[SurfaceBasis, TrainedGraph]:
    """Return the basis and the trained parameters of a model with its number of modes."""
    with workspace.open(workspace.operators()) as artifact:
        trained = read_record(artifact, SurfaceModels).sizes
    size = section.n_modes
    if size == AUTO:
        size = chosen_size({int(size): each for size, each in trained.items()})
    graph = trained[str(size)]
    return read_surface_basis(workspace).reduced(graph.n_modes, graph.n_surface), graph


def sized(workspace: Workspace, section: ReducedModelSection, basis: str) -> ReducedModelSection:
    """Return a model with its number of modes, without modes of noise."""
    _, graph = trained_size(workspace, section)
    return section.model_copy(update={"n_modes": graph.n_modes})


def measured_at(workspace: Workspace, point: ParameterPoint) -> Measured:
    """Return the elevation of the whole surface in a mapped full run."""
    with workspace.open(workspace.mapped(point)) as mapped:
        return {SURFACE: {"elevation": mapped.read("elevation")}}


def elevation_of(case: Case, space: StreamSpace, columns: Array) -> Callable[[Array, Array], Array]:
    """Return a function of positions and density fluctuations for the surface [m] at columns.

    The function raises SphromError if a column has no fluid or more than one surface.
    """
    walls = (space.left, space.right, space.bottom)
    radius = 2.0 * case.plan.smoothing_length

    def find(position: Array, density: Array) -> Array:
        volume = volume_of(density, case.fluid.reference_density, case.plan.mass)
        return find_elevation(position, volume, columns, radius, walls)

    return find
