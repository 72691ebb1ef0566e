"""What pushes and slows the fluid of a case, wherever its particles are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.setup.particles import functional, sampler

SCENE: dict[str, Any] = {
    "kind": "custom",
    "box": {"lower": [-1, 0], "upper": [3, 1], "periodic": ["x"]},
    "reference_length": 1.0,
    "initial": {"u": "1 + 0.3*sin(x)", "v": "0.1*x"},
}
PLUG = {"circle": {"centre": [3, 0.5], "radius": 0.4}, "permeability": 1.0}
INFLOW = {"strip": {"from": -1, "to": 0}, "velocity": ["y*(1 - y)", "0.1*x"], "ramp": 0.0}
PARTS: dict[str, Any] = {
    "body_force": ["x*(3 - x)", "sin(x)"],
    "resistance": "1 + x**2",
    "porous": {"plug": PLUG},
    "inflow": INFLOW,
    "walls": {"top": {"velocity": ["x*(3 - x)", 0]}},
}
"""What depends on x, each in a way that doesn't repeat."""


@pytest.mark.parametrize("part", PARTS)
def test_a_box_length_on_everything_is_the_same(part: str) -> None:
    """Particles that leave a periodic box are in it again, and so are places that are asked for."""
    scene, cut = {**SCENE, part: PARTS[part]}, {"resolution": 10}
    case = Case.model_validate({"name": "x", "scene": scene, "discretization": cut})
    point, random = case.plan.points[0], np.random.default_rng(0)
    flow, of = case.plan.flow(point), functional(case, point)
    place = flow.domain.fill(case.plan.particle_spacing)
    place = place + 0.02 * random.uniform(-1, 1, place.shape)
    moved, density = place.copy(), np.zeros(len(place))
    moved[:, 0] += 4.0 * random.integers(-2, 3, len(place))
    start = flow.initial_velocity(place)
    assert flow.initial_velocity(moved) == pytest.approx(start, abs=1e-12)
    here, there = (of(np.vstack((at.T, density, start.T)), 0.7) for at in (place, moved))
    assert np.abs(here[3:]).max() > 0.5
    assert there == pytest.approx(here, abs=1e-9)
    _, (left, right) = sampler(case, np.array([[-1, 0.5], [3, 0.5]]))(moved, density, start)
    assert left == pytest.approx(right, abs=1e-12)
