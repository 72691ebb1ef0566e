"""Operators at the points of a lattice in three dimensions."""

import numpy as np
import pytest

from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.lattice_points import LatticePoints
from sphrom.sph.space_box import SpaceBox

FLUID = Fluid(reference_density=1000.0, sound_speed=10.0, kinematic_viscosity=0.01, max_speed=1.0)
CLOSED = (False, False, False)
BOXES = {
    "periodic": SpaceBox((0.0, 0.0, 0.0), (1.0, 0.8, 0.6), (True, True, True)),
    "channel": SpaceBox((0.0, 0.0, 0.0), (1.0, 0.8, 0.6), (True, False, True)),
    "closed": SpaceBox((0.0, 0.0, 0.0), (1.0, 0.8, 0.6), CLOSED),
}


def points_in(box: SpaceBox, spacing: float, top_speed: float = 0.0) -> LatticePoints:
    discretization = Discretization(spacing, 2.0 * spacing, acoustic_damping=0.1)
    walls = None
    if box.has_walls:

        def velocity(place: np.ndarray) -> np.ndarray:
            out = np.zeros_like(place)
            out[:, 0] = np.where(place[:, 1] > box.upper[1], top_speed, 0.0)
            return out

        walls = box.ghosts(spacing, discretization.n_layers).moving(velocity)
    return LatticePoints(box.fill(spacing), FLUID, discretization, box, walls)


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES)
def test_sound_neither_gains_nor_loses_energy_and_friction_dissipates(box: SpaceBox) -> None:
    points = points_in(box, 0.1)
    rng = np.random.default_rng(1)
    q = rng.normal(size=(points.n_points, 2))
    u, v = rng.normal(size=(2, 3, points.n_points, 2))
    at_rest = np.zeros_like(u)
    terms = points.terms(q, at_rest)
    # D = -G^T, V = V^T <= 0, and diffusion conserves the mass.
    power = np.sum(q * points.divergence(u))
    assert power == pytest.approx(-np.sum(terms.pressure_gradient * u), rel=1e-11)
    friction = points.terms(q, u).laplacian
    assert np.sum(v * friction) == pytest.approx(np.sum(u * points.terms(q, v).laplacian))
    assert np.sum(u * friction) < 0.0
    diffusion = points.diffusion(q)
    assert abs(diffusion.sum()) < 1e-12 * np.abs(diffusion).sum()
    assert np.sum(q * diffusion) < 0.0


def test_some_rows_have_the_terms_of_all() -> None:
    points = points_in(BOXES["closed"], 0.1)
    rng = np.random.default_rng(2)
    q = rng.normal(size=(points.n_points, 2))
    u = rng.normal(size=(3, points.n_points, 2))
    rows = slice(100, 200)
    some = vars(points.terms(q, u, rows))
    whole = vars(points.terms(q, u))
    for name, values in some.items():
        np.testing.assert_array_equal(values, whole[name][..., rows, :], err_msg=name)


def test_couette_flow_is_exact() -> None:
    points = points_in(BOXES["channel"], 0.1, top_speed=2.0)
    velocity = np.zeros((3, points.n_points, 1))
    velocity[0, :, 0] = 2.0 * points.position[:, 1] / 0.8
    friction = points.wall_friction
    assert friction is not None
    at_rest = points.terms(np.zeros((points.n_points, 1)), velocity).laplacian[..., 0]
    assert np.abs(at_rest + friction).max() < 1e-11 * np.abs(friction).max()


def test_hydrostatic_pressure_balances_a_body_force() -> None:
    points = points_in(BOXES["closed"], 0.1)
    force = np.zeros((3, points.n_points))
    force[2] = -1.0
    q = (force[2] * (points.position[:, 2] - 0.3) / FLUID.sound_speed)[:, None]
    at_rest = np.zeros((3, points.n_points, 1))
    push = points.terms(q, at_rest).pressure_gradient[..., 0]
    rates = force + points.head_push(force) - FLUID.sound_speed * push
    # As near one as the sums of the kernel's gradient give a slope.
    assert np.abs(rates).max() < 1e-3


def test_gradients_and_friction_converge() -> None:
    errors = []
    for n in (12, 24):
        box = SpaceBox((0.0, 0.0, 0.0), (2.0 * np.pi,) * 3, (True, True, True))
        points = points_in(box, 2.0 * np.pi / n)
        x, y, z = points.position.T
        wave = (np.sin(x) * np.cos(y) * np.cos(z))[:, None]
        slope = np.cos(x) * np.cos(y) * np.cos(z)
        laplacian = points.terms(wave, np.stack((wave, wave, wave))).laplacian
        found = points.gradients(wave)[0, :, 0], laplacian[0, :, 0]
        exact = slope, -3.0 * wave[:, 0]
        errors.append([np.abs(f - e).max() for f, e in zip(found, exact, strict=True)])
    orders = np.log2(np.divide(*errors))
    assert orders[0] > 1.6
    assert orders[1] > 3.5


def test_points_off_a_lattice_are_refused() -> None:
    box = BOXES["periodic"]
    points = box.fill(0.1)
    points[3] += 0.01
    with pytest.raises(ValueError, match="lattice"):
        LatticePoints(points, FLUID, Discretization(0.1, 0.2), box)
