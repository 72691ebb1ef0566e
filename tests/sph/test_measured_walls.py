"""Forces and torques on walls that are named: where they act, and about what."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional, WallForces, measured_wall
from sphrom.sph.packing import pack
from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.polygons import disc

SPACING = 0.05
FLUID = Fluid(reference_density=2.0, sound_speed=10.0, kinematic_viscosity=0.1, max_speed=1.0)
RADIUS = 0.3


def around(centre: tuple[float, float], rate: float):
    """Return velocities of walls that turn about a centre."""
    return lambda at: rate * np.stack((centre[1] - at[:, 1], at[:, 0] - centre[0]), axis=1)


def domain_of(centre: tuple[float, float]) -> PolygonDomain:
    """Return a periodic box with a cylinder, which may cross its edges."""
    return PolygonDomain((0.0, 0.0), (1.2, 1.0), (True, True), (("disc", disc(centre, RADIUS)),))


@pytest.mark.parametrize("centre", [(0.6, 0.5), (0.0, 0.1), (1.15, 0.95)])
def test_arms_and_circulation_know_periodic_images(centre) -> None:
    domain = domain_of(centre)
    discretization = Discretization(SPACING, 2.0 * SPACING)
    walls = domain.ghosts(SPACING, discretization.n_layers)
    arms = domain.arms("disc", domain.on_wall(walls.position))
    np.testing.assert_allclose(np.hypot(*arms.T), RADIUS, rtol=1e-3)
    np.testing.assert_allclose(arms.mean(axis=0), 0.0, atol=0.02)

    def turning(at: np.ndarray) -> np.ndarray:
        away = domain.arms("disc", at)
        return 3.0 * np.stack((-away[:, 1], away[:, 0]), axis=1)

    area = math.pi * RADIUS**2
    assert domain.circulation("disc", turning) == pytest.approx(6.0 * area, rel=1e-3)


def test_only_the_edge_to_the_fluid_circulates() -> None:
    """The fluid is inside of the solid: the solid's outer edge turns too, but moves nothing."""
    hole = shapely.difference(shapely.box(-2, -2, 2, 2), disc((0, 0), RADIUS))
    domain = PolygonDomain((-0.5, -0.5), (0.5, 0.5), (False, False), (("drum", hole),))
    area = math.pi * RADIUS**2
    found = domain.circulation("drum", around((0.0, 0.0), 3.0))
    assert found == pytest.approx(-6.0 * area, rel=1e-3)
    assert domain.circulation("left", around((0.0, 0.0), 3.0)) == 0.0


def forces_on(domain: PolygonDomain, rate: float, state: np.ndarray) -> dict[str, np.ndarray]:
    turn = around((0.6, 0.5), rate)

    def velocity(position: np.ndarray) -> np.ndarray:
        return turn(domain.on_wall(position))

    discretization = Discretization(SPACING, 2.0 * SPACING)
    walls = domain.ghosts(SPACING, discretization.n_layers).moving(velocity)
    functional = Functional(FLUID, discretization, domain, walls)
    wall = measured_wall(domain, walls, "disc", velocity)
    return WallForces(functional, {"drag": wall})(state, 0.0)


def test_fluid_that_turns_with_a_cylinder_leaves_it_alone() -> None:
    """A rotation as a whole has no stress: the torque of mu du/dn, which isn't zero, is not all.

    Measured, of that torque: 2.6, 2.1 and 1.1 % at 6, 12 and 24 spacings per radius.
    """
    domain = domain_of((0.6, 0.5))
    discretization = Discretization(SPACING, 2.0 * SPACING)
    ghosts = domain.ghosts(SPACING, discretization.n_layers).position
    position = pack(domain, discretization, ghosts=ghosts, perturbation=0.0).position
    velocity = around((0.6, 0.5), 2.0)(position)
    state = np.vstack((position.T, np.zeros(len(position)), velocity.T))
    push, friction = forces_on(domain, 2.0, state)["drag"]
    viscosity = FLUID.reference_density * FLUID.kinematic_viscosity
    torque_of_rotation = viscosity * 2.0 * 2.0 * math.pi * RADIUS**2
    assert not push.any()
    assert np.abs(friction[:2]).max() < 0.01 * torque_of_rotation / RADIUS
    assert abs(friction[2]) < 0.04 * torque_of_rotation


def test_a_pressure_gradient_pushes_a_cylinder_as_much_as_what_it_displaces() -> None:
    domain = domain_of((0.6, 0.5))
    position = domain.fill(SPACING)
    x = position[:, 0] - 0.6
    state = np.vstack((position.T, 0.01 * x, np.zeros((2, len(position)))))
    push, friction = forces_on(domain, 0.0, state)["drag"]
    gradient = 0.01 * FLUID.sound_speed**2
    assert push[0] == pytest.approx(-gradient * math.pi * RADIUS**2, rel=0.15)
    assert np.abs(push[1:]).max() < 0.05 * abs(push[0])
    assert not friction.any()


def pushes(scene, pressure: float) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return force and torque on each wall of fluid at rest at a uniform pressure, over it."""
    functional = scene.functional()
    state = scene.state(0, jitter=0.0, amplitude=0.0)
    state[2] = pressure / functional.fluid.sound_speed**2
    push = functional.ghost_forces(state)[0]
    walls, domain = functional.ghosts.walls, scene.domain
    found = {}
    for name in domain.wall_names:
        found[name] = measured_wall(domain, walls, name, np.zeros_like).loads(push) / pressure
    return found, push / pressure


def test_fluid_at_rest_pushes_walls_apart(scenes: dict) -> None:
    """Each side of a box has the pressure times its length, also behind the box's corners."""
    found, _ = pushes(scenes["box"], 1e-3)
    width, height = scenes["box"].domain.lengths
    expected = {
        "left": (-height, 0.0, 0.0),
        "right": (height, 0.0, 0.0),
        "bottom": (0.0, -width, 0.0),
        "top": (0.0, width, 0.0),
    }
    for name, loads in expected.items():
        np.testing.assert_allclose(found[name], loads, atol=1e-3)


def test_forces_behind_corners_are_along_normals(scenes: dict) -> None:
    """A fin on a floor that it meets at 98 and 113 degrees, on a lattice cut by both.

    Measured, along the floor: 0.004 of the pressure; 0.019 where each ghost belongs to one wall.
    """
    found, push = pushes(scenes["shapes"], 1e-3)
    np.testing.assert_allclose(sum(found.values())[:2], push.sum(axis=1), atol=1e-12)
    assert abs(found["bottom"][0]) < 0.006
    assert found["fin"][1] == pytest.approx(-0.343, abs=0.04)
    assert found["bottom"][1] == pytest.approx(0.343 - 1.5, abs=0.02)
