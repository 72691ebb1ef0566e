from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphrom.errors import CaseError
from sphrom.metrics.fronts import break_even, pareto_front
from sphrom.metrics.histories import ERRORS, EXACT, NO_ERRORS, Errors, mean_errors
from sphrom.plots.tables import flat
from sphrom.trade.advice import Tolerance, cheapest, most_accurate, parse_tolerance
from sphrom.trade.table import (
    ESTIMATES,
    NO_ESTIMATES,
    NO_MEASURED,
    TRADE_ERRORS,
    Measure,
    ModelRow,
    with_fronts,
)

MEASURE = Measure("line")
costs = st.lists(st.none() | st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=12)


def errors(velocity: float, pressure: float) -> Errors:
    """Errors twice as large at worst, three times as large over the field; tiny in Eq. 4.1."""
    values = {"velocity": velocity, "pressure": pressure}
    factors = {"line": 1.0, "line_peak": 2.0, "field": 3.0, "field_peak": 6.0}
    found = dict.fromkeys(ERRORS, 1e-9)
    for (quantity, value), (where, factor) in product(values.items(), factors.items()):
        place, _, peak = where.partition("_")
        found[f"{quantity}_{place}_relative_l2" + ("_peak" if peak else "")] = factor * value
    return found


def model(name: str, seconds: float | None, found: Errors) -> ModelRow:
    return ModelRow(
        model=name,
        family="Galerkin",
        kind="operators",
        resolution=100,
        time_step=1e-3,
        stable=seconds is not None,
        offline_seconds=10.0,
        online_seconds=seconds,
        errors=found,
    )


def test_the_front_holds_what_nothing_beats():
    costs = [(1.0, 5.0), (2.0, 5.0), (2.0, 3.0), (3.0, 4.0), None, (9.0, 1.0), (2.0, 3.0)]
    assert pareto_front(costs) == [True, False, True, False, False, True, True]


@given(costs)
def test_the_front_agrees_with_its_definition(found):
    front = pareto_front(found)
    for cost, on_front in zip(found, front, strict=True):
        beaten = cost is not None and any(
            other is not None and np.all(np.subtract(other, cost) <= 0) and other != cost
            for other in found
        )
        assert on_front == (cost is not None and not beaten)
    if any(cost is not None for cost in found):
        assert any(front)


def test_the_two_errors_have_fronts_of_their_own():
    rows = [
        model("own", 0.1, EXACT),
        model("fast", 1.0, errors(3.0, 3.0)),
        model("slow", 2.0, errors(1.0, 4.0)),
        model("unstable", None, NO_ERRORS),
    ]
    marked = with_fronts(rows, MEASURE)
    assert [row.velocity_front for row in marked] == [False, True, True, False]
    assert [row.pressure_front for row in marked] == [False, True, False, False]
    assert [row.model for row in marked] == [row.model for row in rows]


@pytest.mark.parametrize(
    ("once", "full", "online", "runs"),
    [
        (10.0, 2.0, 0.0, 5),
        (10.0, 2.0, 1.0, 10),
        (10.1, 2.0, 1.0, 11),
        (0.5, 2.0, 1.0, 1),
        (10.0, 1.0, 1.0, None),
        (10.0, 1.0, 2.0, None),
        (None, 2.0, 1.0, None),
        (10.0, None, 1.0, None),
    ],
)
def test_break_even(once, full, online, runs):
    assert break_even(once, full, online) == runs
    if runs is not None:
        assert once + runs * online <= runs * full
        assert runs == 1 or once + (runs - 1) * online > (runs - 1) * full


def test_the_cheapest_within_a_tolerance():
    rows = [
        model("coarse", 1.0, errors(2.0, 0.5)),
        model("wrong pressure", 2.0, errors(0.5, 2.0)),
        model("slower", 4.0, errors(0.1, 0.1)),
        model("right", 3.0, errors(1.0, 1.0)),
        model("unstable", None, NO_ERRORS),
    ]

    def name(tolerance: Tolerance, measure: Measure = MEASURE) -> str | None:
        found = cheapest(rows, tolerance, measure)
        return None if found is None else found.model

    assert name(Tolerance(1.0, 1.0)) == "right"
    assert name(Tolerance(0.9, 0.9)) == "slower"
    assert name(Tolerance(1.0, 2.0)) == "wrong pressure"
    assert name(Tolerance(0.05, 5.0)) is None
    assert name(Tolerance(1.0, 1.0), Measure("field")) == "slower"
    assert name(Tolerance(0.2, 0.2), Measure("field")) is None
    assert cheapest([], Tolerance(1.0, 1.0), MEASURE) is None
    best = most_accurate(rows, "pressure", MEASURE)
    assert best is not None
    assert best.model == "slower"
    assert most_accurate(rows[-1:], "velocity", MEASURE) is None


@pytest.mark.parametrize(
    ("text", "tolerance"),
    [
        ("1%", Tolerance(1.0, 1.0, one_for_both=True)),
        ("1", Tolerance(1.0, 1.0, one_for_both=True)),
        ("1%,1%", Tolerance(1.0, 1.0)),
        ("0.5 %, 3%", Tolerance(0.5, 3.0)),
        ("1e-1%", Tolerance(0.1, 0.1, one_for_both=True)),
    ],
)
def test_tolerances(text, tolerance):
    assert parse_tolerance(text) == tolerance
    assert ("as one tolerance says" in tolerance.words(("velocity", "pressure"))) == (
        "," not in text
    )


@pytest.mark.parametrize("text", ["", "%", "0%", "-1%", "nan", "inf%", "1,2,3", "one", "1%%"])
def test_what_is_no_tolerance(text):
    with pytest.raises(CaseError, match="--tolerance: must be a percentage above zero") as caught:
        parse_tolerance(text)
    assert repr(text) in str(caught.value)


def test_errors_of_several_runs():
    both = mean_errors([errors(1.0, 2.0), errors(3.0, 1.0)])
    assert (both["velocity_line_relative_l2"], both["pressure_line_relative_l2"]) == (2.0, 1.5)
    peaks = (both["velocity_line_relative_l2_peak"], both["pressure_line_relative_l2_peak"])
    assert peaks == (6.0, 4.0)
    assert mean_errors([errors(1.0, 2.0), NO_ERRORS]) == NO_ERRORS


def test_rows_name_the_model_first_and_errors_last():
    names = list(flat(model("a", 1.0, {**errors(1.0, 2.0), **NO_MEASURED})))
    assert names[0] == "model"
    assert names[-len(TRADE_ERRORS) - len(ESTIMATES) :] == [*TRADE_ERRORS, *ESTIMATES]


def test_estimates_are_means_over_the_runs_that_all_have_them():
    one, other, both = (
        dict(zip(ESTIMATES, values, strict=True))
        for values in ((1.0, 2.0, 3.0, 4.0), (3.0, 2.0, 5.0, 0.0), (2.0, 2.0, 4.0, 2.0))
    )
    assert mean_errors([one, other]) == both
    assert mean_errors([one, NO_ESTIMATES]) == NO_ESTIMATES


def test_a_measured_force_is_one_quantity_by_which_models_are_judged():
    judged = Measure("field", "drag", ("force",))

    def off(seconds: float, force: float) -> ModelRow:
        found = {**errors(9.0, 9.0), **NO_MEASURED, "measured_force_relative_l2": force}
        return model(f"{force}", seconds, found)

    rows = with_fronts([off(9.0, 0.0), off(1.0, 2.0), off(2.0, 1.0), off(3.0, 1.5)], judged)
    assert [row.measured_front for row in rows] == [False, True, True, False]
    assert not any(row.velocity_front or row.pressure_front for row in rows)
    best = cheapest(rows[1:], Tolerance(1.5, 0.1), judged)
    assert best is not None
    assert best.model == "1.0"
    assert judged.words == "relative L2 error of drag over time"
    assert Tolerance(1.5, 0.1).words(judged.quantities) == "1.5 % of force"
