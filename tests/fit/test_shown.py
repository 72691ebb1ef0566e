"""What a fit draws and says."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.artifacts.records.fit import FittedHistory
from sphrom.fit.estimates import _undetermined
from sphrom.fit.fit import MOST_SHOWN, draw_fit

TIME = np.linspace(0.0, 2.0, 9)
NAME = "u at (0.5, 0.25)"
HISTORY = FittedHistory(
    instant=TIME, measured=TIME, noise=TIME + 0.1, fitted=TIME, curve=TIME, half_width=0.1 * TIME,
    name=NAME, units="m/s",
)  # fmt: skip


@pytest.mark.parametrize("number", [1, 3, MOST_SHOWN + 2])
def test_histories_and_their_residuals(number):
    title = "fast fitted to measurements.csv, 95 % intervals\nkinematic_viscosity 0.009838 (...)"
    figure = draw_fit([HISTORY] * number, TIME, title=title)
    figure.draw_without_rendering()
    drawn = [axes for axes in figure.axes if axes.get_visible()]
    assert len(drawn) == 2 * min(number, MOST_SHOWN)
    assert drawn[0].get_ylabel() == f"{NAME} [m/s]"
    text = figure._suptitle
    assert text is not None
    assert ("2 more histories are not shown" in text.get_text()) == (number > MOST_SHOWN)
    width = text.get_window_extent().width
    assert width < figure.bbox.width


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ([0.3, 0.0], ["the data don't determine reynolds within"]),
        ([1.0, 0.0], ["the data don't determine reynolds within"]),
        ([0.5, 0.5], ["a combination of reynolds and lid only"]),
        ([0.0, 0.0], []),
    ],
)
def test_what_data_do_not_determine_is_said(shares, words):
    found = list(_undetermined(("reynolds", "lid"), np.array(shares)))
    assert [said in text for said, text in zip(words, found, strict=True)] == [True] * len(words)
