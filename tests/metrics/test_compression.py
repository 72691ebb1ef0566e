"""Compression factors and shares (Eq. 4.2, 4.3) against the paper's figures and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.discrepancy import (
    compression_factor,
    cumulative_singular_value_share,
    energy,
    field_compression_factor,
)


def test_compression_factors_of_the_paper() -> None:
    assert compression_factor(300 * 300, 5) == 90_000
    assert compression_factor(300 * 300, 10) == 45_000
    assert field_compression_factor(300 * 300, 5) == 54_000
    with pytest.raises(ValueError, match="at least one mode"):
        compression_factor(100, 0)


def test_shares_and_energy() -> None:
    values = np.array([3.0, 2.0, 1.0, 0.0])
    np.testing.assert_allclose(
        cumulative_singular_value_share(values), [50.0, 500.0 / 6.0, 100.0, 100.0]
    )
    np.testing.assert_allclose(energy(values), [900.0 / 14.0, 1300.0 / 14.0, 100.0, 100.0])


@pytest.mark.parametrize("share", [cumulative_singular_value_share, energy])
def test_no_share_of_nothing(share) -> None:
    for values in (np.zeros(3), np.array([1.0, np.nan])):
        with pytest.raises(ValueError, match="no shares"):
            share(values)
