"""Proper orthogonal decomposition against a plain SVD of the whole weighted matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphrom.errors import ResourceError
from sphrom.reduction.decomposition import decompose
from sphrom.reduction.trial_basis import (
    InnerProduct,
    TrialBasis,
    mean_density_fluctuation,
    project,
    reconstruct,
    truncate,
    weighted_mean,
)

N_POINTS, N_SNAPSHOTS = 211, 24
DENSITY, SOUND_SPEED = 1000.0, 10.0
PRODUCTS = {
    "acoustic": InnerProduct.acoustic(DENSITY, SOUND_SPEED),
    "raw": InnerProduct.raw(DENSITY),
}
SMALL = 8 * N_SNAPSHOTS**2 * 40
"""A limit that leaves room for a few blocks only."""


def _data(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    decay = 0.6 ** np.arange(N_SNAPSHOTS)
    mixing = rng.standard_normal((N_SNAPSHOTS, N_SNAPSHOTS)) * decay
    density = mixing @ rng.standard_normal((N_SNAPSHOTS, N_POINTS))
    velocity = np.tensordot(mixing, rng.standard_normal((N_SNAPSHOTS, N_POINTS, 2)), 1)
    volume = rng.uniform(0.5, 2.0, N_POINTS) / N_POINTS
    return density, velocity, volume


def _decompose(
    density, velocity, volume, product, n_modes, sizes=None, **options
) -> dict[str, TrialBasis]:
    """Return bases of subsets, and add the numbers of points that were read at once to `sizes`."""

    def read_block(points: slice):
        if sizes is not None:
            sizes.append(points.stop - points.start)
        return density[:, points], velocity[:, points]

    columns = {"all": np.arange(len(density))} | options.pop("snapshots", {})
    modes = dict.fromkeys(columns, n_modes)
    return decompose(
        read_block, density.shape[1], len(density), product, volume, modes, columns, **options
    )


def _matrix(first_field, velocity, weights) -> np.ndarray:
    """The whole weighted snapshot matrix, a column a snapshot."""
    root = np.sqrt(weights)
    flat = (velocity * root[:, None]).reshape(len(velocity), -1)
    return np.concatenate((first_field * root, flat), axis=1).T


@pytest.mark.parametrize("name", PRODUCTS)
def test_equals_svd_of_the_weighted_matrix(name: str) -> None:
    density, velocity, volume = _data()
    product = PRODUCTS[name]
    basis = _decompose(density, velocity, volume, product, 6)["all"]
    whole = _matrix(product.first_field(density), velocity, product.weights(volume))
    left, values, _ = np.linalg.svd(whole, full_matrices=False)
    np.testing.assert_allclose(basis.singular_values["joint"], values, atol=1e-14 * values[0])
    modes = _matrix(basis.density_modes, basis.velocity_modes, basis.weights)
    np.testing.assert_allclose(np.abs(left[:, :6].T @ modes), np.eye(6), atol=1e-9)
    assert np.abs(modes.T @ modes - np.eye(6)).max() < 1e-12
    assert basis.gram_error < 1e-12


def test_streamed_equals_unstreamed() -> None:
    data, sizes = (*_data(), PRODUCTS["acoustic"], 5), []
    whole = _decompose(*data)["all"]
    streamed = _decompose(*data, sizes=sizes, ram_limit=SMALL)["all"]
    assert max(sizes) * N_SNAPSHOTS * 3 * 8 < SMALL
    assert len(sizes) > 6
    np.testing.assert_allclose(streamed.density_modes, whole.density_modes, atol=1e-10)
    np.testing.assert_allclose(streamed.velocity_modes, whole.velocity_modes, atol=1e-10)


def test_a_subset_has_the_basis_of_its_own_snapshots() -> None:
    density, velocity, volume = _data()
    kept = np.array([3, 1, 5, 7, 9, 11, 13, 15])
    bases = _decompose(density, velocity, volume, PRODUCTS["raw"], 4, snapshots={"odd": kept})
    own = _decompose(density[kept], velocity[kept], volume, PRODUCTS["raw"], 4)["all"]
    values = own.singular_values["joint"]
    np.testing.assert_allclose(
        bases["odd"].singular_values["joint"], values, atol=1e-13 * values[0]
    )
    np.testing.assert_allclose(bases["odd"].density_modes, own.density_modes, atol=1e-7)
    np.testing.assert_allclose(bases["odd"].velocity_modes, own.velocity_modes, atol=1e-7)
    assert len(bases["all"].singular_values["joint"]) == N_SNAPSHOTS


@pytest.mark.parametrize("name", PRODUCTS)
def test_projection_error_is_the_tail_of_the_spectrum(name: str) -> None:
    density, velocity, volume = _data()
    product = PRODUCTS[name]
    basis = _decompose(density, velocity, volume, product, 5)["all"]
    best_density, best_velocity = reconstruct(basis, project(basis, density, velocity))
    error = _matrix(
        product.density_scale * (best_density - density), best_velocity - velocity, basis.weights
    )
    tail = np.sqrt(np.sum(basis.singular_values["joint"][5:] ** 2))
    assert np.linalg.norm(error) == pytest.approx(tail, rel=1e-9)


def test_acoustic_basis_does_not_depend_on_the_reference_density() -> None:
    density, velocity, volume = _data()
    heavy = _decompose(density, velocity, volume, InnerProduct.acoustic(1000.0, 10.0), 6)["all"]
    light = _decompose(density / 1000.0, velocity, volume, InnerProduct.acoustic(1.0, 10.0), 6)[
        "all"
    ]
    np.testing.assert_allclose(light.velocity_modes, heavy.velocity_modes, atol=1e-10)
    np.testing.assert_allclose(light.density_modes, heavy.density_modes, atol=1e-10)


def _prescribed(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Snapshots with given singular values in the raw product, at zero reference density."""
    rng = np.random.default_rng(3)
    left, _ = np.linalg.qr(rng.standard_normal((3 * N_POINTS, len(values))))
    right, _ = np.linalg.qr(rng.standard_normal((len(values), len(values))))
    whole = (right * values) @ left.T
    velocity = whole[:, N_POINTS:].reshape(len(values), N_POINTS, 2)
    return whole[:, :N_POINTS], velocity, np.ones(N_POINTS)


def test_small_singular_values_survive() -> None:
    values = 10.0 ** -np.arange(11.0)
    product = InnerProduct.raw(0.0)
    basis = _decompose(*_prescribed(values), product, 11)["all"]
    np.testing.assert_allclose(basis.singular_values["joint"], values, rtol=1e-4)
    assert basis.gram_error < 1e-12


def test_more_modes_than_rank_or_snapshots_is_refused() -> None:
    values = np.array([1.0, 0.5, 0.1, 0.0, 0.0])
    data = _prescribed(values)
    with pytest.raises(ValueError, match="rank 3: request at most 3 modes"):
        _decompose(*data, InnerProduct.raw(0.0), 4)
    with pytest.raises(ValueError, match=r"'all': 25 modes requested"):
        _decompose(*_data(), PRODUCTS["raw"], 25)


def test_too_little_memory_is_refused() -> None:
    with pytest.raises(ResourceError, match="raise the limit"):
        _decompose(*_data(), PRODUCTS["acoustic"], 2, ram_limit=1000)


def test_strongest_snapshot_of_a_mode_has_a_positive_coordinate() -> None:
    density, velocity, volume = _data()
    for sign in (1.0, -1.0):
        basis = _decompose(sign * density, sign * velocity, volume, PRODUCTS["acoustic"], 6)["all"]
        coordinates = project(basis, sign * density, sign * velocity)
        strongest = coordinates[np.abs(coordinates).argmax(axis=0), np.arange(6)]
        assert np.all(strongest > 0.0)


def test_truncated_basis_is_the_basis_of_fewer_modes() -> None:
    data = _data()
    five = _decompose(*data, PRODUCTS["acoustic"], 5)["all"]
    two = _decompose(*data, PRODUCTS["acoustic"], 2)["all"]
    cut = truncate(five, 2)
    np.testing.assert_allclose(cut.density_modes, two.density_modes, atol=1e-12)
    np.testing.assert_allclose(cut.velocity_modes, two.velocity_modes, atol=1e-12)
    with pytest.raises(ValueError, match="6 modes requested"):
        truncate(five, 6)


def test_mixing_particles_need_more_modes_than_fixed_points() -> None:
    """The same travelling wave on moving particles and on fixed points: Lagrangian use."""
    time, start = np.linspace(0.0, 1.0, 40), np.linspace(0.0, 1.0, 200, endpoint=False)
    lane_speed = np.repeat([0.0, 0.37, 0.71, 1.0], 50)
    moved = start + lane_speed * time[:, None]

    def decay_of(position: np.ndarray) -> np.ndarray:
        wave = np.sin(2.0 * np.pi * position)
        velocity = np.stack((wave, np.zeros_like(wave)), axis=-1)
        volume = np.full(200, 1.0 / 200)
        basis = _decompose(0.0 * wave, velocity, volume, PRODUCTS["acoustic"], 1)["all"]
        return basis.singular_values["joint"] / basis.singular_values["joint"][0]

    assert decay_of(np.broadcast_to(start, moved.shape))[1] < 1e-12
    assert decay_of(moved)[1] > 0.1


def _with_gauge(density, velocity, volume, product, n_modes, **options) -> TrialBasis:
    mean = weighted_mean(density, product.weights(volume))
    return _decompose(density, velocity, volume, product, n_modes, mean_density=mean, **options)[
        "all"
    ]


@pytest.mark.parametrize("name", PRODUCTS)
def test_modes_have_no_mean_density_where_it_is_carried_apart(name) -> None:
    density, velocity, volume = _data()
    basis = _with_gauge(density + 3.0, velocity, volume, PRODUCTS[name], 6)
    assert basis.separate_mean
    assert truncate(basis, 3).separate_mean
    largest = np.abs(basis.density_modes).max()
    assert np.abs(weighted_mean(basis.density_modes, basis.weights)).max() < 1e-13 * largest
    ordinary = _decompose(density + 3.0, velocity, volume, PRODUCTS[name], 6)["all"]
    assert not ordinary.separate_mean
    assert np.abs(weighted_mean(ordinary.density_modes, ordinary.weights)).max() > 1e-3 * largest


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-50.0, 50.0), min_size=N_SNAPSHOTS, max_size=N_SNAPSHOTS))
def test_a_gauge_makes_the_basis_blind_to_means(means: list[float]) -> None:
    density, velocity, volume = _data()
    shifted = density + np.array(means)[:, None]
    for product in PRODUCTS.values():
        basis = _with_gauge(density, velocity, volume, product, 4)
        other = _with_gauge(shifted, velocity, volume, product, 4)
        np.testing.assert_allclose(other.density_modes, basis.density_modes, atol=1e-9)
        np.testing.assert_allclose(
            project(basis, shifted, velocity), project(basis, density, velocity), atol=1e-9
        )
        np.testing.assert_allclose(
            mean_density_fluctuation(basis, shifted) - mean_density_fluctuation(basis, density),
            means,
            atol=1e-10,
        )


@pytest.mark.parametrize("name", PRODUCTS)
def test_states_come_back_with_their_means(name: str) -> None:
    density, velocity, volume = _data()
    drifting = density[:6] + np.linspace(-4.0, 9.0, 6)[:, None]
    basis = _with_gauge(drifting, velocity[:6], volume, PRODUCTS[name], 6)
    back, back_velocity = reconstruct(
        basis,
        project(basis, drifting, velocity[:6]),
        mean_density_fluctuation(basis, drifting),
    )
    np.testing.assert_allclose(back, drifting, atol=1e-9)
    np.testing.assert_allclose(back_velocity, velocity[:6], atol=1e-9)
    one = project(basis, drifting[2], velocity[2])
    alone, _ = reconstruct(basis, one, float(mean_density_fluctuation(basis, drifting[2])))
    np.testing.assert_allclose(alone, drifting[2], atol=1e-9)
