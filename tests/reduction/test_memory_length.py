"""The memory length of models on the reference points, and the operators of any viscosity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.reduction.reduced_rates import memory_length

SOUND_TIME = 2.0 / 40 / 10.0
"""What sound takes to cross a smoothing length of two spacings [s]."""


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (1e4, 0.2e-4),
        (0.5 / SOUND_TIME, 0.4 * SOUND_TIME),
        (0.3 / SOUND_TIME, 0.5 * SOUND_TIME),
        (1e-3, 0.5 * SOUND_TIME),
        (0.0, 0.5 * SOUND_TIME),
    ],
)
def test_rates_decide_until_sound_crosses_half_a_smoothing_length(
    case_of: Callable[..., Case], rate: float, expected: float
) -> None:
    case = case_of("lid-driven-cavity", discretization={"smoothing_length_ratio": 2.0})
    jacobian = rate * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -0.9]])
    assert memory_length(
        jacobian, case.plan.smoothing_length, case.plan.sound_speed
    ) == pytest.approx(expected, rel=1e-12)
