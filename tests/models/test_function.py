"""A model as a function of arrays: its values are those of runs, and its derivatives theirs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import sphrom
from sphrom.errors import CaseError

INPUTS = {"points": ("lid", "reynolds"), "surface": ("ratio", "reynolds")}
VALUES = {"points": [0.8, 120.0], "surface": [0.95, 250.0]}
OUTPUTS = ("centre_pressure", "centre_velocity_x_mean", "centre_velocity_y_fluctuation")
STEP = 1e-3
Functions = dict[str, sphrom.Function]


@pytest.fixture(scope="module")
def functions(study_of: Callable[[str], sphrom.Study]) -> Functions:
    """The functions of both families, with values at half of the time."""
    found = {}
    for family, inputs in INPUTS.items():
        model = study_of(family).model("fast", **dict(zip(inputs, VALUES[family], strict=True)))
        half = float(model.run().time[-1]) / 2.0
        found[family] = model.function(inputs, OUTPUTS, time=half)
    return found


@pytest.mark.parametrize("family", INPUTS)
def test_values_are_those_of_runs(
    family: str, functions: Functions, study_of: Callable[[str], sphrom.Study]
) -> None:
    f = functions[family]
    rows = np.array([VALUES[family], VALUES[family]]) * [[1.0, 1.0], [1.01, 1.0]]
    values = f(rows)
    assert values.shape == (2, 3)
    for row, found in zip(rows, values, strict=True):
        np.testing.assert_array_equal(f(row), found)
        model = study_of(family).model("fast", **dict(zip(f.inputs, row, strict=True)))
        run = model.run().measures
        pressure = run.centre_pressure
        velocity = run.centre_velocity
        late = velocity.sel(time=slice(velocity.from_time - 1e-9, None))
        middle = CubicSpline(run.time, pressure)(run.time[-1] / 2.0)
        expected = [middle, late.sel(component="x").mean(), late.sel(component="y").std()]
        np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert f.units == ("Pa", "m/s", "m/s")


@pytest.mark.parametrize("family", INPUTS)
def test_derivatives_are_those_of_runs(family: str, functions: Functions) -> None:
    f = functions[family]
    at = np.array(VALUES[family])
    varied = [k for k, (low, high) in enumerate(f.bounds) if low < high]
    found = f.jacobian(at)
    assert f.jacobian([at, at]).shape == (2, 3, 2)
    for k in varied:
        ends = np.tile(at, (2, 1))
        ends[:, k] *= [1.0 - STEP, 1.0 + STEP]
        expected = np.diff(f(ends), axis=0)[0] / np.ptp(ends[:, k])
        np.testing.assert_allclose(found[:, k], expected, rtol=5e-3)


def test_outputs_have_estimated_errors(study: sphrom.Study) -> None:
    model = study.model("fast", reynolds=120, lid=0.8)
    assert model.ranges == {"reynolds": (50.0, 200.0), "lid": (0.5, 1.0)}
    f = model.function(["lid"], ["error_estimate_drag_force_x", "error_estimate_drag_force_x_mean"])
    np.testing.assert_array_equal(f.bounds, [[0.5, 1.0]])
    many = model.run_many({"lid": [0.6, 0.8]})
    errors = many.error_estimate_drag_force.sel(component="x")
    expected = np.stack([errors[:, -1], errors.mean("snapshot")], axis=1)
    np.testing.assert_allclose(f([[0.6], [0.8]]), expected, rtol=1e-12)
    with pytest.raises(CaseError, match="has no derivatives"):
        f.jacobian([0.8])


@pytest.mark.parametrize(
    ("inputs", "outputs", "time", "text"),
    [
        (["speed"], ["drag_force_x"], None, "'speed': does not vary in the case"),
        (
            ["lid", "lid"],
            ["drag_force_x"],
            None,
            "inputs: needs at least one name, and each only once",
        ),
        (["lid"], [], None, "outputs: needs at least one name"),
        (["lid"], ["drag_force"], None, "did you mean drag_force_"),
        (["lid"], ["middle_velocity_x"], None, "is not an output"),
        (["lid"], ["drag_force_x"], 0.7, "time: must be in the runs, from 0 to 0.6 s; got 0.7"),
    ],
)
def test_what_is_refused(
    study: sphrom.Study, inputs: Any, outputs: Any, time: float | None, text: str
) -> None:
    with pytest.raises(CaseError, match=text):
        study.model("fast", reynolds=120, lid=0.8).function(inputs, outputs, time)
