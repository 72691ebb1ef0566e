"""Measurements of particles in three dimensions: exact for quadratic fields away from walls."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.setup.particles import MeasuredParticles

RATES = np.random.default_rng(3).normal(size=(3, 4))
SCENE = {
    "box": {"lower": [0, 0, 0], "upper": [1, 1, 1.2]},
    "measure": {
        "spot": {"probe": [0.4, 0.5, 0.7]},
        "flux": {"flow_rate": {"from": [0.3, 0.3, 0.5], "to": [0.7, 0.6, 0.5]}},
        "profile": {"line": {"from": [0.3, 0.3, 0.3], "to": [0.6, 0.7, 0.8], "points": 5}},
        "along": {"integral": {"from": [0.3, 0.3, 0.5], "to": [0.7, 0.3, 0.5]}},
    },
}


def velocity(place: np.ndarray) -> np.ndarray:
    """Return a quadratic field (n_points, 3)."""
    x, y, z = place.T
    return (RATES @ np.stack((np.ones(len(x)), x * y, z * z - x, y))).T


def test_measured_particles_in_space(case_of) -> None:
    case = case_of("custom", 10, scene=SCENE)
    position = case.scene.fill(case.plan.particle_spacing)
    shaken = position + 0.01 * np.sin(40.0 * position[:, [1, 2, 0]])
    density = shaken[:, 2] / case.plan.sound_speed**2
    measured = MeasuredParticles.of(case, case.plan.points[0])
    found = measured(shaken, density, velocity(shaken))
    spot = np.array([[0.4, 0.5, 0.7]])
    np.testing.assert_allclose(found["spot"]["velocity"], velocity(spot), atol=1e-9)
    assert found["spot"]["pressure"] == pytest.approx([0.7], abs=1e-6)
    line = np.linspace([0.3, 0.3, 0.3], [0.6, 0.7, 0.8], 5)
    np.testing.assert_allclose(found["profile"]["velocity"], velocity(line), atol=1e-9)
    # The mean over the rectangle is exact for x y and for a field that is linear in x or y.
    mean = velocity(np.array([[0.5, 0.45, 0.5]]))[0, 2]
    assert found["flux"]["flow_rate"] == pytest.approx(0.4 * 0.3 * mean)
    middle = velocity(np.array([[0.5, 0.3, 0.5]]))[0]
    np.testing.assert_allclose(found["along"]["velocity_integral"], 0.4 * middle, atol=1e-9)
    assert found["along"]["pressure_integral"] == pytest.approx(0.4 * 0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("measure", "problem"),
    [
        ({"probe": [0.4, 0.5]}, "a place has the coordinates x, y, z here; got [0.4, 0.5]"),
        ({"probe": [0.4, 0.5, 1.3]}, "(0.4, 0.5, 1.3) m is outside of the box"),
        (
            {"flow_rate": {"from": [0.1, 0.1, 0.1], "to": [0.1, 0.1, 0.5]}},
            "its corners must be equal along one axis, and differ along the two others",
        ),
    ],
)
def test_places_that_do_not_fit_a_box_in_space_are_refused(measure, problem, case_of) -> None:
    scene = {"box": SCENE["box"], "measure": {"spot": measure}}
    case = case_of("custom", 10, scene=scene)
    assert case.scene.measure["spot"].problem(case) == problem
