"""Weights of training points, and corrections by defects whose reach is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from sphrom.reduction.correction import (
    FADED,
    faded,
    interpolation_weights,
    learn_correction,
    spline_weights,
)

TIME = np.linspace(0.0, 1.0, 201)
PLACES = np.log([[50.0], [100.0], [200.0], [400.0]])


def noise(seed: int, shape=(4, 201)) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.fixture(scope="module")
def defects() -> np.ndarray:
    """One mode whose defects all runs share, one that falls with the parameter, one of noise."""
    shared = np.broadcast_to(np.sin(9.0 * TIME), (4, 201))
    return np.stack((shared, PLACES * np.cos(3.0 * TIME), noise(0)), axis=2)


def test_training_runs_get_their_own_defects(defects):
    correction = learn_correction(PLACES, defects)
    for place, defect in zip(PLACES, defects, strict=True):
        assert np.allclose(correction.at(place), defect, atol=1e-4)


def test_between_training_runs_defects_that_they_share_are_interpolated(defects):
    added = learn_correction(PLACES, defects).at(np.log([150.0]))
    assert np.allclose(added[:, 0], defects[0, :, 0], atol=1e-3)
    assert np.allclose(added[:, 1], np.log(150.0) * np.cos(3.0 * TIME), atol=0.05)


def test_noise_that_other_runs_do_not_share_is_not_added(defects):
    correction = learn_correction(PLACES, defects, (np.arange(2), np.arange(2, 3)))
    for place in (np.log([150.0]), np.log([1000.0])):
        assert np.std(correction.at(place)[:, 2]) < 0.3


def test_what_modes_cancel_of_each_other_stays_cancelled(defects):
    """Pressure is a small difference of what modes contribute: they share their weights."""
    pressure = np.array([1.0, -2.0, 0.5])
    balanced = defects - (defects @ pressure)[..., None] * pressure / (pressure @ pressure)
    correction = learn_correction(PLACES, balanced)
    for place in (np.log([150.0]), np.log([700.0])):
        added = correction.at(place)
        assert np.abs(added @ pressure).max() < 1e-12 * np.abs(added).max()


def test_outside_the_nearest_defect_counts_ever_less(defects):
    correction = learn_correction(PLACES, defects[..., :2])
    near, far = (correction.at(np.log([value])) for value in (500.0, 1e6))
    assert np.allclose(near[:, 0], defects[-1, :, 0], atol=0.01)
    assert np.linalg.norm(far[:, 1]) < np.linalg.norm(near[:, 1])


def test_noise_alone_is_no_correction():
    assert learn_correction(PLACES, noise(1, (4, 201, 3))) is None


def test_a_run_held_out_has_what_the_others_give(defects):
    defects = defects[..., :2]
    correction = learn_correction(PLACES, defects)
    changed = defects.copy()
    changed[1] = 1e3
    other = replace(correction, defects=changed)
    assert np.array_equal(other.held_out(PLACES[1]), correction.held_out(PLACES[1]))
    assert np.allclose(correction.held_out(PLACES[1])[:, 0], defects[1, :, 0], atol=1e-3)


def test_several_parameters_in_any_order():
    places = np.log([[50.0, 1.0], [400.0, 1.0], [50.0, 2.0], [400.0, 2.0]])
    plane = (places @ [1.0, 2.0])[:, None, None] * np.sin(9.0 * TIME)[:, None]
    inside = np.log([140.0, 1.4])
    added = learn_correction(places, plane).at(inside)
    assert np.allclose(added[:, 0], inside @ [1.0, 2.0] * np.sin(9.0 * TIME), atol=0.2)
    order = [2, 0, 3, 1]
    assert np.allclose(learn_correction(places[order], plane[order]).at(inside), added)


def test_runs_that_diverged_are_left_out(defects):
    broken = defects.copy()
    broken[2, 150:] = np.nan
    correction = learn_correction(PLACES, broken)
    assert np.isfinite(correction.at(PLACES[2])).all()
    assert np.isfinite(correction.held_out(PLACES[2])).all()
    broken[[0, 1], 10] = np.nan
    assert learn_correction(PLACES, broken) is None
    assert learn_correction(PLACES[:1], defects[:1]) is None


def test_longer_runs_have_it_faded_out_without_a_kick():
    correction = np.ones((101, 2))
    assert np.array_equal(faded(correction, 101), correction)
    assert np.array_equal(faded(correction, 40), correction[:40])
    longer = faded(correction, 180)
    assert longer.shape == (180, 2)
    assert not longer[100:].any()
    kept = round((1.0 - FADED) * 100)
    assert np.array_equal(longer[: kept + 1], correction[: kept + 1])
    steps = np.abs(np.diff(longer[:, 0]))
    assert steps.max() < 2.0 / (FADED * 100)
    assert steps[[kept, 99]].max() < 0.3 * steps.max()


LINE = np.log([[100.0], [400.0], [200.0]])


@pytest.mark.parametrize(
    ("reynolds", "inside", "neighbours"),
    [(150.0, 150.0, {0, 2}), (300.0, 300.0, {1, 2}), (200.0, 200.0, {2}),
     (50.0, 100.0, {0}), (800.0, 400.0, {1})],
)  # fmt: skip
def test_weights_are_linear_between_points_and_the_nearest_counts_outside(
    reynolds: float, inside: float, neighbours: set[int]
) -> None:
    weights, distance = interpolation_weights(LINE, np.log([reynolds]))
    assert set(np.flatnonzero(weights > 1e-6)) == neighbours
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ LINE, np.log([inside]), rtol=1e-6)
    assert distance == pytest.approx(abs(np.log(reynolds / inside)), rel=1e-5)


def test_of_a_single_point_everything_else_is_outside() -> None:
    assert interpolation_weights(LINE[:1], LINE[0])[1] == 0.0
    assert interpolation_weights(LINE[:1], LINE[1])[1] == pytest.approx(np.log(4.0))


def test_corners_that_are_equally_near_share_their_weights() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    place = np.array([0.3, 0.4])
    weights, distance = interpolation_weights(corners, place)
    assert distance == 0.0
    # Of all weights that reproduce the place, these have the least norm.
    np.testing.assert_allclose(weights, [0.4, 0.2, 0.3, 0.1], rtol=1e-6)
    moved = corners + 1e-13 * np.random.default_rng(0).normal(size=corners.shape)
    np.testing.assert_allclose(interpolation_weights(moved, place)[0], weights, atol=1e-6)


def test_of_several_parameters_they_are_those_of_the_triangle() -> None:
    random = np.random.default_rng(0)
    places = random.random((12, 2))
    triangles = Delaunay(places)
    n_inside = 0
    for place in random.random((20, 2)):
        weights, distance = interpolation_weights(places, place)
        triangle = int(triangles.find_simplex(place))
        assert (distance > 0.0) == (triangle < 0)
        if triangle >= 0:
            n_inside += 1
            assert set(np.flatnonzero(weights > 1e-6)) <= set(triangles.simplices[triangle])
            np.testing.assert_allclose(weights @ places, place, atol=1e-7)
    assert 5 < n_inside < 20


def test_spline_weights_interpolate_smoothly_and_go_on_straight():
    places = np.log([[50.0], [100.0], [200.0], [400.0]])
    for k, place in enumerate(places):
        np.testing.assert_allclose(spline_weights(places, place), np.eye(4)[k], atol=1e-9)
    inside = spline_weights(places, np.log([140.0]))
    assert inside @ places[:, 0] == pytest.approx(np.log(140.0))
    curve = np.sin(places[:, 0])
    linear = interpolation_weights(places, np.log([140.0]))[0] @ curve
    assert abs(inside @ curve - np.sin(np.log(140.0))) < abs(linear - np.sin(np.log(140.0)))
    outside = [spline_weights(places, np.log([value])) @ curve for value in (500.0, 1000.0, 2000.0)]
    assert outside[2] - outside[1] == pytest.approx(outside[1] - outside[0], rel=0.5)


def test_spline_weights_of_several_parameters_sum_to_one():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    weights = spline_weights(square, np.array([0.3, 0.6]))
    np.testing.assert_allclose(weights @ square, [0.3, 0.6], atol=1e-9)
    # Two points on a line say nothing across it.
    assert spline_weights(square[:2], np.array([0.5, 0.7])).sum() == pytest.approx(1.0)
