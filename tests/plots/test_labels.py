from __future__ import annotations

from itertools import combinations

import pytest
from matplotlib.text import Annotation, Text

from sphrom.plots.canvas import new_figure
from sphrom.plots.labels import N_STEPS, STEP, _places, name_points


def written(points: list[tuple[str, float, float]]) -> tuple[list[Annotation], list[tuple]]:
    """Return the texts beside some points, and where the markers are on the figure."""
    figure = new_figure(5.0, 4.0)
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log", xlim=(1e-5, 10.0), ylim=(0.1, 100.0))
    name_points(figure, axes, points, [])
    figure.draw_without_rendering()
    places = [tuple(axes.transData.transform(point[1:])) for point in points]
    return [t for t in axes.texts if isinstance(t, Annotation)], places


@pytest.mark.parametrize("ratio", [1.0, 1.3, 2.0])
def test_names_hide_neither_each_other_nor_points(ratio):
    points = [(f"M = {k}, 0.5 dt", 1e-4 * ratio**k, 5.0 / ratio**k) for k in range(6)]
    texts, places = written(points)
    assert [text.get_text() for text in texts] == [point[0] for point in points]
    boxes = [Text.get_window_extent(text) for text in texts]
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))
    assert not any(box.contains(*place) for box in boxes for place in places)


def test_a_name_keeps_inside_the_axes():
    (text,), _ = written([("a rather long name", 1.1e-5, 0.11)])
    axes_box = text.axes.bbox
    box = Text.get_window_extent(text)
    assert axes_box.x0 <= box.x0
    assert axes_box.y0 <= box.y0


def test_points_of_one_name_that_almost_coincide_have_it_once():
    texts, _ = written([("M = 5", 1e-3, 1.0), ("M = 5", 1.01e-3, 1.01), ("M = 5", 1.0, 1.0)])
    assert len(texts) == 2


def test_places_are_tried_beside_a_point_then_farther_and_farther():
    """Downwards at its left, upwards at its right, each a step from the one before."""
    near, far = [], []
    for place in _places():
        (near if abs(place[1]) < STEP else far).append(place)
    assert [across for across, *_ in near] == [-6.0] * 3 + [6.0] * 3
    left, right = far[::2], far[1::2]
    assert [(across, up) for across, up, *_ in left] == [
        (-20.0, -3.0 - k * STEP) for k in range(1, N_STEPS + 1)
    ]
    assert [(-across, -up) for across, up, *_ in right] == [place[:2] for place in left]
