from __future__ import annotations

import numpy as np
import pytest

from sphrom.case.hints import sweep_beyond_training
from sphrom.case.studies import sweep_model, sweep_name, sweep_points

FAST = "rom: [{name: slow}, {name: fast, evaluation: operators}]\n"
LOCAL = (
    "parameters: {train: {reynolds: [100, 200, 300]}}\n"
    "basis: {subsets: {low: {reynolds: [100, 200]}, high: {reynolds: [200, 300]}}}\n"
    "rom: [{name: fast, evaluation: operators, basis: local, parameters: [150]}]\n"
)


@pytest.fixture
def values(load):
    """The Reynolds numbers of a sweep."""
    return lambda text: [
        p.reynolds for p in sweep_points(load(f"{FAST}sweep: {{reynolds: {text}}}\n"))
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[120, 110.5]", [120.0, 110.5]),
        ("{low: 100, high: 200, count: 5}", [100.0, 125.0, 150.0, 175.0, 200.0]),
        ("{low: 1, high: 100, count: 3, spacing: logarithmic}", [1.0, 10.0, 100.0]),
        ("{low: 100, high: 100.9, step: 0.3}", [100.0, 100.3, 100.6, 100.9]),
    ],
)
def test_spreads(values, text, expected):
    assert values(text) == pytest.approx(expected, rel=1e-12)


def test_drawn_values_are_of_their_seed_and_can_be_extended(values):
    few = values("{low: 100, high: 200, count: 5, spacing: random, seed: 3}")
    many = values("{low: 100, high: 200, count: 9, spacing: random, seed: 3}")
    assert many[:5] == few
    assert all(100.0 <= value < 200.0 for value in many)
    assert values("{low: 100, high: 200, count: 5, spacing: random, seed: 4}") != few


def test_a_latin_hypercube_has_a_value_in_every_part(values):
    found = values("{low: 100, high: 200, count: 20, spacing: latin-hypercube}")
    assert np.floor((np.array(found) - 100.0) / 5.0).tolist() == list(range(20))
    assert np.ptp(np.diff(found)) > 0.1


def test_values_may_be_close_to_one_another(load):
    """Drawn values often agree in six digits."""
    spread = "{low: 100, high: 200, count: 1000, spacing: random}"
    case = load(f"{FAST}sweep: {{model: full, reynolds: {spread}}}\n")
    points = sweep_points(case)
    assert len({f"{point.reynolds:g}" for point in points}) < 1000
    assert len({point.label for point in points}) == 1000
    assert len({point.file_label for point in points}) == 1000


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


def test_probes_in_a_solid_are_refused(refusal):
    base = "name: small\nscene:\n  kind: open-cavity\n"
    (line,) = refusal("sweep: {probes: [[0.02, 0.01]]}\n", base=base)
    assert "(0.02, 0.01) m is not in the fluid" in line


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (400, "reynolds=400 lies in the interval of no subset"),
        (250, "reynolds=250 has the local basis high, at none of whose values"),
    ],
)
def test_local_bases(load, refusal, value, words):
    (line,) = refusal(f"{LOCAL}sweep: {{reynolds: [{value}]}}\n")
    assert words in line
    assert load(f"{LOCAL}sweep: {{reynolds: [110, 190]}}\n")


def test_values_beyond_training_are_told_once_with_the_range(load):
    text = "parameters: {train: {reynolds: [100, 200]}}\n" + FAST
    assert sweep_beyond_training(load(text + "sweep: {reynolds: [100, 150, 200]}\n")) is None
    some = sweep_beyond_training(load(text + "sweep: {reynolds: [90, 150, 250, 300]}\n"))
    assert some is not None
    assert "3 of 4 values (from reynolds=90 to reynolds=300)" in some
    assert "trained range, 100 to 200: fast extrapolates there" in some
    full = load(text + "sweep: {model: full, reynolds: [300]}\n")
    assert sweep_beyond_training(full) is None
