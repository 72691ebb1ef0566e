"""Figures of merit (Eq. 4.1 to 4.3), on fields and for sizes where they are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.histories import (
    compression_factors,
    cumulative_singular_value_share,
    energy,
    instantaneous_range,
    relative_discrepancy,
    relative_l2,
)


def discrepancy(approximation: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return relative_discrepancy(approximation, reference, instantaneous_range(reference))


def test_discrepancy_is_mean_error_over_range() -> None:
    reference = np.array([0.0, 1.0, 4.0])
    assert discrepancy(np.array([0.0, 2.0, 2.0]), reference) == pytest.approx(25.0)
    instants = np.array([[0.0, 2.0], [0.0, 0.5]])
    np.testing.assert_allclose(discrepancy(instants + 0.1, instants), [5.0, 20.0])


def test_the_range_may_be_that_of_a_whole_field() -> None:
    reference = np.array([[0.0, 1.0, 4.0], [0.0, 2.0, 8.0]])
    whole = np.array([[-5.0, 15.0], [0.0, 80.0]])
    found = relative_discrepancy(reference + 1.0, reference, instantaneous_range(whole))
    np.testing.assert_allclose(found, [5.0, 1.25])


@pytest.mark.parametrize("level", [0.0, 1000.1])
def test_a_constant_reference_is_refused(level: float) -> None:
    reference = np.full((3, 4), level)
    reference[[0, 2]] += np.arange(4.0)
    reference[1, 0] += level * 1e-16
    np.testing.assert_allclose(instantaneous_range(reference), [3.0, 0.0, 3.0])
    for constant in (reference, reference[1]):
        with pytest.raises(ValueError, match="constant"):
            discrepancy(constant, constant)


def test_l2_of_scalars_and_vectors() -> None:
    reference = np.array([3.0, 4.0])
    assert relative_l2(reference + np.array([0.0, 0.5]), reference) == pytest.approx(10.0)
    vectors = np.array([[[3.0, 0.0], [0.0, 4.0]], [[6.0, 0.0], [0.0, 8.0]]])
    np.testing.assert_allclose(relative_l2(1.02 * vectors, vectors, field_axes=2), [2.0, 2.0])


@pytest.mark.parametrize("measure", [discrepancy, relative_l2])
def test_errors_that_are_not_finite_are_refused(measure) -> None:
    field = np.arange(4.0)
    bad = ((np.array([0.0, np.nan, 2.0, 3.0]), field), (field, field + np.array([np.inf, 0, 0, 0])))
    for given in (*bad, (field, 0.0 * field)):
        with pytest.raises(ValueError, match="finite"):
            measure(*given)


def test_compression_factors_of_the_paper() -> None:
    assert compression_factors(300 * 300, 5) == (90_000, 54_000)
    assert compression_factors(300 * 300, 10) == (45_000, 27_000)


def test_shares_and_energy() -> None:
    values = np.array([3.0, 2.0, 1.0, 0.0])
    shares = cumulative_singular_value_share(values)
    np.testing.assert_allclose(shares, [50.0, 500.0 / 6.0, 100.0, 100.0])
    np.testing.assert_allclose(energy(values), [900.0 / 14.0, 1300.0 / 14.0, 100.0, 100.0])
    for nothing in (np.zeros(3), np.array([1.0, np.nan])):
        with pytest.raises(ValueError, match="finite"):
            energy(nothing)
