"""What can be had without a model, from training runs that are known functions of the parameter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.case.points import ParameterPoint
from sphrom.metrics.samples import Samples
from sphrom.trade import nothing

TIME = np.linspace(0.0, 1.0, 5)
PRESSURE = np.ones((5, 1))


def run_at(point: ParameterPoint) -> Samples:
    """A flow whose speed is the logarithm of the Reynolds number."""
    speed = math.log(point.reynolds) * (1.0 + TIME)[:, None, None]
    return Samples(TIME, np.repeat(speed, 2, axis=2), PRESSURE)


def error_at(point: ParameterPoint, samples: Samples) -> dict[str, float | None]:
    """The largest error of the velocity [%]."""
    exact = run_at(point).velocity
    largest = np.abs(samples.velocity - exact).max() / np.abs(exact).max()
    return dict.fromkeys(("velocity_field_relative_l2",), 100.0 * float(largest))


def rows(trained, tested, monkeypatch) -> dict[str, float]:
    monkeypatch.setattr(nothing, "mean_errors", lambda each: max(*each[0].values(), 0.0))
    points = {ParameterPoint(value): run_at(ParameterPoint(value)) for value in tested}
    known = tuple(map(ParameterPoint, trained))
    found = nothing.nothing_rows(points, known, run_at, error_at, places_of)
    return {row.name: row.errors for row in found}


def places_of(points) -> np.ndarray:
    return np.log([[point.reynolds] for point in points])


def test_interpolated_runs_are_better_than_the_nearest(monkeypatch):
    found = rows([50.0, 100.0, 200.0], [140.0], monkeypatch)
    assert list(found) == [nothing.NEAREST, nothing.INTERPOLATED, nothing.UNCHANGED]
    assert found[nothing.INTERPOLATED] < 1e-6 < 1.0 < found[nothing.NEAREST]


def test_a_trained_value_is_not_its_own_interpolation(monkeypatch):
    assert nothing.INTERPOLATED not in rows([100.0, 200.0], [100.0], monkeypatch)
    assert nothing.INTERPOLATED in rows([50.0, 100.0, 200.0], [100.0], monkeypatch)


def test_one_training_run_can_not_be_interpolated(monkeypatch):
    found = rows([100.0], [140.0], monkeypatch)
    assert list(found) == [nothing.NEAREST, nothing.UNCHANGED]
    assert found[nothing.NEAREST] == pytest.approx(100.0 * (1.0 - math.log(100) / math.log(140)))
