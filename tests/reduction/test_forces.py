"""Forces on walls in generalized coordinates, against those of the fields that they mean."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.operator_projection import project_forces
from sphrom.sph.wall_forces import MeasuredWall

NU, SPEED, AMPLITUDE, MEAN = 0.013, 0.6, -1.4, 0.3
NAMES = ["lid", "lid with its mean", "forced", "raw", "raw and forced"]


def a_wall(n_ghosts: int) -> MeasuredWall:
    """Return a wall that weighs ghosts at random."""
    weights = np.random.default_rng(5).standard_normal((3, 2, n_ghosts))
    return MeasuredWall(weights, circulation=0.7)


def expected(points, wall: MeasuredWall, q: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the pressure's and the viscous loads (2, 3) of fields at the points."""
    pressure = points.ghost_pressures(q[:, None], velocity[..., None])[..., 0]
    if points.body_force is not None:
        head = (1.0 + q / points.sound_speed) * points.body_force
        pressure = pressure + AMPLITUDE * points.ghost_heads(head)
    viscous = points.ghost_friction(velocity[..., None])[..., 0] + SPEED * points.ghost_drag
    loads = np.stack((wall.loads(pressure), NU * wall.loads(viscous)))
    loads[1, 2] -= NU * SPEED * points.reference_density * wall.circulation
    return loads


@pytest.mark.parametrize("name", NAMES)
def test_forces_are_those_of_the_fields(settings, unprojected, name: str) -> None:
    setting = settings[name]
    points = setting.points
    wall = a_wall(points.ghost_drag.shape[1])
    force = project_forces(points, setting.basis, wall)
    states = np.outer((1.0, 0.3), setting.coordinates)
    some = states * [1.0, 0.0, 0.0, 1.0, 0.0]
    about = MEAN, NU, SPEED, np.full(2, AMPLITUDE)
    found = force.at(states, *about)
    chosen = force.of_modes(np.array([0, 3])).at(some[:, [0, 3]], *about)
    np.testing.assert_allclose(chosen, force.at(some, *about), rtol=1e-12)
    model = unprojected(points, setting.basis)
    for coordinates, loads in zip(states, found, strict=True):
        q, velocity = model.fields(coordinates)
        wanted = expected(points, wall, q + points.density_scale * MEAN, velocity)
        np.testing.assert_allclose(loads, wanted, rtol=1e-9, atol=1e-11 * np.abs(wanted).max())
