from __future__ import annotations

import pytest

from sphrom.plots.canvas import save
from sphrom.plots.trade import STATES, Point, StabilityMap, draw_stability, draw_trade

POINTS = [
    Point("full model", "50 across", 3.0, (0.5, 2.0), (True, True)),
    Point("Galerkin", "M 5", 1e-4, (1.0, 3.0), (True, True)),
    Point("Galerkin", "M 9", 1e-3, (1.5, 9.0), (False, False)),
]

NOTHING = {"nearest training run": (4.0, 20.0)}


def test_fronts_are_steps_through_the_models_on_them(tmp_path):
    figure = draw_trade(POINTS, 5.0, "mean error", NOTHING)
    for index, axes in enumerate(figure.axes):
        lines = {line.get_label(): line for line in axes.get_lines()}
        front = lines["Pareto front (models filled)"]
        expected = sorted((p.seconds, p.errors[index]) for p in POINTS if p.on_front[index])
        assert [tuple(point) for point in front.get_xydata()] == expected
        assert front.get_drawstyle() == "steps-post"
        assert [text.get_text() for text in axes.texts] == ["M 5", "50 across"]
        low, high = axes.get_ylim()
        assert low < min(p.errors[index] for p in POINTS)
        assert high > max(p.errors[index] for p in POINTS)
    save(figure, tmp_path / "trade.png")


def test_doing_nothing_is_a_level_and_unknown_seconds_are_no_line():
    figure = draw_trade(POINTS, None, "relative L2 error", NOTHING)
    for index, axes in enumerate(figure.axes):
        lines = {line.get_label(): line for line in axes.get_lines()}
        level = NOTHING["nearest training run"][index]
        assert set(lines["nearest training run"].get_ydata()) == {level}
        assert axes.get_ylim()[0] < level < axes.get_ylim()[1]
        assert "full run" not in lines


def test_models_that_gain_next_to_nothing_have_no_name():
    slower = Point("APG", "M 6", 0.1, (0.98, 2.0), (True, True))
    velocity, pressure = draw_trade([*POINTS, slower], 5.0, "mean error", NOTHING).axes
    assert [text.get_text() for text in velocity.texts] == ["M 5", "50 across"]
    assert [text.get_text() for text in pressure.texts] == ["M 5", "M 6", "50 across"]


@pytest.mark.parametrize(
    "points", [[], [Point("full model", "100 across", 1.0, (0.0, 0.0), (True, True))]]
)
def test_a_plot_without_errors(tmp_path, points):
    save(draw_trade(points, 5.0, "mean error", NOTHING), tmp_path / "trade.png")


def test_a_map_has_a_field_for_each_state(tmp_path):
    states = {(2, 0.5): "stable", (2, 2.0): "unstable", (5, 0.5): "inaccurate"}
    lost = {(2, 0.1): "full unstable", (5, 0.1): "refused"}
    maps = [
        StabilityMap("reynolds=10", "step", [2, 5], [0.5, 2.0], states),
        StabilityMap("reynolds=20", "step", [2, 5], [0.5, 2.0], {}),
        StabilityMap("reynolds=10", "Mach number", [2, 5], [0.1], lost),
    ]
    figure = draw_stability([*maps, *maps])
    first, second, third, *_ = figure.axes
    assert len(first.patches) == 3
    assert [text.get_text() for text in first.texts] == [STATES[s][1] for s in states.values()]
    assert not second.patches
    assert first.get_title() == "reynolds=10"
    assert third.get_xlabel() == "Mach number"
    assert len(third.patches) == 2
    assert [axes.axison for axes in figure.axes] == [True] * 6 + [False] * 2
    (legend,) = figure.legends
    assert [text.get_text().split(" ~")[0] for text in legend.get_texts()] == [
        "stable", "inaccurate", "unstable ×", "full unstable ×", "refused –",
    ]  # fmt: skip
    save(figure, tmp_path / "extremes.png")


def test_only_states_that_there_are_have_a_word():
    figure = draw_stability([StabilityMap("a", "step", [2], [0.5], {(2, 0.5): "stable"})])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["stable"]
