"""What `trade` recommends, and what it compares models with: doing nothing, and the full run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.case.points import ParameterPoint
from sphrom.metrics.histories import ERRORS, EXACT, Errors
from sphrom.metrics.samples import Samples
from sphrom.trade.advice import Tolerance, beaten, recommend, words
from sphrom.trade.nothing import NEAREST, UNCHANGED, nearest, nothing_rows, unchanged
from sphrom.trade.table import Measure, ModelRow, NothingRow, with_beaten

MEASURE = Measure("field")
OWN = "full, as in the case"


def errors(velocity: float, pressure: float) -> Errors:
    return {name: velocity if name.startswith("velocity") else pressure for name in ERRORS}


def model(
    name: str,
    seconds: float | None,
    found: Errors,
    kind: str = "operators",
    offline: float | None = 100.0,
) -> ModelRow:
    return ModelRow(
        model=name,
        family=name,
        kind=kind,
        resolution=10,
        time_step=1.0,
        offline_seconds=offline,
        training_seconds=None,
        online_seconds=seconds,
        speed_up=None if seconds is None else 10.0 / seconds,
        errors=found,
    )


def full(name: str, seconds: float | None, found: Errors = EXACT) -> ModelRow:
    return model(name, seconds, found, "full", 0.0)


def nothing(name: str, velocity: float, pressure: float) -> NothingRow:
    return NothingRow(name, errors(velocity, pressure))


def advised(rows, without, tolerance):
    """Return rows marked as a trade marks them, the recommendation and what is said."""
    marked = with_beaten(rows, without, MEASURE)
    advice = recommend(marked, without, tolerance, MEASURE)
    return marked, advice, words(advice, marked, tolerance, MEASURE)


def test_what_is_slower_than_the_full_run_is_not_recommended():
    rows = [full(OWN, 10.0), model("on particles", 20.0, errors(0.1, 0.1))]
    marked, advice, said = advised(rows, [], Tolerance(1.0, 1.0))
    assert marked[1].beaten_by == OWN
    assert advice.model is None
    assert f"better than doing nothing: {OWN} is no slower than on particles" in said
    (line,) = beaten(marked, [], MEASURE)
    assert line == f"{OWN} is no slower and nowhere worse than on particles: don't take these"


def test_what_is_slower_and_worse_than_a_coarser_full_run_is_not_recommended():
    rows = [
        full(OWN, 10.0),
        full("full, coarser", 1.0, errors(0.5, 0.5)),
        full("full, finer step", 20.0, errors(0.01, 0.01)),
        model("slow", 2.0, errors(0.6, 0.7)),
        model("as good in pressure", 2.0, errors(0.6, 0.4)),
    ]
    marked, advice, _ = advised(rows, [], Tolerance(1.0, 1.0))
    assert [row.beaten_by for row in marked] == [None, None, OWN, "full, coarser", None]
    assert (advice.model, advice.full_run) == ("full, coarser", "full, coarser")
    _, advice, _ = advised(rows, [], Tolerance(1.0, 0.45))
    assert (advice.model, advice.full_run) == ("as good in pressure", OWN)


def test_a_model_that_is_worse_than_a_training_run_is_not_recommended():
    without = [nothing(NEAREST, 2.0, 5.0), nothing(UNCHANGED, 30.0, 1.0)]
    rows = [
        full(OWN, 10.0),
        model("bad", 1e-6, errors(3.0, 6.0)),
        model("better in pressure", 1e-5, errors(2.5, 4.0)),
        model("good", 1e-4, errors(1.0, 2.0)),
    ]
    marked, advice, said = advised(rows, without, Tolerance(10.0, 10.0))
    assert [row.beaten_by for row in marked] == [None, NEAREST, None, None]
    assert advice.model == "better in pressure"
    assert advice.without_a_model == NEAREST
    assert said.endswith(f"without any model, {NEAREST} is within it too")
    lines = list(beaten(marked, without, MEASURE))
    assert lines == [
        f"{NEAREST} is no slower and nowhere worse than bad: don't take these",
        f"in velocity {NEAREST} (2.00 %) is no worse than better in pressure",
        f"in pressure {UNCHANGED} (1.00 %) is no worse than better in pressure; good",
    ]
    _, advice, said = advised(rows, without, Tolerance(1.5, 3.0))
    assert (advice.model, advice.without_a_model) == ("good", None)
    assert "without any model" not in said


def test_a_model_pays_from_some_run_on():
    rows = [full(OWN, 10.0), full("full, coarser", 2.5, errors(0.9, 0.9)),
            model("good", 0.5, errors(0.5, 0.5))]  # fmt: skip
    _, advice, said = advised(rows, [], Tolerance(1.0, 1.0, one_for_both=True))
    assert (advice.model, advice.full_run, advice.pays_from_run) == ("good", "full, coarser", 50)
    assert "pays from 50 runs on; for fewer take full, coarser" in said
    assert "within 1 % of velocity and of pressure alike, as one tolerance says" in said
    assert "relative L2 error over the field and time" in said
    assert advice.one_tolerance_for_both
    _, advice, _ = advised(rows, [], Tolerance(0.6, 0.6))
    assert (advice.full_run, advice.pays_from_run) == (OWN, 11)
    assert not advice.one_tolerance_for_both


def test_seconds_that_nobody_knows_are_not_zero():
    rows = [full(OWN, None), model("good", 0.5, errors(0.5, 0.5), offline=None)]
    rows[1] = replace(rows[1], speed_up=None)
    marked, advice, said = advised(rows, [], Tolerance(1.0, 1.0))
    assert marked[1].beaten_by is None
    assert (advice.model, advice.full_run, advice.pays_from_run) == ("good", None, None)
    assert "full run is unknown" in said


@pytest.mark.parametrize(
    ("reynolds", "expected"), [(150.0, 200.0), (130.0, 100.0), (100.0, 200.0), (1e4, 200.0)]
)
def test_the_nearest_training_run_is_another_one(reynolds, expected):
    trained = [ParameterPoint(100.0), ParameterPoint(200.0)]
    assert nearest(ParameterPoint(reynolds), trained) == ParameterPoint(expected)
    assert nearest(ParameterPoint(100.0), trained[:1]) is None


def _growing(rate: float) -> Samples:
    times = np.arange(3.0)
    values = 1.0 + rate * times
    return Samples(times, values[:, None, None] * np.ones((1, 2, 2)), values[:, None] * np.ones(2))


def test_doing_nothing_is_measured_against_the_full_runs():
    full_runs = {ParameterPoint(150.0): _growing(1.0), ParameterPoint(100.0): _growing(2.0)}
    trained = [ParameterPoint(100.0), ParameterPoint(200.0)]
    taken = []

    def sampled(point):
        return {100.0: _growing(2.0), 200.0: _growing(4.0)}[point.reynolds]

    def off(point, samples):
        taken.append((point.reynolds, float(samples.pressure[-1, 0])))
        return errors(abs(samples.pressure[-1, 0] - full_runs[point].pressure[-1, 0]), 0.0)

    def places(points):
        return np.log([[point.reynolds] for point in points])

    near, still = nothing_rows(full_runs, trained, sampled, off, places)
    assert (near.name, still.name) == (NEAREST, UNCHANGED)
    assert taken == [(150.0, 9.0), (100.0, 9.0), (150.0, 1.0), (100.0, 1.0)]
    assert near.errors["velocity_field_relative_l2"] == pytest.approx((6.0 + 4.0) / 2.0)
    assert near.errors["velocity_field_relative_l2_peak"] == pytest.approx(6.0)
    assert still.errors["velocity_field_relative_l2"] == pytest.approx((2.0 + 4.0) / 2.0)
    (only,) = nothing_rows(full_runs, trained[:1], sampled, off, places)
    assert only.name == UNCHANGED


def test_an_unchanged_flow_is_its_first_snapshot():
    still = unchanged(_growing(1.0))
    assert still.velocity.shape == (3, 2, 2)
    assert np.all(still.velocity == 1.0)
    assert np.all(still.pressure == 1.0)
