"""The pseudo-inverse and the closure's step, against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.particle_model import (
    Projector,
    relative_step,
)

N_PARTICLES, N_MODES = 30, 4
RANDOM = np.random.default_rng(0)
BASIS = np.ascontiguousarray(RANDOM.standard_normal((N_PARTICLES, 3, N_MODES)).transpose(0, 2, 1))
WEIGHTS = RANDOM.uniform(0.5, 2.0, N_PARTICLES)
FIELDS = RANDOM.standard_normal((3, N_PARTICLES))
PROJECTOR = Projector(BASIS, WEIGHTS)


def rows_of(basis: np.ndarray) -> np.ndarray:
    """Return a basis as a matrix (3 N, n_modes), a particle's fields together."""
    return basis.transpose(0, 2, 1).reshape(-1, basis.shape[1])


def least_squares(basis: np.ndarray, weights: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return the weighted pseudo-inverse applied to fields, by numpy."""
    root = np.repeat(np.sqrt(weights), 3)
    rows = rows_of(basis)
    return np.linalg.lstsq(root[:, None] * rows, root * fields.T.ravel(), rcond=None)[0]


def test_equals_weighted_least_squares() -> None:
    expected = least_squares(BASIS, WEIGHTS, FIELDS)
    assert np.allclose(PROJECTOR(FIELDS), expected, rtol=1e-12, atol=1e-13)


def test_equals_sums_over_many_particles_on_any_number_of_threads(same_on_threads) -> None:
    """More particles than chunks and blocks hold, and no multiple of either."""
    random = np.random.default_rng(1)
    n = 32 * 64 + 45
    basis, fields = random.standard_normal((n, 3, 3)), random.standard_normal((3, n))
    weights = random.uniform(0.5, 2.0, n)
    (found,) = same_on_threads(
        lambda: (Projector(basis, weights, separate_mean=True).orthogonal(fields),)
    )
    constant = np.tile([1.0, 0.0, 0.0], (n, 1, 1))
    rows = np.concatenate((basis, constant), axis=1)
    left = fields.T.ravel() - rows_of(rows) @ least_squares(rows, weights, fields)
    assert np.allclose(found.T.ravel(), left, atol=1e-12)


def test_the_step_is_relative_to_each_field() -> None:
    """Neither field changes by more than its own size, whatever the units."""
    state = np.vstack((1e-3 * FIELDS[:1], FIELDS[1:]))
    direction = np.vstack((FIELDS[:1], 10.0 * FIELDS[1:]))
    assert relative_step(state, direction) == pytest.approx(1e-3)
    direction[0] = 0.0
    assert relative_step(state, direction) == pytest.approx(0.1)
    assert relative_step(2.0 * state, direction) == pytest.approx(0.2)
    assert relative_step(state, np.zeros_like(state)) == 0.0
