"""Sweeps: their model, their values, draws, and how far these are from training."""

from __future__ import annotations

import pytest

from sphrom.case.hints import sweep_beyond_training
from sphrom.case.studies import sweep_model, sweep_name, sweep_points

FAST = "rom: [{name: slow}, {name: fast, evaluation: operators}]\n"
LID = (
    "name: lid\nscene: {kind: lid-driven-cavity}\n"
    "parameters: {train: {reynolds: [50, 200], lid: [0.5, 1]}}\n"
    "rom: [{name: fast, evaluation: operators}]\n"
)
NORM = "{distribution: norm, loc: 120, scale: 10}"
WIDE = "{distribution: norm, loc: 100, scale: 50}"


def sweep(sample: str) -> str:
    return f"sweep:\n  sample:\n    {sample}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[120, 110.5]", [120.0, 110.5]),
        ("{low: 100, high: 200, count: 5}", [100.0, 125.0, 150.0, 175.0, 200.0]),
        ("{low: 1, high: 100, count: 3, spacing: logarithmic}", [1.0, 10.0, 100.0]),
    ],
)
def test_spreads(load, text, expected):
    points = sweep_points(load(f"{FAST}sweep: {{reynolds: {text}}}\n"))
    assert [p.reynolds for p in points] == pytest.approx(expected, rel=1e-12)


def test_spread_values_have_no_digits_of_rounding(load):
    points = sweep_points(load(f"{FAST}sweep: {{reynolds: {{low: 5.1, high: 6.1, count: 41}}}}\n"))
    assert points[12].label == "reynolds=5.4"
    assert [p.reynolds for p in points] == [round(5.1 + 0.025 * k, 3) for k in range(41)]


@pytest.mark.parametrize(
    ("text", "model", "name"),
    [
        (FAST, "fast", "fast"),
        (f"{FAST}sweep: {{model: slow}}\n", "slow", "slow"),
        (f"{FAST}sweep: {{model: full, name: all}}\n", None, "all"),
        ("rom: [{name: slow}]\n", None, "full"),
        ("rom: []\n", None, "full"),
    ],
)
def test_the_model(load, text, model, name):
    case = load(text)
    found = sweep_model(case)
    assert (found.name if found else None, sweep_name(case)) == (model, name)


def test_values_beyond_training_are_told_once_with_the_range(load):
    text = "parameters: {train: {reynolds: [100, 200]}}\n" + FAST
    assert not list(sweep_beyond_training(load(text + "sweep: {reynolds: [100, 150, 200]}\n")))
    (some,) = sweep_beyond_training(load(text + "sweep: {reynolds: [90, 150, 250, 300]}\n"))
    assert "3 of 4" in some
    full = load(text + "sweep: {model: full, reynolds: [300]}\n")
    assert not list(sweep_beyond_training(full))


def test_distributions_that_reach_impossible_values_are_refused(refusal, load):
    (line,) = refusal(sweep(f"{{count: 99, reynolds: {WIDE}}}"), base=LID)
    assert "2.3 % of the values of norm are below" in line
    cut = "{distribution: truncnorm, a: -1.98, b: 1.98, loc: 100, scale: 50}"
    assert load(sweep(f"{{count: 99, reynolds: {cut}}}"), base=LID)
    # Another parameter may have any sign.
    assert load(sweep(f"{{count: 99, reynolds: [50, 60], lid: {WIDE}}}"), base=LID)


def test_draws_keep_all_digits_and_ranges_six(load):
    """Drawn values often agree in six digits; their labels don't."""
    drawn = sweep_points(load(sweep(f"{{count: 999, reynolds: {NORM}, lid: [0.5, 1]}}"), base=LID))
    assert len({f"{point.reynolds:.5g}" for point in drawn}) < 999
    assert len({point.label for point in drawn}) == len({p.file_label for p in drawn}) == 999
    ranges = sweep_points(load(sweep("{count: 9, reynolds: [50, 200], lid: [0.5, 1]}"), base=LID))
    assert [p.reynolds for p in ranges] == [float(f"{p.reynolds:.6g}") for p in ranges]


@pytest.mark.parametrize("method", ["random", "sobol", "saltelli"])
def test_draws_are_of_their_seed_and_can_be_extended(load, method):
    def points(count: int, seed: int = 3):
        given = f"{{count: {count}, method: {method}, seed: {seed}, reynolds: {NORM}, lid: {WIDE}}}"
        return sweep_points(load(sweep(given), base=LID))

    few, many = points(128), points(256)
    assert set(few) <= set(many)
    assert set(points(128, seed=4)).isdisjoint(few)
