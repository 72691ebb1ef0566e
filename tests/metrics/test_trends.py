"""Fitted slopes recover the slopes they were made with; kinetic energy by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphrom.metrics.trends import exponential_rate, kinetic_energy, order_of_convergence


@given(order=st.floats(-3.0, 5.0), constant=st.floats(1e-6, 1e6))
def test_order_of_a_power_law(order: float, constant: float) -> None:
    spacing = np.array([0.04, 0.02, 0.01])
    assert order_of_convergence(spacing, constant * spacing**order) == pytest.approx(
        order, abs=1e-9
    )


@given(rate=st.floats(-50.0, 5.0), constant=st.floats(1e-6, 1e6))
def test_rate_of_an_exponential(rate: float, constant: float) -> None:
    time = np.linspace(0.0, 1.0, 20)
    assert exponential_rate(time, constant * np.exp(rate * time)) == pytest.approx(rate, abs=1e-9)


def test_fits_without_meaning_are_refused() -> None:
    with pytest.raises(ValueError, match="every error positive"):
        order_of_convergence(np.array([0.1, 0.2]), np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match="every value positive"):
        exponential_rate(np.array([0.0, 1.0]), np.array([1.0, np.nan]))
    with pytest.raises(ValueError, match="two different points"):
        order_of_convergence(np.array([0.1, 0.1]), np.array([1.0, 2.0]))


def test_kinetic_energy_of_snapshots() -> None:
    velocity = np.array([[[3.0, 4.0], [0.0, 2.0]], [[0.0, 0.0], [1.0, 0.0]]])
    np.testing.assert_allclose(kinetic_energy(velocity, 2.0), [29.0, 1.0])
    np.testing.assert_allclose(kinetic_energy(velocity, np.array([2.0, 4.0])), [33.0, 2.0])
