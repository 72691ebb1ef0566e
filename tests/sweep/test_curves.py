"""The figure of a sweep shows results over the parameter that varies, with bands of errors."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.sweep.curves import Curves, varying_parameter


@pytest.mark.parametrize(
    ("points", "varying"),
    [
        ([[100.0, 1.0], [150.0, 1.0], [200.0, 1.0]], 0),
        ([[100.0, 3.0], [100.0, 1.0], [100.0, 2.0]], 1),
        ([[10.0, 4.8], [40.0, 1.2], [20.0, 2.4]], 0),  # the second falls with the first
        ([[10.0, 1.0], [10.0, 2.0], [20.0, 1.0], [20.0, 2.0]], None),  # a grid is no curve
        ([[10.0, 1.0], [20.0, 3.0], [30.0, 2.0]], None),
        ([[100.0, 1.0]], None),
    ],
)
def test_the_first_parameter_of_a_line_of_points_is_found(points, varying) -> None:
    assert varying_parameter(np.array(points)) == varying


def test_panels_show_statistics_with_bands_and_the_other_parameters() -> None:
    rows = [
        {"gauge_elevation_mean": 0.3, "gauge_elevation_greatest": 0.4},
        {"gauge_elevation_mean": None, "gauge_elevation_greatest": None},
        {"gauge_elevation_mean": 0.5, "gauge_elevation_greatest": 0.8},
    ]
    figure = Curves(
        parameter="rate",
        points={"reynolds": np.full(3, 510000.0), "rate": np.array([5.1, 5.6, 6.1])},
        units={f"gauge_elevation_{s}": "m" for s in ("mean", "least", "greatest")},
        rows=rows,
        errors={"gauge_elevation_mean": np.array([0.01, np.nan, 0.02])},
    ).draw()
    (axes,) = figure.axes
    assert axes.get_title() == "gauge elevation"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("rate", "[m]")
    mean, greatest, _ = axes.get_lines()
    np.testing.assert_array_equal(mean.get_ydata(), [0.3, np.nan, 0.5])
    np.testing.assert_array_equal(greatest.get_ydata(), [0.4, np.nan, 0.8])
    band = np.concatenate([path.vertices[:, 1] for path in axes.collections[0].get_paths()])
    assert {0.29, 0.31, 0.48, 0.52} <= {*band.round(12).tolist()}
    assert any("reynolds = 510000" in text.get_text() for text in figure.texts)
