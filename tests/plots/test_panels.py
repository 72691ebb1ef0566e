"""Panels show what they were given, with units, and figures are files of a sensible size."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from sphrom.compare.comparison_figures import overview_rows
from sphrom.errors import ArtifactError
from sphrom.metrics.grids import Slices, grid_points
from sphrom.plots.arrangement import WIDEST, _balanced
from sphrom.plots.frames import Frame
from sphrom.plots.panels import Curve, Field, Panel, colour_scale, draw_grid, save

FRAME = Frame((0.0, 1.0, 0.0, 1.0))
X = np.linspace(0.0, 1.0, 31)
SPEED = np.linspace(0.0, 1.0, 144).reshape(12, 12)
FULL, REDUCED = Field("full", "speed [m/s]", SPEED), Field("apg", "speed [m/s]", 1.1 * SPEED)
DIFFERENCE = Field("difference", "difference [m/s]", 0.1 * SPEED, difference=True)
RUNS = [Curve("good", X, 2.0 * X), Curve("gone", X[:15], 1e9 * X[:15])]
PANEL = Panel("errors", "time [s]", "error [%]", RUNS)


def images(figure) -> list:
    """Return the pictures of a figure, without its colour bars."""
    return [axes.images[0] for axes in figure.axes if axes.images]


def test_pictures_and_curves_stand_in_one_figure(tmp_path: Path) -> None:
    row = [FULL, REDUCED, DIFFERENCE, PANEL]
    figure, path = draw_grid([row], FRAME, scales={}, title="t = 0.5 s"), tmp_path / "plot.png"
    texts = [f"{a.get_xlabel()}|{a.get_ylabel()}" for a in figure.axes]
    for text in ("x [m]", "speed [m/s]", "difference [m/s]", "time [s]"):
        assert any(text in labels for labels in texts)
    save(figure, path)
    assert 10_000 < path.stat().st_size < 2_000_000
    with pytest.raises(ArtifactError, match="was not written"):
        save(figure, tmp_path / "missing" / "plot.png")


@pytest.mark.parametrize("aspect", [0.1, 0.25, 0.5, 1.0, 2.0, 4.0])
def test_an_overview_fills_its_canvas_with_type_that_a_page_shows(aspect) -> None:
    frame = Frame((0.0, 1.0 / aspect, 0.0, 1.0))
    rows = overview_rows([FULL, REDUCED, DIFFERENCE], PANEL, aspect)
    figure = draw_grid(rows, frame, scales={}, title="reynolds=150, t = 0.259 s")
    assert figure.get_figwidth() <= WIDEST + 1e-9
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    width, height = figure.bbox.size
    assert sum(box.width * box.height for box in boxes) > 0.5 * width * height
    for box in boxes:
        assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -1.0
    shown = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    assert min(text.get_fontsize() for text in shown) >= 7.5
    for axes in figure.axes:
        if axes.images:  # boxes of pictures have their proportions, without a gap beside them
            assert axes.bbox.height / axes.bbox.width == pytest.approx(aspect, rel=0.01)


def test_curves_below_pictures_span_them_and_long_labels_are_wrapped() -> None:
    label = "pressure, line: mean error over range (Eq. 4.1) [%], " * 2
    rows = [[FULL, REDUCED, DIFFERENCE], [replace(PANEL, y_label=label)]]
    first, _, third, below = draw_grid(rows, FRAME, scales={}).axes[:4]
    assert below.get_position().x0 == pytest.approx(first.get_position().x0)
    assert below.get_position().x1 == pytest.approx(third.get_position().x1)
    assert "\n" in below.get_ylabel()


def test_fields_of_one_label_share_a_scale_and_differences_are_about_zero() -> None:
    full, reduced, difference = images(draw_grid([[FULL, REDUCED, DIFFERENCE]], FRAME, scales={}))
    assert full.get_clim() == reduced.get_clim()
    assert sum(difference.get_clim()) == 0.0
    np.testing.assert_array_equal(difference.get_array(), 0.1 * SPEED)
    small = draw_grid([[FULL, replace(DIFFERENCE, values=1e-4 * SPEED)]], FRAME, scales={})
    assert any(axes.get_xlabel().startswith("difference [m/s] $") for axes in small.axes)


def test_no_runaway_and_no_spot_decides_a_scale() -> None:
    rows = [[FULL, replace(FULL, values=1e6 * SPEED)], [replace(FULL, values=np.nan * SPEED)]]
    shared = images(draw_grid(rows, FRAME, scales={"speed [m/s]": (0.0, 1.0)}))
    ((low, high),) = {image.get_clim() for image in shared}
    assert (low, high) == (pytest.approx(0.0, abs=0.02), 3.0)
    spot = np.tile(np.linspace(0.0, 1.0, 40), (40, 1))
    spot[3, 7] = 1e3
    (image,) = images(draw_grid([[replace(FULL, values=spot)]], FRAME))
    assert image.get_clim()[1] == pytest.approx(1.0, rel=0.1)


def test_solid_parts_of_a_wide_box_are_grey_and_its_sides_in_proportion() -> None:
    speed = np.linspace(0.0, 1.0, 200).reshape(10, 20)
    speed[:5, :5] = np.nan
    figure = draw_grid([[replace(FULL, values=speed)] * 2], Frame((0.0, 0.4, 0.0, 0.2)))
    for axes in (axes for axes in figure.axes if axes.images):
        assert axes.get_aspect() == 1.0
        assert axes.get_facecolor()[:3] == pytest.approx([0.788] * 3, abs=1e-3)
        assert np.isnan(np.ma.filled(axes.images[0].get_array(), np.nan)[:5, :5]).all()


def test_a_round_solid_is_drawn_by_its_outline_not_in_the_steps_of_the_grid() -> None:
    x = np.linspace(0.0, 1.0, 101)
    distance = np.hypot(x - 0.5, x[:, None] - 0.5) - 0.25
    speed = np.where(distance[5::10, 5::10] > 0.0, 1.0 + x[5::10], np.nan)
    frame = Frame(FRAME.extent, (x, x, distance))
    for axes in draw_grid([[replace(FULL, values=speed)]], frame).axes:
        for image in axes.images:
            assert np.isfinite(image.get_array()).all()
            (outline,) = (c for c in axes.collections if len(c.get_paths()[0].vertices))
            radius = np.hypot(*(outline.get_paths()[0].vertices - 0.5).T)
            np.testing.assert_allclose(radius, 0.25, atol=1e-3)


def test_scattered_points_leave_the_outside_of_the_fluid_empty() -> None:
    points = grid_points((0.0, 0.0), (1.0, 1.0), (40, 40))
    points = points[~((points[:, 0] > 0.5) & (points[:, 1] < 0.5))]
    empty = np.isnan(FRAME.raster(points)(points[:, 0]))
    ny, nx = empty.shape
    assert empty[: int(0.4 * ny), int(0.6 * nx) :].all()
    assert not empty[int(0.6 * ny) :].any()


def test_a_box_in_space_is_shown_by_three_slices_with_numbers_along_both_axes() -> None:
    slices = Slices((0.0, 0.0, 0.0), (2.0, 1.0, 1.0))
    frame = Frame(slices.extent, slices=slices)
    position = grid_points(slices.lower, slices.upper, (10, 10, 20))
    values = frame.raster(position)(position @ [1.0, 10.0, 100.0])
    ny, nx = values.shape
    shown = grid_points((0.0, 0.0), (slices.extent[1], slices.extent[3]), (ny, nx))
    expected = slices.places(shown) @ [1.0, 10.0, 100.0]
    np.testing.assert_array_equal(np.isnan(values.ravel()), np.isnan(expected))
    assert np.nanmax(np.abs(values.ravel() - expected)) < 0.06 * 111.0
    axes = draw_grid([[Field("full", "speed [m/s]", values)]], frame).axes[0]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0", "1", "0", "0.5", "1"]
    assert (axes.get_xlabel(), frame.ends) == ("x, then z [m]", (0.0, 1.0, 0.0, 1.0))


def test_runs_that_became_unstable_decide_no_scale() -> None:
    whole, ended = np.linspace(0.0, 1.0, 100), np.linspace(0.0, 2.5, 100)
    fields = [Field("a", "speed", whole), Field("b", "speed", ended, complete=False)]
    _, (low, high) = colour_scale(fields)
    assert (low, high) == pytest.approx((0.0, 1.0), abs=0.02)
    assert colour_scale(fields[1:])[1][1] > 2.0


def test_a_quantity_has_one_colour_map_where_each_picture_has_a_scale() -> None:
    one = Field("mode 1", "density", np.linspace(0.5, 1.0, 9).reshape(3, 3))
    rows = [[one, replace(one, values=one.values - 0.7), replace(one, label="speed")]]
    maps = [axes.images[0].get_cmap().name for axes in draw_grid(rows, FRAME).axes if axes.images]
    assert maps == ["RdBu_r", "RdBu_r", "viridis"]


def test_a_model_looks_alike_beside_others_and_without_them_and_no_data_look_like_one() -> None:
    first, second = (replace(run, place=k) for k, run in enumerate(RUNS))
    rows = [[replace(PANEL, curves=some) for some in ([first, second], [second])]]
    both, alone = (axes.get_lines() for axes in draw_grid(rows).axes)
    assert both[1].get_color() == alone[0].get_color() != both[0].get_color()
    assert both[1].get_linestyle() == alone[0].get_linestyle()
    beside = replace(PANEL, curves=[first, Curve("measured", X, X, "reference")])
    assert len({line.get_color() for line in draw_grid([[beside]]).axes[0].get_lines()}) == 2


@pytest.mark.parametrize("ends", [(2.1, 4.9), (0.42, 0.46), (0.003, 0.9), (1e-9, 1.0)])
def test_logarithmic_axes_have_numbers_wherever_they_lie(ends) -> None:
    panel = replace(PANEL, curves=[Curve("a", np.arange(2), np.array(ends))], axes="logarithmic")
    (axes,) = draw_grid([[panel]]).axes
    low, high = axes.get_ylim()
    assert 3 <= sum(low <= y <= high for y in axes.get_yticks()) <= 12
    assert len({"^" in label.get_text() for label in axes.get_yticklabels()}) == 1


def test_labels_of_marked_sizes_stay_apart() -> None:
    sizes = (2, 3, 19, 20, 21, 40)
    curve = Curve("reference space", np.arange(1.0, 61.0), 0.5 ** np.arange(60.0))
    panel = Panel("", "M", "share [%]", [curve], "both logarithmic", sizes)
    figure = draw_grid([[panel] * 2])
    figure.canvas.draw()
    for axes in figure.axes:
        assert len(axes.lines) == 1 + len(sizes)
        boxes = [text.get_window_extent() for text in axes.texts]
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


@pytest.mark.parametrize(
    ("text", "letters", "broken"),
    [
        ("velocity, line: relative L2 [%]", 24, "velocity, line:\nrelative L2 [%]"),
        ("pressure less its mean [Pa]", 23, "pressure less\nits mean [Pa]"),
        ("over range (Eq. 4.1) [%]", 16, "over range\n(Eq. 4.1) [%]"),
        ("", 12, ""),
        ("incomparable_name", 12, "incomparable\n_name"),
    ],
)
def test_labels_break_evenly_and_keep_their_units(text: str, letters: int, broken: str) -> None:
    assert _balanced(text, letters) == broken
