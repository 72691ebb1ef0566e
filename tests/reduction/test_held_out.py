"""Shares of changes that bases don't hold, against bases that are made and projected onto."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.reduction.decomposition import decompose
from sphrom.reduction.held_out import (
    UNTRIED,
    SnapshotProducts,
    UnheldShares,
    output_shares,
    snapshot_products,
    unheld_shares,
)
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis, project, reconstruct

N_POINTS, PER_RUN, N_MODES = 40, 20, 3
DENSITY, SPEED = 1.2, 10.0
PLACES = np.log([[100.0], [200.0], [300.0]])
VOLUME = np.full(N_POINTS, 0.01)
Array = np.ndarray


def snapshots(n_runs: int) -> tuple[Array, Array]:
    """Return runs of a few patterns that change with time and parameter, with some noise."""
    random = np.random.default_rng(1)
    patterns = random.standard_normal((6, 3 * N_POINTS))
    time = np.linspace(0.0, 1.0, PER_RUN)
    runs = []
    for x in PLACES[:n_runs, 0]:
        waves = [np.exp(-time * 100.0 / np.exp(x)), np.sin(x * time), time**2, x * time, time**3]
        runs.append(np.stack([*waves, np.cos(3.0 * x * time)], axis=1) @ patterns)
    states = np.concatenate(runs) + 1e-3 * random.standard_normal((n_runs * PER_RUN, 3 * N_POINTS))
    return 0.1 * states[:, :N_POINTS], states[:, N_POINTS:].reshape(-1, N_POINTS, 2)


def made(density: Array, velocity: Array, n_modes: int) -> TrialBasis:
    return decompose(
        lambda points: (density[:, points], velocity[:, points]),
        N_POINTS,
        len(density),
        InnerProduct.acoustic(DENSITY, SPEED),
        VOLUME,
        {"all": n_modes},
        {"all": np.arange(len(density))},
    )["all"]


def errors_of(basis: TrialBasis, density: Array, velocity: Array) -> Array:
    """Return mean squares (2,) of the errors of velocity and of q less its mean."""
    found = reconstruct(basis, project(basis, density, velocity))
    missed = SPEED / DENSITY * (density - found[0])
    missed = missed - missed.mean(axis=1, keepdims=True)
    flow = np.sum((velocity - found[1]) ** 2, axis=2)
    return np.array([flow.mean(), np.mean(missed**2)])


def share(other: TrialBasis, whole: TrialBasis, left: list[Array], change: list[Array]) -> Array:
    """Return the root of the errors that the other basis has beyond the whole, over a change."""
    excess = errors_of(other, *left) - errors_of(whole, *left)
    squares = (SPEED / DENSITY * change[0]) ** 2 + np.sum(change[1] ** 2, axis=2)
    return np.sqrt(np.maximum(excess, 0.0) / np.mean(squares @ VOLUME))


def multiplied(density: Array, velocity: Array) -> SnapshotProducts:
    basis = made(density, velocity, 6)
    blocks = [(r, density[:, r], velocity[:, r]) for r in (slice(0, 17), slice(17, N_POINTS))]
    return snapshot_products(basis, len(density), SPEED / DENSITY, blocks)


def found(density: Array, velocity: Array, n_runs: int) -> UnheldShares:
    return unheld_shares(multiplied(density, velocity), PLACES[:n_runs], N_MODES)


def test_a_run_left_out_is_one_that_a_basis_has_not_learnt() -> None:
    density, velocity = snapshots(2)
    shares = found(density, velocity, 2)
    for n_modes in (1, N_MODES):
        whole, expected = made(density, velocity, n_modes), []
        for out, kept in ((slice(0, 20), slice(20, 40)), (slice(20, 40), slice(0, 20))):
            other = made(density[kept], velocity[kept], n_modes)
            late = slice(out.start + 2, out.stop)
            near = slice(kept.start + 2, kept.stop)
            left = [density[late], velocity[late]]
            change = [left[0] - density[near], left[1] - velocity[near]]
            expected.append(share(other, whole, left, change))
        np.testing.assert_allclose(
            shares.parameters[n_modes - 1, :2], np.max(expected, axis=0), rtol=1e-5, atol=1e-6
        )


def test_a_pressure_in_modes_of_its_own_misses_what_they_do() -> None:
    """They are those of states that have no velocity."""
    density, velocity = snapshots(2)
    density -= density.mean(axis=1)[:, None]
    own, still = (found(density, v, 2).parameters for v in (velocity, 0.0 * velocity))
    squares = [  # of the changes that the shares are over
        np.sum((SPEED / DENSITY * (density[2:20] - density[22:])) ** 2) + np.sum(change**2)
        for change in (velocity[2:20] - velocity[22:], np.zeros(1))
    ]
    ratio = np.sqrt(squares[1] / squares[0])
    np.testing.assert_allclose(own[:, 2], ratio * still[:, 1], rtol=1e-6)


def test_outputs_miss_what_a_basis_misses_of_them() -> None:
    """The velocity at a point, and an integral of the pressure."""
    density, velocity = snapshots(2)
    weights = np.random.default_rng(2).standard_normal((2, N_POINTS))
    outputs = np.stack((velocity[:, 3, 0], SPEED / DENSITY * density @ weights[0]), axis=1)
    shares = output_shares(
        multiplied(density, velocity), outputs, np.array([0, 1]), PLACES[:2], N_MODES
    )
    for n_modes in (1, N_MODES):
        whole, squares, fields = made(density, velocity, n_modes), 0.0, 0.0
        for out, kept in ((slice(0, 20), slice(20, 40)), (slice(20, 40), slice(0, 20))):
            late = slice(out.start + 2, out.stop)
            for basis, sign in ((made(density[kept], velocity[kept], n_modes), 1), (whole, -1)):
                states = reconstruct(basis, project(basis, density[late], velocity[late]))
                q = SPEED / DENSITY * states[0] @ weights[0]
                missed = outputs[late] - np.stack((states[1][:, 3, 0], q), axis=1)
                squares += sign * np.mean(missed**2, axis=0)
                fields += sign * errors_of(basis, density[late], velocity[late])
        np.testing.assert_allclose(shares[n_modes - 1], np.sqrt(squares / fields), rtol=1e-5)
    alone = output_shares(
        multiplied(density[:20], velocity[:20]), outputs[:20], np.zeros(2, int), PLACES[:1], 2
    )
    np.testing.assert_array_equal(alone, 0.0)


@pytest.mark.parametrize("n_runs", [1, 2])
def test_the_second_half_is_left_out(n_runs) -> None:
    density, velocity = snapshots(n_runs)
    early = np.arange(n_runs * PER_RUN) % PER_RUN < 10
    other, whole = (made(density[k], velocity[k], N_MODES) for k in (early, slice(None)))
    shares = found(density, velocity, n_runs)
    for run in range(n_runs):
        late = slice(run * PER_RUN + 10, (run + 1) * PER_RUN)
        left = [density[late], velocity[late]]
        change = [left[0] - density[late.start - 1], left[1] - velocity[late.start - 1]]
        expected = share(other, whole, left, change)
        time = shares.time[run, N_MODES - 1, :2]
        np.testing.assert_allclose(time, expected, rtol=1e-5, atol=1e-6)


def test_of_a_single_run_the_change_with_time_stands_for_that_with_the_parameters() -> None:
    shares = found(*snapshots(1), 1)
    np.testing.assert_allclose(shares.parameters, UNTRIED * shares.time[0])


def test_of_runs_between_others_nothing_is_left_out() -> None:
    density, velocity = snapshots(3)
    shares = found(density, velocity, 3)
    assert (shares.parameters > 0.0).any()
    wild = density.copy(), velocity.copy()
    wild[1][20:40] *= 1.0 + 1e-9
    np.testing.assert_allclose(found(*wild, 3).parameters, shares.parameters, rtol=1e-3)


def test_equal_runs_have_no_change_to_hold() -> None:
    density, velocity = snapshots(1)
    twice = np.concatenate((density, density)), np.concatenate((velocity, velocity))
    np.testing.assert_array_equal(found(*twice, 2).parameters, 0.0)


def test_without_a_mean_density_none_is_counted() -> None:
    density, velocity = snapshots(1)
    basis = replace(made(density - density.mean(axis=1)[:, None], velocity, 4), separate_mean=True)
    products = []
    for shift in (0.0, 3.0):
        blocks = [(slice(0, N_POINTS), density + shift, velocity)]
        products.append(snapshot_products(basis, len(density), SPEED / DENSITY, blocks))
    np.testing.assert_allclose(products[1].states, products[0].states, atol=1e-9)
    np.testing.assert_allclose(products[1].fields[1], products[0].fields[1], atol=1e-7)
