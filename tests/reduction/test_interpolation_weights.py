"""Weights against linear interpolation in one parameter and in Delaunay triangles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from sphrom.reduction.correction import interpolation_weights, spline_weights

LINE = np.log([[100.0], [400.0], [200.0]])


@pytest.mark.parametrize(("reynolds", "expected"), [(150.0, (0, 2)), (300.0, (1, 2))])
def test_between_two_points_they_are_linear(reynolds: float, expected: tuple[int, int]) -> None:
    place = np.log([reynolds])
    weights, distance = interpolation_weights(LINE, place)
    assert distance == 0.0
    assert tuple(np.flatnonzero(weights > 1e-9)) == expected
    np.testing.assert_allclose(weights @ LINE, place, rtol=1e-7)
    assert weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("reynolds", "nearest"), [(50.0, 0), (800.0, 1)])
def test_outside_the_nearest_point_counts(reynolds: float, nearest: int) -> None:
    weights, distance = interpolation_weights(LINE, np.log([reynolds]))
    np.testing.assert_allclose(weights, np.eye(3)[nearest], atol=1e-6)
    assert distance == pytest.approx(np.log(2.0), rel=1e-5)


def test_a_training_point_is_its_own() -> None:
    for k, place in enumerate(LINE):
        weights, distance = interpolation_weights(LINE, place)
        np.testing.assert_array_equal(weights, np.eye(3)[k])
        assert distance == 0.0


def test_of_a_single_point_everything_else_is_outside() -> None:
    assert interpolation_weights(LINE[:1], LINE[0])[1] == 0.0
    assert interpolation_weights(LINE[:1], LINE[1])[1] == pytest.approx(np.log(4.0))


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
