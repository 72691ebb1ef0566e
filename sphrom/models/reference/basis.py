"""Stage `pod`: the trial bases, from streamed reference snapshots (Eq. 3.14, 3.16)."""

from __future__ import annotations

import time
from contextlib import ExitStack

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, ArtifactWriter, write_record
from sphrom.case.hints import few_snapshots
from sphrom.errors import CaseError
from sphrom.metrics.histories import cumulative_singular_value_share, energy
from sphrom.reduction.decomposition import decompose
from sphrom.reduction.trial_basis import JOINT, Modes, TrialBasis, weighted_mean
from sphrom.setup.assembly import inner_product, medium
from sphrom.setup.cost import decomposition_ram_limit
from sphrom.store.trajectory import require_complete
from sphrom.store.workspace import Workspace

SHOWN_MODES = (1, 2, 5, 10, 20, 30)


def make_basis(workspace: Workspace) -> None:
    """Decompose the reference snapshots of the training runs."""
    target = workspace.basis()
    case = workspace.case
    attributes = {"inner_product": case.basis.inner_product, **medium(case)}
    with workspace.create(target, attributes) as artifact:
        with ExitStack() as stack:
            maps = [
                stack.enter_context(workspace.open(workspace.mapped(p)))
                for p in case.plan.train_points
            ]
            points = maps[0].read("reference_position")
            # Every point of the reference space represents the same volume (Eq. 3.15).
            volume = np.full(len(points), case.plan.particle_spacing ** points.shape[1])
            artifact.write("reference_position", points)
            artifact.write("volume", volume)
            started = time.perf_counter()
            means = _mean_densities(workspace, maps, volume)
            bases = _decompose(workspace, maps, volume, means, "reference snapshots")
            artifact.annotate("timing/decomposition", time.perf_counter() - started)
        if means is not None:
            for point, mean in zip(case.plan.train_points, means, strict=True):
                artifact.write(f"mean_density_fluctuation/{point.file_label}", mean)
        for name, basis in bases.items():
            write_record(artifact, basis, f"bases/{name}")
            trained = [list(point.as_dict().values()) for point in case.plan.bases[name]]
            artifact.write(f"bases/{name}/train", np.array(trained))
        if case.basis.lagrangian:
            _write_lagrangian(workspace, artifact, volume)
    for name, basis in bases.items():
        _report(workspace, name, basis)
    for warning in few_snapshots(case):
        workspace.context.report.warn(warning)


def _mean_densities(workspace: Workspace, runs: list[Artifact], volume: Array) -> Array | None:
    """Return the spatial mean (n_runs, n_snapshots) of the density fluctuation [kg/m3].

    None if the mean stays in the snapshots. One snapshot is read at a time.
    """
    if not workspace.case.plan.separate_mean_density:
        return None
    weights = inner_product(workspace.case).weights(volume)
    densities = [run.dataset("density_fluctuation") for run in runs]
    return np.array([[weighted_mean(d, weights) for d in density] for density in densities])


def _decompose(
    workspace: Workspace, runs: list[Artifact], volume: Array, means: Array | None, description: str
) -> dict[str, TrialBasis]:
    """Return the bases of the case from artifacts with density fluctuation and velocity."""
    case = workspace.case
    per_run = case.plan.steps.n_snapshots

    def read_block(points: slice) -> tuple[Array, Array]:
        densities = [run.dataset("density_fluctuation")[:, points] for run in runs]
        velocities = [run.dataset("velocity")[:, points] for run in runs]
        return np.concatenate(densities), np.concatenate(velocities)

    workspace.context.report.info(
        f"{description}: {per_run * len(runs)} snapshots of {len(volume)} points"
    )
    of_run = {
        point: np.arange(per_run) + per_run * run
        for run, point in enumerate(case.plan.train_points)
    }
    trained = {
        name: np.concatenate([of_run[point] for point in points])
        for name, points in case.plan.bases.items()
    }
    try:
        return decompose(
            read_block,
            n_points=len(volume),
            n_snapshots=per_run * len(runs),
            product=inner_product(case),
            volume=volume,
            n_modes={name: case.plan.basis_size(name) for name in trained},
            snapshots=trained,
            mean_density=None if means is None else means.ravel(),
            ram_limit=decomposition_ram_limit(),
        )
    except ValueError as error:
        raise CaseError(f"basis.n_modes, rom.n_modes: {error}") from error


def _write_lagrangian(workspace: Workspace, artifact: ArtifactWriter, volume: Array) -> None:
    """Decompose the unmapped snapshots too, for the paper's comparison of singular values."""
    with ExitStack() as stack:
        runs = [
            stack.enter_context(workspace.open(workspace.full_run(point)))
            for point in workspace.case.plan.train_points
        ]
        for trajectory in runs:
            require_complete(trajectory)
        means = _mean_densities(workspace, runs, volume)
        bases = _decompose(workspace, runs, volume, means, "Lagrangian snapshots")
        position = runs[0].dataset("position")[0]
    artifact.write("lagrangian_position", position)
    for name, basis in bases.items():
        write_record(artifact, Modes.of(basis), f"lagrangian/{name}")


def _report(workspace: Workspace, name: str, basis: TrialBasis) -> None:
    """Report the shares of the first modes, and their orthonormality."""
    values = basis.singular_values[JOINT]
    shares = cumulative_singular_value_share(values)
    energies = energy(values)
    workspace.context.report.table(
        f"basis {name}: {basis.n_modes} modes, Gram matrix within {basis.gram_error:.1e} of one",
        ("modes", "singular value", "share (Eq. 4.3) %", "energy %"),
        [
            (str(m), f"{values[m - 1]:.4g}", f"{shares[m - 1]:.4f}", f"{energies[m - 1]:.6f}")
            for m in SHOWN_MODES
            if m <= len(values)
        ],
    )
