"""When the snapshots of training runs are, which calibrations are driven at."""

from __future__ import annotations

import pytest

from sphrom.case.models import Case
from sphrom.store.reduced_models import snapshot_times


@pytest.mark.parametrize("spin_up", [0.0, 0.5])
def test_snapshots_are_spread_from_the_spin_up_to_the_end(spin_up: float) -> None:
    case = Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "lid-driven-cavity"},
            "discretization": {"resolution": 20},
            "time": {"spin_up": spin_up, "final_time": 2.0},
        }
    )
    times = snapshot_times(case)
    assert len(times) == case.plan.steps.n_snapshots
    assert (times[0], times[-1]) == pytest.approx((spin_up, 2.0))
