"""The stages map, pod and operators of flows with a free surface.

A snapshot becomes a stream function and an elevation, a basis has modes of both, and models are
trained for some numbers of modes (`sphrom.reduction.graph_model`).
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.artifacts import write_record
from sphrom.artifacts.records.reduced_models import (
    StoredSurfaceBasis,
    SurfaceModels,
    SurfaceStarts,
    TrainedSurfaceModel,
)
from sphrom.case.model_sections import ALL, AUTO, ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError, SphromError, UnstableError
from sphrom.metrics.histories import energy
from sphrom.models.surface.stored import elevation_of, read_surface_basis
from sphrom.plots.tables import format_figure
from sphrom.reduction import surface_basis
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph, chosen_size
from sphrom.reduction.surface_errors import SurfaceErrors
from sphrom.setup.assembly import medium, uniform_force
from sphrom.store.trajectory import require_complete, snapshot_fields
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.models.surface.model import SurfaceRun
    from sphrom.reduction.graph_training import TrainingRun

SHOWN_MODES = (1, 2, 3, 5, 10, 20)
MOST_KEPT = 50
"""Singular values."""


def map_point(workspace: Workspace, point: ParameterPoint) -> None:
    """Fit stream functions and elevations to the snapshots of a full run.

    Raises UnstableError where a column has no fluid or more than one surface.
    """
    case = workspace.case
    space = workspace.case.plan.stream_space
    columns = case.plan.surface_columns
    find = elevation_of(case, space, columns)
    with workspace.open(workspace.full_run(point)) as trajectory:
        require_complete(trajectory)
        times = trajectory.read("time")
        shapes = {
            "stream_function": (space.n_coefficients,),
            "elevation": columns.shape,
            "residual": (),
            "speed": (),
        }
        with (
            workspace.create(workspace.mapped(point), medium(case, point)) as artifact,
            workspace.context.report.progress(f"map, {point.label}", len(times)) as advance,
        ):
            write_record(artifact, space, "space")
            artifact.write("time", times)
            started = time.perf_counter()
            streams = {n: artifact.stream(n, shape, len(times)) for n, shape in shapes.items()}
            residuals = []
            for snapshot, instant in enumerate(times.tolist()):
                position, density, velocity = snapshot_fields(trajectory, snapshot)
                try:
                    elevation = find(position, density)
                except SphromError as error:
                    raise UnstableError(
                        f"{point.label}, t = {instant:.6g} s: {error} A reduced model needs one "
                        "surface above each x: drive the fluid less, or record less of the run."
                    ) from error
                coefficients, residual = space.fit(position, velocity)
                residuals.append(residual)
                speed = np.sqrt(np.mean(np.sum(velocity**2, axis=1)))
                found = coefficients, elevation, residual, speed
                for name, value in zip(shapes, found, strict=True):
                    streams[name].append(np.asarray(value))
                advance(1)
            artifact.annotate("timing/map", time.perf_counter() - started)
    lost = format_figure(100.0 * float(np.median(residuals)))
    text = f"{point.label}: the stream functions miss {lost} % of the velocity (median)"
    workspace.context.report.info(text)


def make_basis(workspace: Workspace) -> None:
    """Write the basis of the training runs."""
    case = workspace.case
    target = workspace.basis()
    with workspace.create(target, medium(case)) as artifact:
        started = time.perf_counter()
        whole = _basis(workspace, case.plan.train_points)
        artifact.annotate("timing/decomposition", time.perf_counter() - started)
        if not whole.modes_above_noise:
            raise CaseError(
                "parameters.train: no mode of the velocity is above the noise of the particles; "
                "drive the fluid more, or raise discretization.resolution"
            )
        kept = whole.reduced(case.plan.basis_size(ALL), len(whole.surface_modes))
        values = np.sqrt(np.clip(whole.energies, 0.0, None))
        stored = StoredSurfaceBasis(**vars(kept), singular_values={"velocity": values})
        write_record(artifact, stored, f"bases/{ALL}")
    shares = energy(values)
    workspace.context.report.table(
        f"basis {ALL}: {len(kept.stream_modes)} modes of the velocity, {kept.modes_above_noise} of "
        f"them above the noise of the fits, and {len(kept.surface_modes)} of the elevation",
        ("modes", "singular value", "energy %"),
        [
            (str(m), f"{values[m - 1]:.4g}", f"{shares[m - 1]:.6f}")
            for m in SHOWN_MODES
            if m <= len(values)
        ],
    )


def _basis(workspace: Workspace, points: Sequence[ParameterPoint]) -> SurfaceBasis:
    """Return the basis of mapped full runs. Raises CaseError if all are at rest."""
    coefficients, elevations, speeds, lost = [], [], [], []
    for point in points:
        with workspace.open(workspace.mapped(point)) as mapped:
            coefficients.append(mapped.read("stream_function"))
            elevations.append(mapped.read("elevation"))
            speeds.append(mapped.read("speed"))
            lost.append(mapped.read("residual") * speeds[-1])
    if not np.any(speeds):
        raise CaseError("parameters.train: all runs are at rest, so there are no modes; drive them")
    runs = np.stack(coefficients)
    noise = np.linalg.norm(lost) / np.linalg.norm(speeds)
    most = min(MOST_KEPT, runs.shape[2], runs.shape[0] * runs.shape[1])
    space = workspace.case.plan.stream_space
    return surface_basis.make_basis(space, runs, np.stack(elevations), float(noise), most)


def project(workspace: Workspace) -> None:
    """Train models of all numbers of modes that the case's models have, and write them."""
    from sphrom.reduction.graph_training import train  # it loads kernels

    case = workspace.case
    sizes = workspace.case.plan.surface_sizes
    basis = read_surface_basis(workspace)
    with workspace.create(workspace.operators()) as artifact:
        started = time.perf_counter()
        with workspace.context.report.progress("training", len(sizes)) as advance:
            runs = list(_training_runs(workspace, case.plan.train_points))
            trained = train(basis, runs, sizes, advance)
        if case.plan.has_error_estimate(ALL):
            trained |= _with_errors(workspace, trained)
        artifact.annotate("timing/projection", time.perf_counter() - started)
        write_record(artifact, SurfaceModels(sizes={str(m): t for m, t in trained.items()}))
    _report(workspace, trained)
    if any(model.n_modes == AUTO for model in case.rom):
        size = chosen_size(trained)
        workspace.context.report.info(f"n_modes: auto takes {size} modes, of {sizes[-1]} at most")


def fit_splines(workspace: Workspace) -> None:
    """Report that there is nothing to do, because stream functions are splines."""
    workspace.context.report.info("models of a free surface need no splines of modes")


def trained_model(
    workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
) -> TrainedSurfaceModel:
    """Return a trained model as its file has it, with the starts of the training runs."""
    from sphrom.models.surface.model import SurfaceModel  # it loads kernels

    model = SurfaceModel(workspace, section)
    points = workspace.case.plan.train_points
    starts = SurfaceStarts(
        parameters=np.array([list(point.as_dict().values()) for point in points]),
        coordinates=np.stack([model.start_from(point) for point in points]),
    )
    return TrainedSurfaceModel(basis=model.basis, graph=model.trained, starts=starts, **common)


def _with_errors(
    workspace: Workspace, trained: Mapping[int, TrainedGraph]
) -> dict[int, TrainedGraph]:
    """Return models with the errors of training runs, of all sizes that calibrated models have."""
    from sphrom.models.surface import errors  # it loads kernels
    from sphrom.models.surface.model import SurfaceModel
    from sphrom.reduction.graph_training import train

    case = workspace.case
    points = case.plan.train_points
    sections = [model for model in case.rom if model.is_calibrated]
    if not sections:
        return {}
    section = sections[0]
    sizes = {chosen_size(trained) if m.n_modes == AUTO else m.size for m in sections}
    full = {point: errors.full_run(workspace, point) for point in points}
    repeated: defaultdict[int, list[SurfaceRun]] = defaultdict(list)
    held_out: defaultdict[int, list[SurfaceRun]] = defaultdict(list)

    def run(basis: SurfaceBasis, graph: TrainedGraph, point: ParameterPoint) -> SurfaceRun:
        reduced = basis.reduced(graph.n_modes, graph.n_surface)
        return SurfaceModel(workspace, section, (reduced, graph)).run(point)

    basis = read_surface_basis(workspace)
    known = {size: trained[size].n_surface for size in sizes}
    with workspace.context.report.progress("runs left out", len(points)) as advance:
        for point in points:
            others = [other for other in points if other != point]
            advance(1)
            try:
                without = _basis(workspace, others)
            except CaseError:  # the others are at rest
                continue
            if not without.modes_above_noise:
                continue
            runs = list(_training_runs(workspace, others))
            models = train(without, runs, sorted(sizes), n_surface=known)
            for size, graph in models.items():
                repeated[size].append(run(basis, trained[size], point))
                held_out[size].append(run(without, graph, point))
    found = {}
    for size in sizes:
        both = [errors.run_errors(each[size], full) for each in (repeated, held_out)]
        near, far = both
        # The distance between runs needs two of them.
        if near is not None and far is not None and len(near.places) > 1:
            errors_of_runs = SurfaceErrors(repeated=near, held_out=far)
            found[size] = replace(trained[size], errors=errors_of_runs)
    return found


def _training_runs(workspace: Workspace, points: Sequence[ParameterPoint]) -> Iterator[TrainingRun]:
    from sphrom.reduction.graph_training import TrainingRun

    case = workspace.case
    for point in points:
        with workspace.open(workspace.mapped(point)) as mapped:
            yield TrainingRun(
                times=mapped.read("time"),
                coefficients=mapped.read("stream_function"),
                elevation=mapped.read("elevation"),
                depth=case.plan.depth(point),
                gravity=case.scene.gravity,
                viscosity=case.plan.kinematic_viscosity(point),
                force=uniform_force(case, point),
                longest_step=case.plan.longest_step(point),
            )


def _report(workspace: Workspace, trained: dict[int, TrainedGraph]) -> None:
    rows = []
    for graph in dict.fromkeys(trained.values()):
        errors = (
            graph.elevation_error,
            graph.velocity_error,
            graph.uncalibrated_elevation_error,
            graph.uncalibrated_velocity_error,
        )
        sizes = (str(graph.n_modes), str(graph.n_surface), f"{graph.gravity_factor:.4f}")
        rows.append((*sizes, *(format_figure(100.0 * error) for error in errors)))
    workspace.context.report.table(
        "repeated training runs: errors of elevation and velocity [%], calibrated and not",
        ("modes", "of the elevation", "gravity", "elevation", "velocity", "elevation, not",
         "velocity, not"),
        rows,
    )  # fmt: skip
