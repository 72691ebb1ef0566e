"""The rows of a trade, the alternatives without a model, the recommendation and the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.costs import break_even
from sphrom.errors import CaseError
from sphrom.metrics.histories import ERRORS, EXACT, NO_ERRORS, Errors, mean_errors
from sphrom.metrics.measures import Samples
from sphrom.plots.panels import save
from sphrom.trade.trade import Results, draw_trade
from sphrom.trade.weighing import (
    INTERPOLATED,
    NEAREST,
    NO_MEASURED,
    UNCHANGED,
    Alternative,
    Measure,
    ModelRow,
    Tolerance,
    alternatives,
    recommend,
    weighed,
)

MEASURE = Measure("field")
OWN = "full, as in the case"


def errors(velocity: float, pressure: float) -> Errors:
    """Errors that are three times as large at worst."""
    values = {"velocity": velocity, "pressure": pressure}
    return {
        name: (3.0 if name.endswith("peak") else 1.0) * values[name.partition("_")[0]]
        for name in ERRORS
    }


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
        stable=seconds is not None,
        offline_seconds=offline,
        online_seconds=seconds,
        errors=found,
    )


def full(name: str, seconds: float | None, found: Errors = EXACT) -> ModelRow:
    return model(name, seconds, found, "full", 0.0)


def advised(rows, without, *tolerance):
    """Return weighed rows, the recommendation and its words."""
    rows = weighed(rows, without, MEASURE)
    return rows, *recommend(rows, without, Tolerance(*tolerance), MEASURE)


def test_a_model_slower_and_worse_than_a_coarser_full_run_is_not_recommended():
    rows = [
        full(OWN, 10.0),
        full("full, coarser", 1.0, errors(0.5, 0.5)),
        full("full, finer step", 20.0, errors(0.01, 0.01)),
        model("slow", 2.0, errors(0.6, 0.7)),
        model("as good in pressure", 2.0, errors(0.6, 0.4)),
    ]
    found, advice, _ = advised(rows, [], 1.0, 1.0)
    assert [row.beaten_by for row in found] == [None, None, OWN, "full, coarser", None]
    assert (advice["model"], advice["full_run"]) == ("full, coarser", "full, coarser")
    _, advice, _ = advised(rows, [], 1.0, 0.45)
    assert (advice["model"], advice["full_run"]) == ("as good in pressure", OWN)


def test_a_model_that_is_worse_than_a_training_run_is_not_recommended():
    without = [Alternative(NEAREST, errors(2.0, 5.0)), Alternative(UNCHANGED, errors(30.0, 1.0))]
    rows = [
        full(OWN, 10.0),
        model("bad", 1e-6, errors(3.0, 6.0)),
        model("better in pressure", 1e-5, errors(2.5, 4.0)),
        model("good", 1e-4, errors(1.0, 2.0)),
    ]
    found, advice, said = advised(rows, without, 10.0, 10.0)
    assert [row.beaten_by for row in found] == [None, NEAREST, None, None]
    assert (advice["model"], advice["without_a_model"]) == ("better in pressure", NEAREST)
    assert said.endswith(f"without a model, {NEAREST} is within the tolerance, too")
    _, advice, said = advised(rows, without, 1.5, 3.0)
    assert (advice["model"], advice["without_a_model"]) == ("good", None)
    _, _, said = advised(rows, without, 0.5, 0.5)
    assert said.endswith(
        "faster run is in velocity that of good, 1.00 % and in pressure that of good, 2.00 %"
    )
    for others in ([rows[1]], [model("unstable", None, NO_ERRORS)]):
        _, advice, said = advised([rows[0], *others], without, 0.5, 0.5)
        assert said.endswith("is unstable, or no more accurate than one that is as fast")


def test_a_model_pays_from_some_run_on():
    rows = [full(OWN, 10.0), full("full, coarser", 2.5, errors(0.9, 0.9)),
            model("good", 0.5, errors(0.5, 0.5))]  # fmt: skip
    found, advice, said = advised(rows, [], 1.0, 1.0)
    assert [row.speed_up for row in found] == [1.0, 4.0, 20.0]
    assert [row.break_even_runs for row in found] == [None, None, 11]
    assert (advice["model"], advice["full_run"], advice["pays_from_run"]) == (
        "good",
        "full, coarser",
        50,
    )
    assert "pays off from 50 runs on; for fewer, take full, coarser" in said
    _, advice, _ = advised(rows, [], 0.6, 0.6)
    assert (advice["full_run"], advice["pays_from_run"]) == (OWN, 11)


WEIGHED = [
    full(OWN, 10.0),
    full("full, finer", 20.0, errors(0.01, 0.01)),
    model("coarse", 1.0, errors(2.0, 0.5)),
    model("wrong pressure", 2.0, errors(0.5, 2.0)),
    model("slower", 4.0, errors(0.1, 0.1)),
    model("right", 3.0, errors(1.0, 1.0)),
    model("as fast, more accurate", 3.1, errors(0.7, 0.7)),
    model("as fast, pays later", 2.9, errors(0.6, 0.6), offline=200.0),
    model("unstable", None, NO_ERRORS),
]


@pytest.mark.parametrize(
    ("tolerance", "name"),
    [
        ((1.0, 1.0), "as fast, more accurate"),
        ((0.65, 0.65), "as fast, pays later"),
        ((1.0, 2.0), "wrong pressure"),
        ((0.05, 5.0), None),
    ],
)
def test_the_cheapest_within_a_tolerance(tolerance, name):
    _, advice, said = advised(WEIGHED, [], *tolerance)
    assert advice["model"] == name
    assert ("error of a faster run is in velocity that of slower" in said) == (name is None)


@pytest.mark.parametrize(
    ("text", "tolerance"),
    [("1%", (1.0, 1.0)), ("1", (1.0, 1.0)), ("0.5 %, 3%", (0.5, 3.0)), ("1e-1%", (0.1, 0.1))],
)
def test_tolerances(text, tolerance):
    assert Tolerance.of_text(text) == Tolerance(*tolerance)


@pytest.mark.parametrize("text", ["", "0%", "-1%", "nan", "1,2,3", "1%%"])
def test_other_texts_are_refused(text):
    with pytest.raises(CaseError, match="--tolerance"):
        Tolerance.of_text(text)


def test_the_two_errors_have_fronts_of_their_own():
    rows = [
        model("own", 0.1, EXACT),
        model("fast", 1.0, errors(3.0, 3.0)),
        model("slow", 2.0, errors(1.0, 4.0)),
        model("unstable", None, NO_ERRORS),
    ]
    found = weighed(rows, [], MEASURE)
    assert [row.fronts["velocity_front"] for row in found] == [False, True, True, False]
    assert [row.fronts["pressure_front"] for row in found] == [False, True, False, False]
    assert [row.model for row in found] == [row.model for row in rows]


@pytest.mark.parametrize(
    ("once", "full", "online", "runs"),
    [(10.0, 2.0, 1.0, 10), (10.1, 2.0, 1.0, 11), (0.5, 2.0, 1.0, 1), (10.0, 1.0, 1.0, None)],
)
def test_break_even(once, full, online, runs):
    assert break_even(once, full, online) == runs


def test_errors_of_several_runs_are_means_and_the_largest_peak():
    both = mean_errors([errors(1.0, 2.0), errors(3.0, 1.0)])
    assert (both["velocity_line_relative_l2"], both["pressure_line_relative_l2"]) == (2.0, 1.5)
    peaks = (both["velocity_line_relative_l2_peak"], both["pressure_line_relative_l2_peak"])
    assert peaks == (9.0, 6.0)
    assert mean_errors([errors(1.0, 2.0), NO_ERRORS]) == NO_ERRORS


def test_a_measured_force_is_one_quantity_by_which_models_are_judged():
    judged = Measure("field", "drag", ("force",))

    def off(seconds: float, force: float) -> ModelRow:
        found = {**errors(9.0, 9.0), **NO_MEASURED, "measured_force_relative_l2": force}
        return model(f"{force}", seconds, found)

    rows = weighed([off(9.0, 0.0), off(1.0, 2.0), off(2.0, 1.0), off(3.0, 1.5)], [], judged)
    assert [row.fronts["measured_front"] for row in rows] == [False, True, True, False]
    assert not any(row.fronts["velocity_front"] for row in rows)
    advice, said = recommend(rows, [], Tolerance(1.5, 0.1), judged)
    assert advice["model"] == "1.0"
    assert said.startswith("within 1.5 % of force (relative L2 error of drag over time)")


@pytest.mark.parametrize("across", [1.2, 1.8])
def test_a_tolerance_includes_each_component_of_a_force_in_space(across: float):
    judged = Measure("field", "drag", ("force",), n_dim=3)
    found = {**NO_MEASURED, "measured_force_relative_l2": 1.0}
    found["measured_force_z_relative_l2"] = across
    assert Tolerance(1.5, 0.1).used(found, judged) == pytest.approx(across / 1.5)


def run_at(point: ParameterPoint) -> Samples:
    """A growing flow whose speed is the logarithm of the Reynolds number."""
    time = np.linspace(0.0, 1.0, 5)
    speed = math.log(point.reynolds) * (1.0 + time)[:, None, None]
    measured = {"flow_rate": speed[:, 0, 0]}
    return Samples(time, np.repeat(speed, 2, axis=2), np.ones((5, 1)), measured)


def off(point: ParameterPoint, samples: Samples) -> Errors:
    """The largest error of the velocity [%]."""
    exact = run_at(point).velocity
    assert samples.measured["flow_rate"] == pytest.approx(samples.velocity[:, 0, 0])
    return errors(100.0 * float(np.abs(samples.velocity / exact - 1.0).max()), 0.0)


def without(trained: list[float], *tested: float) -> dict[str, float | None]:
    """Return the errors of the velocity without a model, by the alternative's name."""
    parameters = {"train": {"reynolds": trained}}
    case = Case.model_validate(
        {"name": "x", "scene": {"kind": "taylor-green"}, "parameters": parameters}
    )
    full = {point: run_at(point) for point in map(ParameterPoint, tested)}
    rows = alternatives(case, full, run_at, off)
    return {row.name: row.errors["velocity_field_relative_l2"] for row in rows}


def test_interpolated_runs_are_better_than_the_nearest():
    found = without([50.0, 100.0, 200.0], 140.0)
    assert list(found) == [NEAREST, INTERPOLATED, UNCHANGED]
    near = 100.0 * (1.0 - math.log(100.0) / math.log(140.0))
    assert found == pytest.approx({NEAREST: near, INTERPOLATED: 0.0, UNCHANGED: 50.0}, abs=1e-6)


def test_errors_without_a_model_are_means_over_the_points():
    """The nearest training run is so by its ratio: of 150 it is 200."""
    near = (math.log(200.0) / math.log(150.0) - 1.0, 1.0 - math.log(200.0) / math.log(240.0))
    assert without([100.0, 200.0], 150.0, 240.0)[NEAREST] == pytest.approx(50.0 * sum(near))


@pytest.mark.parametrize(
    ("trained", "tested", "names"),
    [
        ([100.0, 200.0], 100.0, [NEAREST, UNCHANGED]),
        ([100.0], 140.0, [NEAREST, UNCHANGED]),
        ([100.0], 100.0, [UNCHANGED]),
    ],
)
def test_a_trained_value_is_neither_its_own_neighbour_nor_its_interpolation(trained, tested, names):
    assert list(without(trained, tested)) == names


PICTURED = [
    full(OWN, 5.0),
    full("50 across", 3.0, errors(0.5, 2.0)),
    model("M 5", 1e-4, errors(1.0, 3.0)),
    model("M 9", 1e-3, errors(1.5, 9.0)),
]
NOTHING = [Alternative(NEAREST, errors(4.0, 20.0))]


def test_fronts_are_steps_through_the_models_on_them(tmp_path):
    results = Results(weighed(PICTURED, [], MEASURE), NOTHING, [], MEASURE)
    figure = draw_trade(results)
    for slow, fast, axes in zip((0.5, 2.0), (1.0, 3.0), figure.axes, strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        steps = [tuple(point) for point in lines["Pareto front"].get_xydata()]
        assert steps == [(1e-4, fast), (3.0, fast), (3.0, slow)]
        assert {text.get_text() for text in axes.texts} == {"M 5", "50 across"}
        assert set(lines["the case's full run"].get_xdata()) == {5.0}
        (level,) = set(lines[NEAREST].get_ydata())
        assert axes.get_ylim()[0] < level < axes.get_ylim()[1]
    save(figure, tmp_path / "trade.png")


ONLY_NOISE = errors(4.0, float("nan"))


@pytest.mark.parametrize("others", [[], [full("100 across", 1.0)], [model("M 5", 1.0, ONLY_NOISE)]])
def test_a_picture_without_errors_or_seconds(tmp_path, others):
    rows = weighed([full(OWN, None), *others], [], MEASURE)
    nothing = [Alternative(NEAREST, ONLY_NOISE)] if others else NOTHING
    figure = draw_trade(Results(rows, nothing, [], MEASURE))
    assert "the case's full run" not in {line.get_label() for line in figure.axes[0].get_lines()}
    save(figure, tmp_path / "trade.png")
