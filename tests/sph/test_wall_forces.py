"""What fluid does to walls: minus what they do to it, and shared out rightly."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.mark.parametrize("name", ["box", "lid", "forced cavity", "shapes"])
@pytest.mark.parametrize("viscosity", ["laplacian", "pair"])
def test_walls_take_the_momentum_that_they_give(scenes: dict, name: str, viscosity: str) -> None:
    """All forces on ghosts, against the momentum that fluid without a body force gains."""
    scene = scenes[name]
    options = {"viscosity": viscosity, "acoustic_damping": 1.0, "shifting": False}
    functional = scene.functional(**options)
    state = scene.state(3)
    rates, mass = functional(state, 0.3), functional.mass
    if functional.body_force is not None:
        rates[3:] -= functional.body_force(state[:2], 0.3)
    forces = functional.ghost_forces(state, 0.3)
    gained = mass * rates[3:].sum(axis=1)
    assert np.abs(forces.sum(axis=(0, 2)) + gained).max() < 1e-10 * np.abs(forces).sum()
    assert np.abs(gained).max() > 1e-3 * np.abs(mass * rates[3:]).sum()


def test_fluid_at_rest_pushes_walls_apart(scenes: dict) -> None:
    """A uniform pressure on a box: each side's force is the pressure times its length."""
    scene = scenes["box"]
    functional = scene.functional()
    state = scene.state(0, jitter=0.0, amplitude=0.0)
    state[2] = 2.0
    pressure = functional.fluid.sound_speed**2 * 2.0
    push, friction = functional.ghost_forces(state)
    assert not friction.any()
    walls, names = functional.ghosts.walls, scene.domain.wall_names
    width, height = scene.domain.lengths
    expected = {
        "left": (-height, 0),
        "right": (height, 0),
        "bottom": (0, -width),
        "top": (0, width),
    }
    for name, force in expected.items():
        found = push[:, walls.wall == names.index(name)].sum(axis=1) / pressure
        # Corners are the sides': their share is of the order of the support, less in the sum.
        np.testing.assert_allclose(found, force, atol=0.15)
    np.testing.assert_allclose(push.sum(axis=1), 0.0, atol=1e-9 * pressure)
