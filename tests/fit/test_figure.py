"""Figures of fits: histories, intervals, and a title that is seen whole."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.fit.estimates import FittedHistory
from sphrom.fit.fit import MOST_SHOWN, draw_fit
from sphrom.fit.measurements import History

TIME = np.linspace(0.0, 2.0, 9)
NAME = "u at (0.5, 0.25)"
MEASURED = History("", "velocity", 0, NAME, (0.5, 0.25), TIME, TIME, TIME + 0.1)
HISTORY = FittedHistory(MEASURED, TIME, TIME, TIME, 0.1 * TIME)


@pytest.mark.parametrize("number", [1, 3, MOST_SHOWN + 2])
def test_histories_and_their_residuals(number):
    title = "fast fitted to measurements.csv, 95 % intervals\nkinematic_viscosity 0.009838 (...)"
    figure = draw_fit([HISTORY] * number, title=title)
    figure.draw_without_rendering()
    drawn = [axes for axes in figure.axes if axes.get_visible()]
    assert len(drawn) == 2 * min(number, MOST_SHOWN)
    assert drawn[0].get_ylabel() == f"{NAME} [m/s]"
    text = figure._suptitle
    assert text is not None
    assert ("2 more histories are not shown" in text.get_text()) == (number > MOST_SHOWN)
    width = text.get_window_extent().width
    assert width < figure.bbox.width
