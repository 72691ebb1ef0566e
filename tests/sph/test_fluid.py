"""Fluids, their steps, and the state equation."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.sph.fluid import (
    Discretization,
    Fluid,
    fluctuation_of,
    pressure_of,
    step_limits,
    volume_of,
)


def test_step_limits() -> None:
    fluid = Fluid(1000.0, 10.0, 0.01, 1.0)
    limits = step_limits(fluid, Discretization(0.01, 0.02))
    assert limits.acoustic == pytest.approx(1.5 * 0.02 / 10.0)
    assert limits.viscous == pytest.approx(0.125 * 0.02**2 / 0.01)
    assert limits.acoustic < limits.viscous
    assert step_limits(Fluid(1000.0, 10.0, 1.0, 1.0), Discretization(0.01, 0.02)).viscous < 1e-4


def test_state_equation() -> None:
    """Eq. 2.8, on fluctuations: a small pressure on a large density keeps its digits."""
    fluctuation = np.array([0.0, 1e-9, -2.0])
    pressure = pressure_of(fluctuation, 10.0)
    assert np.allclose(pressure, [0.0, 1e-7, -200.0], rtol=1e-15, atol=0.0)
    back = fluctuation_of(pressure, 10.0)
    assert np.allclose(back, fluctuation, rtol=1e-15, atol=0.0)
    assert volume_of(fluctuation, 1000.0, 5.0) == pytest.approx([5e-3, 5e-3, 5 / 998])
