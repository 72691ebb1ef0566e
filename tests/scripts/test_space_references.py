"""The solutions in three dimensions, against balances and a plate that starts to move."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import erfc


def test_the_vortex_loses_the_energy_that_it_dissipates(script):
    flow = script("space_references").Vortex(16, 50.0)
    start, dissipation = flow.energy()
    assert start == pytest.approx(0.125, rel=1e-12)
    assert dissipation == pytest.approx(6.0 / 50.0 * start, rel=1e-12)
    x = np.arange(16) * math.pi / 8.0
    waves = np.cos(2.0 * x)
    expected = (waves[:, None] + waves)[:, :, None] * (waves + 2.0) / 16.0
    assert np.abs(flow.fields()[1] - expected).max() < 1e-12
    rates = [dissipation]
    for _ in range(2):
        flow.step(0.1)
        rates.append(flow.energy()[1])
    lost = 0.1 / 3.0 * np.dot([1.0, 4.0, 1.0], rates)
    assert start - flow.energy()[0] == pytest.approx(lost, rel=1e-4)


def test_a_lid_moves_the_fluid_below_it_as_a_plate_does(script):
    cube = script("space_references").Cube(32, 10.0)
    cube.advance(0.01)
    divergence = sum(np.diff(cube.velocity[axis], axis=axis) for axis in range(3))
    assert np.abs(divergence).max() < 1e-12
    below = np.array([0.9, 0.95, 0.97])
    expected = erfc((1.0 - below) / math.sqrt(4.0 * 0.1 * 0.01))
    # The flow that returns in the closed cube varies little over this layer.
    assert np.diff(cube.profiles(below)[0]) == pytest.approx(np.diff(expected), abs=0.03)
