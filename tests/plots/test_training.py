from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.plots.canvas import save
from sphrom.plots.training import TrainingPlot, draw_training

LINE = TrainingPlot(
    names=("reynolds",),
    candidates=np.array([[1000.0], [50.0], [200.0]]),
    estimates=(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.6, 0.4])),
    trained=np.array([[50.0], [1000.0], [200.0]]),
    n_first=2,
    n_runs=(2, 3),
    held_out=np.array([[200.0]]),
    errors=np.array([2.5]),
    learnt=(2,),
    tolerance=1.0,
    quantity="velocity",
)
PLANE = replace(
    LINE,
    names=("reynolds", "lid"),
    candidates=np.array([[50.0, 0.5], [200.0, 1.0], [100.0, 0.7]]),
    trained=np.array([[50.0, 0.5], [200.0, 1.0], [100.0, 0.7]]),
    held_out=np.array([[100.0, 0.7]]),
)
NOTHING_HELD_OUT = replace(
    LINE,
    estimates=LINE.estimates[:1],
    n_runs=(2,),
    held_out=np.empty((0, 1)),
    errors=np.empty(0),
    learnt=(),
)
DIVERGED = replace(
    LINE, estimates=(np.full(3, np.inf), LINE.estimates[1]), errors=np.array([np.inf])
)


@pytest.mark.parametrize("plot", [LINE, PLANE, NOTHING_HELD_OUT, DIVERGED])
def test_the_fall_of_the_worst_estimate_is_drawn_with_the_truth(plot, tmp_path):
    figure = draw_training(plot)
    lines = {line.get_label(): line for line in figure.axes[1].get_lines()}
    worst = [each.max() if np.isfinite(each).all() else np.nan for each in plot.estimates]
    assert np.array_equal(lines["worst estimate"].get_ydata(), worst, equal_nan=True)
    assert np.array_equal(lines["true, before it was seen"].get_ydata(), plot.errors)
    assert set(lines["tolerance"].get_ydata()) == {1.0}
    save(figure, tmp_path / "training.png")
    assert (tmp_path / "training.png").stat().st_size > 10_000


def test_estimates_stand_over_the_parameter_and_runs_below():
    axes = draw_training(LINE).axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert lines["estimate, 3 runs"].get_xdata().tolist() == [50.0, 200.0, 1000.0]
    assert lines["estimate, 3 runs"].get_ydata().tolist() == [0.6, 0.4, 0.5]
    assert sorted(lines["full runs learnt from"].get_xdata()) == [50.0, 200.0, 1000.0]
    assert axes.get_xscale() == "log"


def test_runs_in_a_plane_have_their_numbers():
    axes = draw_training(PLANE).axes[0]
    numbers = {text.get_text(): text.xy for text in axes.texts}
    assert numbers == {"1": (50.0, 0.5), "2": (200.0, 1.0), "3": (100.0, 0.7)}
