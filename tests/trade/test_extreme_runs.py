from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.trade.extreme_runs import at_snapshots

DECAY = 1.0


def decaying() -> ReferenceModel:
    """One coordinate that turns into another while both decay."""
    linear = np.array([[-DECAY, -5.0], [5.0, -DECAY]])
    polynomial = Polynomial(((np.zeros(2), linear),))
    return ReferenceModel(
        polynomial=polynomial,
        basis=None,  # type: ignore[arg-type]
        start=np.array([1.0, 0.0]),
        mean_density_fluctuation=0.0,
        step_limit=spectrum(linear).step_limit,
        output_times=OutputTimes(0.05, 41, 3.0, 10.0),
    )


@pytest.mark.parametrize("time_step", [0.01, 0.0137, 0.1, 0.3])
def test_steps_need_not_divide_snapshots(time_step):
    times = 3.0 + 0.05 * np.arange(41)
    found = at_snapshots(decaying(), time_step, times)
    assert found is not None
    passed = times - 3.0
    exact = np.exp(-DECAY * passed) * np.array([np.cos(5.0 * passed), np.sin(5.0 * passed)])
    # Eq. 2.18 is of fourth order in the step times the eigenvalue's size, and so are the cubics.
    assert np.abs(found - exact.T).max() < 0.1 * (time_step * 5.1) ** 4


def test_a_step_may_be_as_long_as_the_run():
    found = at_snapshots(decaying(), 0.05, np.array([0.0, 0.02, 0.05]))
    assert found is not None
    assert found[1] == pytest.approx(np.exp(-0.02) * np.array([np.cos(0.1), np.sin(0.1)]), abs=1e-5)


def test_the_limit_divides_stable_from_unstable():
    model = decaying()
    times = np.arange(400.0)
    found = at_snapshots(model, 0.99 * model.step_limit, times)
    assert found is not None
    assert np.linalg.norm(found[-1]) < 1.0
    assert at_snapshots(model, 1.1 * model.step_limit, times) is None
