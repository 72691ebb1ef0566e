"""The plot of a trade."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sphrom.metrics.histories import EXACT, Errors
from sphrom.plots.canvas import save
from sphrom.trade.report import Results, draw_trade
from sphrom.trade.table import Alternative, Measure, ModelRow


def errors(velocity: float, pressure: float) -> Errors:
    found = {"velocity_field_relative_l2": velocity, "pressure_field_relative_l2": pressure}
    return {**EXACT, **found}


def model(
    family: str, name: str, seconds: float, off: tuple[float, float], front: bool
) -> ModelRow:
    return ModelRow(
        model=f"{family}, {name}", family=family, kind="operators", resolution=10, time_step=1.0,
        online_seconds=seconds, errors=errors(*off), velocity_front=front, pressure_front=front,
    )  # fmt: skip


MODELS = [
    model("full", "50 across", 3.0, (0.5, 2.0), True),
    model("Galerkin", "M 5", 1e-4, (1.0, 3.0), True),
    model("Galerkin", "M 9", 1e-3, (1.5, 9.0), False),
]
NOTHING = [Alternative("nearest training run", errors(4.0, 20.0))]
OWN = model("full", "own", 5.0, (0.0, 0.0), False)
RESULTS = Results([OWN, *MODELS], NOTHING, [], Measure("field"), 5.0)
JUDGED = ("velocity_field_relative_l2", "pressure_field_relative_l2")


def test_fronts_are_steps_through_the_models_on_them(tmp_path):
    figure = draw_trade(RESULTS)
    for judged, axes in zip(JUDGED, figure.axes, strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        (fast, best), (slow, least) = sorted(
            (m.online_seconds, m.errors[judged]) for m in MODELS if m.velocity_front
        )
        steps = [tuple(point) for point in lines["Pareto front"].get_xydata()]
        assert steps == [(fast, best), (slow, best), (slow, least)]
        assert [text.get_text() for text in axes.texts] == ["M 5", "50 across"]
        assert len(lines["Galerkin"].get_xdata()) == 2
        assert set(lines["full run"].get_xdata()) == {5.0}
    save(figure, tmp_path / "trade.png")


def test_doing_nothing_is_a_level_and_unknown_seconds_are_no_line():
    figure = draw_trade(replace(RESULTS, own_seconds=None))
    for judged, axes in zip(JUDGED, figure.axes, strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        level = NOTHING[0].errors[judged]
        assert set(lines["nearest training run"].get_ydata()) == {level}
        assert axes.get_ylim()[0] < level < axes.get_ylim()[1]
        assert "full run" not in lines


@pytest.mark.parametrize("rows", [[], [model("full", "100 across", 1.0, (0.0, 0.0), True)]])
def test_a_plot_without_errors(tmp_path, rows):
    save(draw_trade(replace(RESULTS, rows=[OWN, *rows])), tmp_path / "trade.png")
