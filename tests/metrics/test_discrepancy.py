"""Eq. 4.1 and the relative L2 norm, on fields whose errors are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.discrepancy import (
    instantaneous_range,
    relative_discrepancy,
    relative_error_at,
    relative_l2,
    without_mean,
)


def test_discrepancy_is_mean_error_over_range() -> None:
    reference = np.array([0.0, 1.0, 4.0])
    assert relative_discrepancy(np.array([0.0, 2.0, 2.0]), reference) == pytest.approx(25.0)


def test_the_range_may_be_that_of_a_whole_field() -> None:
    reference = np.array([[0.0, 1.0, 4.0], [0.0, 2.0, 8.0]])
    whole = np.array([[-5.0, 15.0], [0.0, 80.0]])
    found = relative_discrepancy(reference + 1.0, reference, range_over=whole)
    np.testing.assert_allclose(found, [5.0, 1.25])
    with pytest.raises(ValueError, match="constant"):
        relative_discrepancy(reference, reference, range_over=np.ones((2, 2)))


def test_l2_over_points_and_time_weighs_instants_by_their_size() -> None:
    reference = np.array([[[3.0], [4.0]], [[30.0], [40.0]]])
    off = reference + np.array([[[5.0], [0.0]], [[0.0], [0.0]]])
    np.testing.assert_allclose(relative_l2(off, reference, field_axes=2), [100.0, 0.0])
    assert relative_l2(off, reference, field_axes=3) == pytest.approx(100.0 * 5.0 / 2525.0**0.5)


def test_histories_use_the_range_of_their_own_instant() -> None:
    reference = np.array([[0.0, 2.0], [0.0, 0.5]])
    np.testing.assert_allclose(relative_discrepancy(reference + 0.1, reference), [5.0, 20.0])


def test_discrepancy_is_symmetric_in_sign_and_free_of_scale() -> None:
    rng = np.random.default_rng(0)
    reference, error = rng.standard_normal((2, 5, 30))
    plain = relative_discrepancy(reference + error, reference)
    np.testing.assert_allclose(relative_discrepancy(reference - error, reference), plain)
    np.testing.assert_allclose(relative_discrepancy(7 * (reference + error), 7 * reference), plain)


@pytest.mark.parametrize("level", [0.0, 1000.1])
def test_constant_reference_is_refused_by_instant(level: float) -> None:
    reference = np.full((3, 4), level)
    reference[[0, 2]] += np.arange(4.0)
    reference[1, 0] += level * 1e-16
    np.testing.assert_allclose(instantaneous_range(reference), [3.0, 0.0, 3.0])
    with pytest.raises(ValueError, match=r"constant .* \(instant 1\)"):
        relative_discrepancy(reference, reference)
    with pytest.raises(ValueError, match="constant"):
        relative_discrepancy(reference[1], reference[1])


def test_l2_of_scalars_and_vectors() -> None:
    reference = np.array([3.0, 4.0])
    assert relative_l2(reference + np.array([0.0, 0.5]), reference) == pytest.approx(10.0)
    vectors = np.array([[[3.0, 0.0], [0.0, 4.0]], [[6.0, 0.0], [0.0, 8.0]]])
    np.testing.assert_allclose(relative_l2(1.02 * vectors, vectors, field_axes=2), [2.0, 2.0])
    with pytest.raises(ValueError, match="zero at all points"):
        relative_l2(reference, 0.0 * reference)


@pytest.mark.parametrize("measure", [relative_discrepancy, relative_l2])
def test_bad_fields_are_refused(measure) -> None:
    field = np.arange(4.0)
    with pytest.raises(ValueError, match="not finite"):
        measure(np.array([0.0, np.nan, 2.0, 3.0]), field)
    with pytest.raises(ValueError, match="not finite"):
        measure(field, np.array([0.0, np.inf, 2.0, 3.0]))
    with pytest.raises(ValueError, match="shapes differ"):
        measure(field[:3], field)


def test_without_mean_leaves_differences() -> None:
    field = np.array([[1.0, 3.0], [5.0, 6.0]])
    np.testing.assert_allclose(without_mean(field), [[-1.0, 1.0], [-0.5, 0.5]])


def test_errors_at_some_points_have_the_scale_of_all() -> None:
    reference = np.array([[[3.0, 4.0], [0.0, 0.0], [5.0, 0.0], [0.0, 5.0]]])
    error = np.zeros_like(reference)
    error[0, 1] = (0.3, 0.4)
    points = np.array([False, True, True, False])
    rms = 5.0 * np.sqrt(3.0 / 4.0)
    expected = 100.0 * 0.5 / np.sqrt(2.0) / rms
    np.testing.assert_allclose(relative_error_at(points, reference + error, reference), expected)
    np.testing.assert_allclose(relative_error_at(~points, reference + error, reference), 0.0)
    alone = relative_error_at(points, (reference + error)[0], reference[0])
    assert alone == pytest.approx(expected)
    everywhere = np.ones(4, dtype=bool)
    np.testing.assert_allclose(
        relative_error_at(everywhere, reference + error, reference),
        relative_l2(reference + error, reference, field_axes=2),
    )
    with pytest.raises(ValueError, match="no point"):
        relative_error_at(~everywhere, reference, reference)
    with pytest.raises(ValueError, match="zero at all points"):
        relative_error_at(points, reference, 0.0 * reference)
