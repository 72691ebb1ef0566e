"""Draws of parameters: what a case may ask for, and how the rest is refused."""

from __future__ import annotations

from sphrom.case.hints import sweep_beyond_training
from sphrom.case.studies import sweep_points

BASE = (
    "name: lid\nscene: {kind: lid-driven-cavity}\n"
    "parameters: {train: {reynolds: [50, 200], lid: [0.5, 1]}}\n"
    "rom: [{name: fast, evaluation: operators}]\n"
)
NORM = "{distribution: norm, loc: 120, scale: 10}"


def sweep(sample: str) -> str:
    return f"sweep:\n  sample:\n    {sample}\n"


def test_distributions_that_reach_impossible_values_are_refused_with_a_remedy(refusal, load):
    wide = "{distribution: norm, loc: 100, scale: 50}"
    (line,) = refusal(sweep(f"{{count: 99, reynolds: {wide}}}"), base=BASE)
    assert "norm has 2.3 % of its values where none is possible, as reynolds" in line
    remedy = "{distribution: truncnorm, a: -1.98, b: 1.98, loc: 100, scale: 50}"
    assert line.endswith(f"truncate it: {remedy}")
    assert load(sweep(f"{{count: 99, reynolds: {remedy}}}"), base=BASE)
    (line,) = refusal(
        sweep("{count: 99, reynolds: {distribution: uniform, loc: -1, scale: 9}}"), base=BASE
    )
    assert "uniform has 11 % of its values where none is possible" in line
    assert "choose one above zero (uniform, lognorm, beta)" in line
    # Another parameter may have any sign.
    assert load(sweep(f"{{count: 99, lid: {wide}}}"), base=BASE)


def test_quantiles_rise(refusal):
    (line,) = refusal("sweep: {quantiles: [0.5, 0.25]}\n", base=BASE)
    assert line.endswith("sweep.quantiles: must rise")
    (line,) = refusal("sweep: {quantiles: [50]}\n", base=BASE)
    assert "sweep.quantiles" in line
    assert "0.0001 to 0.9999" in line


def test_draws_keep_all_digits_and_ranges_six(load):
    drawn = sweep_points(load(sweep(f"{{count: 99, reynolds: {NORM}, lid: [0.5, 1]}}"), base=BASE))
    assert len({f"{point.reynolds:.6g}" for point in drawn} - {str(p.reynolds) for p in drawn}) > 90
    ranges = sweep_points(load(sweep("{count: 9, reynolds: [50, 200], lid: [0.5, 1]}"), base=BASE))
    assert all(f"{point.reynolds:.6g}" == f"{point.reynolds:g}" for point in ranges)
    assert [p.reynolds for p in ranges] == [float(f"{p.reynolds:.6g}") for p in ranges]


def test_draws_outside_of_training_are_counted(load):
    text = sweep("{count: 99, reynolds: {distribution: uniform, loc: 20, scale: 180}}")
    told = sweep_beyond_training(load(text, base=BASE))
    assert told is not None
    assert "of 99 points, such as reynolds=" in told
    assert "are outside of the trained ranges: fast extrapolates there" in told
