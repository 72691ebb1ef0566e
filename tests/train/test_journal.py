"""Stages of a training as they are kept."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np

from sphrom.case.points import ParameterPoint
from sphrom.train.journal import HeldOut, Stage, _stage


def test_a_stage_is_read_as_it_was_written() -> None:
    points = tuple(ParameterPoint(re, (("lid", 0.5), ("angle", 2.0))) for re in (100.0, 400.0))
    errors = {name: np.array([k, k + 0.5]) for k, name in enumerate(("estimate", "error", "floor"))}
    run = HeldOut(point=points[1], failure="", **errors)
    stage = Stage(points, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.1, 0.2]), (run,))
    found = _stage(json.loads(json.dumps(asdict(stage), default=np.ndarray.tolist)))
    assert found.points == points
    np.testing.assert_array_equal(found.estimates, stage.estimates)
    np.testing.assert_array_equal(found.floor, stage.floor)
    (kept,) = found.held_out
    assert (kept.point, kept.failure) == (points[1], "")
    for name, expected in errors.items():
        np.testing.assert_array_equal(getattr(kept, name), expected)
