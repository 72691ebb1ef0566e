"""What pushes and slows the fluid of a case, wherever particles are and however strong it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.setup.particles import functional, sampler

LENGTH = 4.0
SCENE: dict[str, Any] = {
    "kind": "custom",
    "box": {"lower": [-1, 0], "upper": [3, 1], "periodic": ["x"]},
    "reference_length": 1.0,
    "initial": {"u": "1 + 0.3*sin(x)", "v": "0.1*x"},
}
INFLOW = {"strip": {"from": -1, "to": 0}, "velocity": ["y*(1 - y)", "0.1*x"], "ramp": 0.0}
PARTS: dict[str, dict[str, Any]] = {
    "body_force": {"body_force": ["x*(3 - x)", "sin(x)"]},
    "resistance": {"resistance": "1 + x**2"},
    "porous": {
        "porous": {"a": {"circle": {"centre": [3, 0.5], "radius": 0.4}, "permeability": 1.0}}
    },
    "inflow": {"inflow": INFLOW},
    "walls": {"walls": {"top": {"velocity": ["x*(3 - x)", 0]}}},
}
"""What depends on x, each in a way that doesn't repeat."""


def case_of(resolution: int = 10, **scene: Any) -> Case:
    return Case.model_validate(
        {
            "name": "x",
            "scene": {**SCENE, **scene},
            "discretization": {"resolution": resolution},
            "parameters": {"train": {"reynolds": [50]}},
        }
    )


@pytest.mark.parametrize("part", PARTS)
def test_a_box_length_on_everything_is_the_same(part: str) -> None:
    """Particles that leave a periodic box are in it again, and so are places that are asked for."""
    case = case_of(**PARTS[part])
    point = case.plan.points[0]
    flow, here = case.plan.flow(point), functional(case, point)
    random = np.random.default_rng(0)
    position = flow.domain.fill(case.plan.particle_spacing)
    position = position + 0.2 * case.plan.particle_spacing * random.uniform(-1, 1, position.shape)
    moved = position + LENGTH * np.stack(
        (random.integers(-2, 3, len(position)), np.zeros(len(position))), axis=1
    )
    rates, starts = [], []
    for place in (position, moved):
        starts.append(flow.initial_velocity(place))
        density = np.zeros(len(place))
        rates.append(here(np.vstack((place.T, density, flow.initial_velocity(position).T)), 0.7))
    assert np.abs(rates[0][3:]).max() > 0.5
    assert rates[1] == pytest.approx(rates[0], abs=1e-9)
    assert starts[1] == pytest.approx(starts[0], abs=1e-12)
    ends = np.array([[-1.0, 0.5], [3.0, 0.5]])
    _, (left, right) = sampler(case, ends)(moved, density, flow.initial_velocity(position))
    assert left == pytest.approx(right, abs=1e-12)
