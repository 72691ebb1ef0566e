"""Interpolation to points, against weighted sums and fits over all particles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.kernels import SUPPORT_RATIO, interpolation
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.neighbourhood import sort_sources

SPACING = 0.0625
BOX = BoxDomain((0.0, 0.0), (1.0, 0.875), (True, True))


def interpolate(method: str, state: np.ndarray, points: np.ndarray, ratio: float, box=BOX):
    length = ratio * SPACING
    near = sort_sources(state[:2], box, SUPPORT_RATIO * length, SPACING)
    source = np.vstack((state[:2, near.particle] + near.image, state[2:, near.particle]))
    out = np.full((3, len(points)), -1.0)
    search = (
        np.ascontiguousarray(points.T), source, near.grid, near.cell_start,
        SUPPORT_RATIO * length, 1.0 / length,
    )  # fmt: skip
    if method == "mls":
        scratch = np.full((interpolation.N_CHUNKS, 90), np.nan)
        interpolation.moving_least_squares(*search, scratch, out)
    else:
        interpolation.shepard(*search, out)
    return out


@pytest.fixture
def points() -> np.ndarray:
    inside = np.random.default_rng(1).uniform(0.0, 1.0, (150, 2)) * BOX.lengths
    return np.vstack((inside, [[0.0, 0.0], [1.0, 0.875], [0.5, 0.0]]))


@pytest.mark.parametrize("kind", ["jittered", "random"])
@pytest.mark.parametrize("ratio", [1.7, 2.0, 4.0])
def test_shepard_equals_the_printed_sums(
    brute_force: type, scatter: Callable, points: np.ndarray, kind: str, ratio: float
) -> None:
    state = scatter((0.0, 0.0), SPACING, (16, 14), kind, seed=2)
    sums = brute_force(state[:2].T, BOX.lengths, (True, True), ratio * SPACING, SPACING)
    out = interpolate("shepard", state, points, ratio)
    for field, values in zip(state[2:], out, strict=True):
        assert np.max(np.abs(values - sums.shepard(points, field))) < 1e-12


@pytest.mark.parametrize(("kind", "ratio"), [("jittered", 2.0), ("jittered", 4.0), ("random", 4.0)])
def test_moving_least_squares_equal_a_fit_over_all_particles(
    brute_force: type, scatter: Callable, points: np.ndarray, kind: str, ratio: float
) -> None:
    state = scatter((0.0, 0.0), SPACING, (16, 14), kind, seed=3)
    sums = brute_force(state[:2].T, BOX.lengths, (True, True), ratio * SPACING, SPACING)
    out = interpolate("mls", state, points, ratio)
    for field, values in zip(state[2:], out, strict=True):
        assert np.max(np.abs(values - sums.moving_least_squares(points, field))) < 1e-10


@pytest.mark.parametrize("method", ["shepard", "mls"])
def test_constants_are_exact(scatter: Callable, points: np.ndarray, method: str) -> None:
    state = scatter((0.0, 0.0), SPACING, (16, 14), "random", seed=4)
    state[2:] = np.array([[1.0], [-20.0], [1e-7]])
    out = interpolate(method, state, points, 3.0)
    assert np.max(np.abs(out / [[1.0], [-20.0], [1e-7]] - 1.0)) < 1e-11


@pytest.mark.parametrize("kind", ["jittered", "random"])
def test_moving_least_squares_reproduce_quadratics(scatter: Callable, kind: str) -> None:
    """Also where the support is cut off by the end of the particles."""
    open_box = BoxDomain(BOX.lower, BOX.upper, (False, False))
    state = scatter((0.0, 0.0), SPACING, (16, 14), kind, seed=5)
    points = np.random.default_rng(6).uniform(0.05, 0.8, (90, 2))

    def fields(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack((1.0 + x - 2.0 * y, x * y + 3.0 * x * x, 0.5 - y * y + x))

    state[2:] = fields(*state[:2])
    out = interpolate("mls", state, points, 3.0, open_box)
    assert np.max(np.abs(out - fields(*points.T))) < 1e-10
    assert np.max(np.abs(interpolate("shepard", state, points, 3.0, open_box) - out)) > 1e-3


def test_points_without_particles_are_nan(scatter: Callable) -> None:
    open_box = BoxDomain((0.0, 0.0), (30.0, 30.0), (False, False))
    state = scatter((10.0, 10.0), SPACING, (16, 14), "jittered")
    far = np.array([[0.0, 0.0], [10.5, 29.0], [29.0, 10.5], [1.0, 10.5], [10.5, 1.0], [10.5, 10.5]])
    for method in ("shepard", "mls"):
        out = interpolate(method, state, far, 2.0, open_box)
        assert np.isnan(out[:, :5]).all()
        assert np.isfinite(out[:, 5]).all()
