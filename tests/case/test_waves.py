"""Linear theory says before any run whether training has waves as steep as those asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from sphrom.case.hints import case_warnings, sweep_beyond_training
from sphrom.case.loader import load_case

Points = list[dict[str, float]]
CASE = Path(__file__).parents[2] / "cases" / "gallery" / "sloshing.yaml"


def steep(points: Points, **others: Points) -> list[str]:
    values = {"parameters.test.points": points, **others}
    case = load_case(CASE, values)
    told = [*case_warnings(case), *sweep_beyond_training(case)]
    return [text for text in told if "linear theory" in text]


def test_a_resonance_that_training_reaches_has_no_warning() -> None:
    assert steep([{"reynolds": 250, "ratio": 1.0, "strength": 0.006}]) == []
    assert steep([{"reynolds": 250, "ratio": 0.92, "strength": 0.01}]) == []


@pytest.mark.parametrize("key", ["parameters.test", "rom.0.parameters", "sweep"])
def test_a_higher_one_has_a_warning_with_a_strength_that_reaches_it(key: str) -> None:
    """The slope is in proportion to the strength, and largest in training at 1.1."""
    point = [{"reynolds": 250, "ratio": 1.0, "strength": 0.02}]
    keys = {"rom.0.parameters": point} if key.startswith("rom") else {}
    keys |= {"sweep.points": point} if key == "sweep" else {}
    usual = [{"reynolds": 250, "ratio": 0.92, "strength": 0.01}]
    (told,) = steep(usual if keys else point, **keys)
    assert told.startswith(f"{key}: at reynolds=250, ratio=1, strength=0.02 linear theory expects")
    assert "4 times as steep" in told
    assert "or with strength: 0.048 at reynolds=250, ratio=1.1, strength=0.012" in told
