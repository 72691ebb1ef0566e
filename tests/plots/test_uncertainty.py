from __future__ import annotations

import numpy as np
import pytest

from sphrom.plots.canvas import save
from sphrom.plots.uncertainty import Fan, Trend, draw_fans, draw_indices, draw_trends

TIME = np.linspace(0.0, 1.0, 9)


def fan(n_levels: int) -> Fan:
    levels = np.linspace(0.1, 0.9, n_levels)
    quantiles = levels[:, None] * (1.0 + TIME)
    interval = np.stack((quantiles - 0.05, quantiles + 0.05))
    return Fan(TIME, "time [s]", "u [m/s]", levels, quantiles, interval, quantiles.mean(axis=0))


@pytest.mark.parametrize("n_levels", [1, 2, 3, 5])
def test_fans_have_a_band_for_each_pair_of_quantiles(n_levels, tmp_path):
    figure = draw_fans({"a": fan(n_levels), "b": fan(n_levels)})
    assert len(figure.axes) == 2
    assert len(figure.axes[0].collections) == n_levels // 2
    save(figure, tmp_path / "fan.png")
    assert (tmp_path / "fan.png").stat().st_size > 5000


def test_bars_hold_intervals_that_leave_out_the_estimate(tmp_path):
    ends = np.array([[0.1, 0.5], [0.2, 0.7]])
    orders = {"first order": (np.array([0.3, 0.6]), ends), "total": (np.array([0.0, 0.6]), ends)}
    figure = draw_indices({"u": orders}, ["reynolds", "lid"])
    (axes,) = figure.axes
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["reynolds", "lid"]
    assert len(axes.patches) == 4
    save(figure, tmp_path / "bars.png")


def test_trends_have_one_legend(tmp_path):
    trend = Trend(np.array([64, 128, 200]), np.ones(3), np.array([[0.9] * 3, [1.1] * 3]))
    lines = {"first lid": trend, "total lid": trend}
    figure = draw_trends({"u": lines, "v": lines})
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*lines]
    save(figure, tmp_path / "trends.png")
