from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.stages.reference_runs import ReferenceModel
from sphrom.stages.trade_candidates import extreme_points
from sphrom.stages.trade_extremes import _at_snapshots
from sphrom.stages.trade_stability import MOST_GROWTH, ExtremeRow, stability_maps, state_of

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
        largest_norm=10.0,
    )


def test_states():
    assert state_of(None, None, 10.0) == "unstable"
    assert state_of(9.0, 100.0, 10.0) == "stable"
    assert state_of(11.0, 1.0, 10.0) == "inaccurate"
    assert state_of(None, MOST_GROWTH, 10.0) == "stable"
    assert state_of(None, 1.1 * MOST_GROWTH, 10.0) == "inaccurate"


@pytest.mark.parametrize("time_step", [0.01, 0.0137, 0.1, 0.3])
def test_steps_need_not_divide_snapshots(time_step):
    times = 3.0 + 0.05 * np.arange(41)
    found = _at_snapshots(decaying(), time_step, times)
    assert found is not None
    passed = times - 3.0
    exact = np.exp(-DECAY * passed) * np.array([np.cos(5.0 * passed), np.sin(5.0 * passed)])
    # Eq. 2.18 is of fourth order in the step times the eigenvalue's size, and so are the cubics.
    assert np.abs(found - exact.T).max() < 0.1 * (time_step * 5.1) ** 4


def test_a_step_may_be_as_long_as_the_run():
    found = _at_snapshots(decaying(), 0.05, np.array([0.0, 0.02, 0.05]))
    assert found is not None
    assert found[1] == pytest.approx(np.exp(-0.02) * np.array([np.cos(0.1), np.sin(0.1)]), abs=1e-5)


def test_the_limit_divides_stable_from_unstable():
    model = decaying()
    times = np.arange(400.0)
    found = _at_snapshots(model, 0.99 * model.step_limit, times)
    assert found is not None
    assert np.linalg.norm(found[-1]) < 1.0
    assert _at_snapshots(model, 1.1 * model.step_limit, times) is None


def test_values_reach_out_of_the_trained_range():
    case = Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "taylor-green"},
            "parameters": {"train": {"reynolds": [100, 200]}},
            "trade": {"extremes": {"reynolds_factors": [10.0, 0.1, 1.0, 0.5]}},
        }
    )
    values = [point.reynolds for point in extreme_points(case)]
    assert values == pytest.approx([10.0, 50.0, 200.0, 2000.0])


def test_maps_say_where_nothing_is_compared():
    def row(parameters: str, n_modes: int, factor: float, compared_with: str) -> ExtremeRow:
        return ExtremeRow(
            parameters,
            n_modes,
            factor,
            0.1,
            "stable",
            math.pi,
            1.0,
            compared_with,
            calibrated=False,
        )

    rows = [row("a", 2, 1.0, ""), row("b", 5, 0.5, "full run"), row("b", 2, 1.0, "full run")]
    first, second = stability_maps(rows)
    assert first.title == "a\n(no full run)"
    assert second.title == "b"
    assert (second.n_modes, second.step_factors) == ([2, 5], [0.5, 1.0])
    assert first.states == {(2, 1.0): "stable"}
