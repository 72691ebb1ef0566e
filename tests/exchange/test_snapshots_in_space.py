"""Snapshots of other programs in a box in space: all components are read, and voids refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sphrom.errors import CaseError
from sphrom.exchange.conversion import Converter
from sphrom.exchange.foreign_files import Source
from sphrom.exchange.import_options import ImportOptions
from sphrom.exchange.instants import interpolated
from sphrom.metrics.grids import grid_points
from sphrom.sph.space_box import SpaceBox
from sphrom.sph.time_loop import Snapshot

BOX = SpaceBox((0.0, 0.0, 0.0), (1.0, 1.0, 0.5), (True, False, True))
N = 10
POSITION = grid_points(BOX.lower, BOX.upper, (N // 2, N, N))
VELOCITY = np.random.default_rng(0).uniform(-1.0, 1.0, POSITION.shape)


def case_of(n_particles: int = len(POSITION)) -> Any:
    """Return what an import needs of a case."""
    plan = SimpleNamespace(
        n_particles=n_particles, particle_spacing=1.0 / N, max_speed=1.0, sound_speed=20.0
    )
    return SimpleNamespace(
        scene=SimpleNamespace(domain=BOX),
        plan=plan,
        fluid=SimpleNamespace(reference_density=1000.0),
        basis=SimpleNamespace(lagrangian=False),
        discretization=SimpleNamespace(resolution=N),
    )


def written(path: Path, **changed: np.ndarray) -> Source:
    """Write a snapshot with some changed fields."""
    names = (*"xyz", *"uvw")
    columns = np.column_stack((POSITION, VELOCITY)).T
    fields = dict(zip(names, columns, strict=True)) | {"rho": np.full(len(POSITION), 1001.0)}
    np.savez(path, **(fields | changed))
    return Source(path)


def test_all_components_are_read_in_the_frame_of_the_scene(tmp_path: Path) -> None:
    moved = written(tmp_path / "a.npz", z=1000.0 * POSITION[:, 2] + 5.0, x=1000.0 * POSITION[:, 0],
                    y=1000.0 * POSITION[:, 1])  # fmt: skip
    options = ImportOptions(units="length=mm", origin="0,0,5")
    snapshot = Converter(case_of(), options, moved)(moved)
    np.testing.assert_allclose(snapshot.position.T, POSITION, atol=1e-12)
    np.testing.assert_array_equal(snapshot.velocity.T, VELOCITY)
    np.testing.assert_array_equal(snapshot.density_fluctuation, 1.0)


def test_options_name_three_components(tmp_path: Path) -> None:
    source = written(tmp_path / "a.npz")
    with pytest.raises(CaseError, match="--velocity: must be three names, like a,b,c"):
        Converter(case_of(), ImportOptions(velocity="u,v"), source)
    with pytest.raises(CaseError, match=r"--origin: must be three numbers .* like 0\.5,0\.5,0\.5"):
        Converter(case_of(), ImportOptions(origin="0,0"), source)


def test_a_box_that_particles_do_not_fill_is_refused(tmp_path: Path) -> None:
    filled = POSITION[:, 1] < 0.6
    fields = np.column_stack((POSITION, VELOCITY))[filled].T
    rho = np.full(int(filled.sum()), 1001.0)
    source = written(tmp_path / "a.npz", **dict(zip("xyzuvw", fields, strict=True)), rho=rho)
    with pytest.raises(CaseError, match=r"the box has no particles.*free surfaces, solids"):
        Converter(case_of(len(rho)), ImportOptions(), source)(source)


def test_motion_in_space_is_interpolated_across_periodic_edges() -> None:
    start = np.array([[0.95, 0.6], [0.5, 0.5], [0.48, 0.2]])
    rates = np.random.default_rng(1).uniform(-0.2, 0.2, (3, 3, 2))

    def at(time: float) -> Snapshot:
        way = sum(rate * time ** (k + 1) for k, rate in enumerate(rates))
        position = BOX.wrap((start + way).T).T
        return Snapshot(np.ascontiguousarray(position), np.full(2, time), 3.0 * way)

    near = [(node, at(node)) for node in (0.1, 0.2, 0.3, 0.4)]
    found, expected = interpolated(near, 0.26, BOX, 0.1), at(0.26)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-12)
