"""The instant and the profiles that pictures of a comparison show."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.compare.comparison_figures import _along, pictured_snapshot
from sphrom.metrics.measures import Samples
from sphrom.setup.assembly import without_air

TIME = np.linspace(0.0, 1.0, 101)


@pytest.mark.parametrize(
    ("energy", "snapshot"),
    [
        (np.exp(-2.0 * TIME), 50),  # a decay
        (1.0 - np.exp(-5.0 * TIME), 50),  # a start from rest
        (np.sin(np.pi * TIME) ** 2, 50),
        (np.sin(2.0 * np.pi * TIME) ** 2, 37),  # at rest at half time; sin^2 has the mean 1/2
        (np.zeros(101), 50),
    ],
)
def test_pictures_show_fluid_that_moves(energy, snapshot) -> None:
    assert pictured_snapshot(energy) == snapshot


def test_the_mean_of_a_profile_leaves_out_air() -> None:
    tank = {"kind": "custom", "box": {"upper": [1, 1]}, "fluid": {"level": 0.5}}
    case = Case.model_validate({"name": "tank", "scene": tank})
    pressure = np.array([[300.0, 200.0, 100.0, 0.0, 0.0]])
    velocity = np.where(pressure > 0.0, 0.1, 0.0)[..., None] * [1.0, 0.0]
    line = without_air(case, Samples(TIME[:1], velocity, pressure))
    expected = [[100.0, 0.0, -100.0, np.nan, np.nan]]
    np.testing.assert_array_equal(_along(line, "pressure less its mean"), expected)


def test_titles_leave_out_parameters_that_all_full_runs_share() -> None:
    scene = {"kind": "custom", "box": {"upper": [1, 1]}, "constants": {"rate": 5.0}}
    scene |= {"body_force": ["0.2*sin(rate*t)", 0]}

    def titles(**train: list[float]) -> list[str]:
        case = Case.model_validate({"name": "x", "scene": scene, "parameters": {"train": train}})
        return [case.plan.title(point) for point in case.plan.points]

    assert titles(reynolds=[250], rate=[5.1, 6.1]) == ["rate=5.1", "rate=6.1"]
    assert titles(reynolds=[100, 200]) == ["reynolds=100", "reynolds=200"]
    assert titles(reynolds=[250], rate=[5.1]) == ["reynolds=250, rate=5.1"]
