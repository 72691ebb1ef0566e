"""Plots are files of a sensible size, their axes have units, and they show what they were given."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from sphrom.errors import ArtifactError
from sphrom.metrics.histories import PLACES, History, Series
from sphrom.metrics.samples import grid_points
from sphrom.plots.canvas import Fields, limits, line_of, save, symmetric_limits
from sphrom.plots.curves import (
    MEASURES,
    draw_centrelines,
    draw_error_histories,
    draw_singular_values,
)
from sphrom.plots.panels import (
    Curve,
    Field,
    Panel,
    Scales,
    draw_curve_grid,
    draw_field_grid,
)
from sphrom.plots.pictures import Frame, Modes, Solids, draw_fields, draw_modes, draw_overview
from sphrom.plots.series import ComparedProfile, draw_history, draw_profiles
from sphrom.scenes.taylor_green import TaylorGreen

FRAME = Frame((0.0, 1.0, 0.0, 1.0))
SCENE = TaylorGreen(1.0, 1.0, 1000.0, 0.01)
GRID = (12, 12)


def _fields(time: float) -> Fields:
    points = grid_points((0.0, 0.0), (1.0, 1.0), GRID)
    speed = np.hypot(*SCENE.velocity(points, time).T)
    return Fields(speed.reshape(GRID), SCENE.pressure(points, time).reshape(GRID))


def _history(level: float) -> History:
    """A history of which no two errors are the same."""
    time = np.linspace(0.0, 1.0, 31)
    errors = [level * time * factor for factor in range(1, 4)]
    places = {
        place: Series(level, *(10.0**k * error for error in errors))
        for k, place in enumerate(PLACES)
    }
    return History(time, places)


MODELS = ("Galerkin, M = 5", "APG, M = 5")
HISTORIES = {name: _history(0.1 + index) for index, name in enumerate(MODELS)}


def _labels(figure) -> str:
    axes = figure.axes
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    texts = [
        f"{a.get_xlabel()}|{a.get_ylabel()}|{a.get_title()}|{a.get_title('left')}" for a in axes
    ]
    return "\n".join(texts + legends)


def _fields_figure():
    return draw_fields(
        FRAME, _fields(0.5), {name: _fields(0.52) for name in MODELS}, about="t = 0.5 s"
    )


def _modes_figure():
    points = grid_points((0.0, 0.0), (1.0, 1.0), GRID)
    velocity = np.stack([SCENE.velocity(points, time) for time in (0.0, 0.5)])
    density = np.stack([np.ones(len(points)), SCENE.pressure(points, 0.0)])
    modes = Modes(points, density, velocity)
    return draw_modes({"reference space": modes, "Lagrangian space": modes}, [1, 2], unit="1/m")


def _centrelines_figure():
    y = np.linspace(0.0, 1.0, 30)
    full = Fields(np.sin(y), 100.0 * np.cos(y))
    return draw_centrelines(y, full, dict.fromkeys(MODELS, full), exact=full, about="t = 0.5 s")


def _singular_values_figure():
    spectra = {
        "reference space": 10.0 ** -np.arange(8.0),
        "Lagrangian space": 1.0 / np.arange(1, 9),
    }
    return draw_singular_values(spectra, [2, 5])


def _errors_figure():
    best, full = _history(0.05), _history(0.3)
    return draw_error_histories(HISTORIES, best=best, full_against_exact=full)


def _overview_figure():
    return draw_overview(
        FRAME, _fields(0.5).speed, _fields(0.52).speed, HISTORIES, about="t = 0.5 s"
    )


def _profiles_figure():
    x = np.linspace(0.0, 1.0, 60)

    def compared(reference: str, run: str) -> ComparedProfile:
        return ComparedProfile(reference, run, x, np.sin(x), x[::10], np.sin(x[::10]))

    u = [compared("one, steady", "t = 9 s"), compared("two, steady", "t = 9 s")]
    panels = {("y / L", "u / U"): u, ("x / L", "v / U"): [compared("one, t = 1 s", "t = 1 s")]}
    return draw_profiles(panels, title="reynolds=100")


def _history_figure():
    time = np.linspace(5.0, 6.0, 50)
    full = (time, np.sin(29.0 * time))
    return draw_history(full, dict.fromkeys(MODELS, full), label="v [m/s]", title="x = 0.25 m")


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (_profiles_figure, ["y / L", "u / U", "x / L", "v / U"]),
        (_history_figure, ["time [s]", "v [m/s]", "full", *MODELS]),
        (_fields_figure, ["x [m]", "y [m]", "speed [m/s]", "pressure [Pa]", "difference", *MODELS]),
        (_modes_figure, ["density [1/m]", "x-velocity", "Lagrangian space\nmode 2", "x [m]"]),
        (
            _centrelines_figure,
            ["y [m]", "speed [m/s]", "pressure [Pa]", "less its mean [Pa]", "exact", *MODELS],
        ),
        (_singular_values_figure, ["mode number M", "left out, 100 − Eq. 4.3 [%]", "Lagrangian"]),
        (
            _errors_figure,
            ["time [s]", "velocity, field: relative L2", "less its mean, line", "best", *MODELS],
        ),
        (_overview_figure, ["full model", "reduced model", "difference [m/s]", "time [s]"]),
    ],
)
def test_plots_are_written_and_labelled(make, expected: list[str], tmp_path: Path) -> None:
    figure, path = make(), tmp_path / "plot.png"
    labels = _labels(figure)
    for text in expected:
        assert text in labels
    save(figure, path)
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert 10_000 < len(content) < 2_000_000
    assert list(tmp_path.iterdir()) == [path]


def test_fields_share_a_scale_per_quantity_and_show_the_difference() -> None:
    figure = _fields_figure()
    images = [axes.images[0] for axes in figure.axes if axes.images]
    assert len(images) == 12
    for column in range(6):
        assert images[column].get_clim() == images[6 + column].get_clim()
    assert images[0].get_clim() == images[1].get_clim()
    assert sum(images[3].get_clim()) == 0.0
    np.testing.assert_allclose(images[2].get_array(), _fields(0.52).speed - _fields(0.5).speed)
    with pytest.raises(ValueError, match="no reduced model"):
        draw_fields(FRAME, _fields(0.5), {})


def test_profiles_at_one_time_share_a_line_and_references_are_markers() -> None:
    left, right = _profiles_figure().axes
    assert [line.get_label() for line in left.lines] == ["t = 9 s", "one, steady", "two, steady"]
    assert [line.get_linestyle() for line in left.lines] == ["-", "None", "None"]
    assert len({line.get_marker() for line in left.lines[1:]}) == 2
    np.testing.assert_allclose(right.lines[1].get_xdata(), np.linspace(0.0, 1.0, 60)[::10])
    with pytest.raises(ValueError, match="no profile"):
        draw_profiles({})


def test_solid_parts_of_a_wide_box_are_grey_and_its_sides_in_proportion() -> None:
    frame = Frame((0.0, 0.4, 0.0, 0.2))
    speed = np.linspace(0.0, 1.0, 200).reshape(10, 20)
    speed[:5, :5] = np.nan
    fields = Fields(speed, speed - 0.5)
    for figure in (
        draw_fields(frame, fields, {"galerkin": fields}),
        draw_overview(frame, speed, speed, HISTORIES),
    ):
        pictures = [axes for axes in figure.axes if axes.images]
        for axes in pictures:
            assert axes.get_aspect() == 1.0
            assert axes.get_facecolor()[:3] == pytest.approx([0.788] * 3, abs=1e-3)
            assert np.isnan(np.ma.filled(axes.images[0].get_array(), np.nan)[:5, :5]).all()
            assert np.isfinite(axes.images[0].get_clim()).all()


def test_a_round_solid_is_drawn_by_its_outline_not_in_the_steps_of_the_grid() -> None:
    x = np.linspace(0.0, 1.0, 101)
    distance = np.hypot(x - 0.5, x[:, None] - 0.5) - 0.25
    speed = np.where(distance[5::10, 5::10] > 0.0, 1.0 + x[5::10], np.nan)
    frame = Frame((0.0, 1.0, 0.0, 1.0), Solids(x, x, distance))
    for axes in draw_overview(frame, speed, speed, HISTORIES).axes:
        for image in axes.images:
            assert np.isfinite(image.get_array()).all()
            (outline,) = (c for c in axes.collections if len(c.get_paths()[0].vertices))
            radius = np.hypot(*(outline.get_paths()[0].vertices - 0.5).T)
            np.testing.assert_allclose(radius, 0.25, atol=1e-3)
            assert axes.get_xlim() == (0.0, 1.0)


def test_modes_about_zero_where_they_change_sign() -> None:
    images = [axes.images[0] for axes in _modes_figure().axes if axes.images]
    constant, changing = images[0], images[1]
    assert constant.get_clim() == (0.5, 1.5)
    assert sum(changing.get_clim()) == 0.0


def test_modes_stay_empty_outside_of_the_fluid() -> None:
    points = grid_points((0.0, 0.0), (1.0, 1.0), (40, 40))
    points = points[~((points[:, 0] > 0.5) & (points[:, 1] < 0.5))]
    modes = Modes(points, points[:, :1].T.copy(), points[None].copy())
    picture = draw_modes({"reference space": modes}, [1]).axes[0].images[0].get_array()
    empty = np.ma.getmaskarray(picture) | np.isnan(np.ma.getdata(picture))
    ny, nx = empty.shape
    assert empty[: int(0.4 * ny), int(0.6 * nx) :].all()
    assert not empty[int(0.6 * ny) :].any()


def test_logarithmic_errors_leave_zeros_out() -> None:
    figure = draw_error_histories(HISTORIES, log_scale=True)
    axes = figure.axes[0]
    assert axes.get_yscale() == "log"
    assert np.isnan(axes.lines[0].get_ydata()[0])
    assert axes.get_ylim()[0] > 1e-4
    assert draw_error_histories(HISTORIES).axes[0].get_ylim()[0] == 0.0


def test_pressure_is_drawn_with_and_without_its_mean() -> None:
    y = np.linspace(0.0, 1.0, 30)
    drawn = draw_centrelines(y, Fields(y, 7.0 + y), {"galerkin": Fields(y, y)}).axes
    for line in drawn[2].lines:
        np.testing.assert_allclose(line.get_ydata(), y - y.mean(), atol=1e-12)
    assert drawn[1].lines[0].get_ydata()[0] == 7.0


def test_each_error_says_where_it_is_of_and_over_which_range() -> None:
    panels = {axes.get_ylabel(): axes for axes in draw_error_histories(HISTORIES).axes}
    assert list(panels) == list(MEASURES.values())
    for measure, label in MEASURES.items():
        drawn = panels[label].lines[0].get_ydata()
        place, error = measure
        np.testing.assert_allclose(drawn, getattr(HISTORIES[MODELS[0]].places[place], error))
        assert ("relative L2" in label) != ("Eq. 4.1 by the line's range" in label)


def test_spectra_end_above_rounding() -> None:
    """A basis of dependent snapshots has singular values that are rounding alone."""
    values = np.array([1.0, 1e-3, 1e-6, 3e-17])
    left = draw_singular_values({"reference space": values}).axes[0]
    drawn = left.lines[0].get_ydata()
    np.testing.assert_array_equal(np.isfinite(drawn), [True, True, True, False])
    assert left.get_ylim()[0] > 1e-8


@pytest.mark.parametrize("sizes", [(5, 10, 20), (10, 11, 12), (2, 3, 19, 20, 21, 40)])
def test_labels_of_sizes_stay_apart(sizes: tuple[int, ...]) -> None:
    figure = draw_singular_values({"reference space": 0.5 ** np.arange(60.0)}, sizes)
    figure.canvas.draw()
    for axes in figure.axes:
        assert len(axes.lines) == 1 + len(sizes)
        boxes = [text.get_window_extent() for text in axes.texts]
        assert len(boxes) >= 2
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_spectra_are_relative_and_sizes_marked() -> None:
    figure = _singular_values_figure()
    left, right = figure.axes
    np.testing.assert_allclose(left.lines[0].get_ydata(), 10.0 ** -np.arange(8.0))
    assert right.lines[1].get_ydata()[0] == pytest.approx(
        100.0 - 100.0 / np.sum(1.0 / np.arange(1, 9))
    )
    assert [text.get_text() for text in left.texts] == ["M = 2", "5"]


def test_a_legend_of_long_names_stays_within_the_figure() -> None:
    spectra = {f"{space} space: {'99.996 % (M = 2), ' * 4}": np.ones(3) for space in "ab"}
    figure = draw_singular_values(spectra)
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.width


POINTS = grid_points((0.0, 0.0), (1.0, 1.0), GRID)
SPEED = np.hypot(*SCENE.velocity(POINTS, 0.0).T)


def _field(title: str, values: np.ndarray) -> Field:
    return Field(title, "speed [m/s]", POINTS, values)


def test_fields_of_one_quantity_share_a_scale_that_no_runaway_decides() -> None:
    rows = [[_field("full", SPEED), _field("off", 1e6 * SPEED)], [_field("gone", np.nan * SPEED)]]
    about = {"speed [m/s]": (0.0, 1.0)}
    figure = draw_field_grid(FRAME, rows, scales=Scales(about), title="t = 0 s")
    images = [axes.images[0] for axes in figure.axes if axes.images]
    ((low, high),) = {image.get_clim() for image in images}
    assert (low, high) == (pytest.approx(SPEED.min(), abs=0.02), 3.0)
    np.testing.assert_allclose(np.nanmax(images[0].get_array()), SPEED.max())
    assert "speed [m/s]" in _labels(figure)
    own = draw_field_grid(FRAME, [rows[0]], scales=None)
    limits = [axes.images[0].get_clim() for axes in own.axes if axes.images]
    assert limits[1][1] > 1e5 * limits[0][1]
    place = grid_points((0.0, 0.0), (1.0, 1.0), (40, 40))
    spot = np.where(np.arange(1600) == 7, 1e3, place[:, 0])
    spotted = draw_field_grid(FRAME, [[Field("spot", "speed [m/s]", place, spot)]], scales=None)
    ((image, bar),) = [(i, i.colorbar) for axes in spotted.axes for i in axes.images]
    assert image.get_clim()[1] == pytest.approx(1.0, rel=0.1)
    assert bar.extend == "max"
    with pytest.raises(ValueError, match="no field"):
        draw_field_grid(FRAME, [], scales=None)


def test_errors_begin_at_zero_and_follow_no_run_that_became_unstable() -> None:
    time = np.linspace(0.0, 1.0, 11)
    runs = [Curve("good", time, 2.0 * time), Curve("gone", time[:5], 1e9 * time[:5], False)]
    full = Curve("full", time, time)
    panel = Panel("speed", "time [s]", "Eq. 4.1 [%]", runs)
    axes = draw_curve_grid([[panel]], from_zero=True).axes[0]
    assert axes.get_ylim() == (0.0, pytest.approx(2.3))
    assert [line.get_label() for line in axes.lines] == ["good", "gone"]
    drawn = draw_curve_grid([[replace(panel, full=full, exact=full)]] * 2, title="x = 0.5 m")
    assert [line.get_label() for line in drawn.axes[0].lines] == ["exact", "full", "good", "gone"]
    assert len(drawn.legends) == 1
    other = replace(panel, runs=runs[:1])
    apart = draw_curve_grid([[panel], [other]])
    assert not apart.legends
    assert all(axes.get_legend() is not None for axes in apart.axes)
    with pytest.raises(ValueError, match="no curve"):
        draw_curve_grid([])


def test_models_are_told_apart() -> None:
    looks = {(line_of(i).color, str(line_of(i).linestyle)) for i in range(12)}
    assert len(looks) == 12


def test_colour_limits() -> None:
    field = np.array([np.nan, -3.0, 1.0])
    assert symmetric_limits(field) == (-3.0, 3.0)
    assert symmetric_limits(np.zeros(2)) == (-1.0, 1.0)
    assert limits(field, np.array([5.0])) == (-3.0, 5.0)
    assert limits(np.full(3, 2.0)) == (1.5, 2.5)


def test_unwritable_plot_is_an_artifact_error(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="can't be written"):
        save(_errors_figure(), tmp_path / "missing" / "plot.png")


def test_matplotlib_is_loaded_only_to_draw() -> None:
    script = (
        "import sys, sphrom.plots.curves, sphrom.plots.pictures, sphrom.plots.tables;"
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False, timeout=120).returncode == 0
