"""Flows in three dimensions: the Taylor-Green vortex of Brachet et al., and the driven cube."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.scenes.flows import LidDrivenCavity, LidDrivenCube, TaylorGreen3D

FLOW = TaylorGreen3D(length=3.0, speed=1.5, reference_density=800.0)
WAVE_NUMBER = 2.0 * np.pi / FLOW.length
STEP = 1e-3
"""Of fourth-order differences [m]: errors near 1e-10 of the terms."""
WEIGHTS = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
PLACES = np.random.default_rng(1).uniform(-1.0, 4.0, (50, 3))

Field = Callable[[np.ndarray], np.ndarray]


def slope(field: Field, axis: int) -> Field:
    """Return the derivative of a field along an axis, to fourth order."""
    step = STEP * np.eye(3)[axis]
    return lambda x: sum(w * field(x + n * step) for n, w in WEIGHTS.items()) / STEP


def test_the_vortex_starts_without_divergence_and_along_z_at_rest() -> None:
    parts = [slope(FLOW.initial_velocity, axis)(PLACES)[:, axis] for axis in range(3)]
    assert np.max(np.abs(sum(parts))) < 1e-8 * FLOW.speed * WAVE_NUMBER
    velocity = FLOW.initial_velocity(PLACES)
    assert not velocity[:, 2].any()
    assert 0.0 < np.abs(velocity).max() <= FLOW.speed


def test_the_pressure_of_the_vortex_solves_its_equation() -> None:
    """Laplacian of p = -rho (grad u : grad u), for flows without divergence."""
    gradient = np.stack([slope(FLOW.initial_velocity, axis)(PLACES) for axis in range(3)], axis=1)
    source = -FLOW.reference_density * np.einsum("nij,nji->n", gradient, gradient)
    bend = sum(slope(slope(FLOW.initial_pressure, axis), axis)(PLACES) for axis in range(3))
    np.testing.assert_allclose(bend, source, atol=1e-6 * np.abs(source).max())


def test_the_vortex_has_the_energy_and_the_dissipation_of_brachet() -> None:
    """U^2 / 8 per mass, and 3 nu k^2 U^2 / 4."""
    number = 12
    grid = (np.stack(np.meshgrid(*[np.arange(number)] * 3), -1).reshape(-1, 3) + 0.3) / number
    places = FLOW.length * grid
    energy = 0.5 * np.mean(np.sum(FLOW.initial_velocity(places) ** 2, axis=1))
    assert energy == pytest.approx(FLOW.speed**2 / 8.0)
    parts = [slope(FLOW.initial_velocity, axis)(places) for axis in range(3)]
    dissipation = np.mean(np.sum(np.square(parts), axis=(0, 2)))
    assert dissipation == pytest.approx(3.0 * WAVE_NUMBER**2 * FLOW.speed**2 / 4.0)
    assert FLOW.initial_pressure(places).mean() == pytest.approx(0.0, abs=1e-9)


def test_only_ghosts_above_the_cube_move_and_only_along_x() -> None:
    flow = LidDrivenCube(2.0, 1.5, "uniform")
    walls = flow.domain.ghosts(0.25, 2).moving(flow.wall_velocity)
    x, y, z = walls.position.T
    above = (y > 2.0) & (x > 0.0) & (x < 2.0) & (z > 0.0) & (z < 2.0)
    assert np.count_nonzero(above) == 2 * 8 * 8
    assert np.array_equal(walls.velocity[:, 0] > 0.0, above)
    assert set(walls.velocity[:, 0]) == {0.0, 1.5}
    assert not walls.velocity[:, 1:].any()


def test_the_regularised_lid_of_the_cube_vanishes_at_all_its_ends() -> None:
    flow = LidDrivenCube(2.0, 1.5)
    in_plane = LidDrivenCavity(2.0, 1.5)
    x = np.linspace(0.0, 2.0, 21)
    middle = np.column_stack((x, np.full(21, 2.1), np.full(21, 1.0)))
    np.testing.assert_allclose(flow.wall_velocity(middle)[:, 0], in_plane.lid_velocity(x))
    turned = flow.wall_velocity(middle[:, ::-1])  # x and z exchanged
    np.testing.assert_array_equal(turned, flow.wall_velocity(middle))
    assert flow.wall_velocity(middle)[[0, -1], 0].tolist() == [0.0, 0.0]
    assert not LidDrivenCube(2.0, 0.0).wall_velocity(middle).any()
