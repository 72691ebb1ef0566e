"""The operators on fixed points, against the functional at those points without shifting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import Discretization, Fluid, Resistance, Strip
from sphrom.sph.functional import Functional

SPACING = 0.0625
FLUID = Fluid(reference_density=800.0, sound_speed=7.0, kinematic_viscosity=0.013, max_speed=0.9)
DISCRETIZATION = Discretization(SPACING, 1.6 * SPACING, shifting=False)
SCALE = FLUID.sound_speed / FLUID.reference_density
NO_DIFFUSION = {"diffusion_coefficient": 0.0}


def push(position: np.ndarray) -> np.ndarray:
    """Return a body force that depends on place, per unit of amplitude."""
    x, y = position
    return np.stack((1.0 + np.sin(x), -2.0 + y))


class Setting:
    """Points of a scene, its operators, and its functional with walls and force scaled."""

    def __init__(
        self,
        scenes,
        rates,
        name: str,
        seed: int = 3,
        resistance: Resistance | None = None,
        **options,
    ) -> None:
        self.at_points = rates
        self.scene = scenes[name]
        self.domain, self.resistance = self.scene.domain, resistance
        if resistance is not None:
            in_box = lambda at: self.domain.wrap(at.T).T  # noqa: E731
            self.resistance = replace(resistance, in_box=in_box)
        self.discretization = replace(DISCRETIZATION, **options)
        self.position = self.scene.state(seed)[:2].T
        random = np.random.default_rng(seed)
        self.q, self.u, self.v = random.standard_normal((3, len(self.position)))
        self.force = self.scene.body_force
        self.points = FixedPoints(
            self.position,
            FLUID,
            self.discretization,
            self.domain,
            self.walls(1.0),
            None if self.force is None else push(self.position.T),
            resistance=self.resistance,
        )

    def walls(self, speed: float):
        if not self.domain.has_walls:
            return None
        at_rest = self.domain.ghosts(SPACING, self.discretization.n_layers)
        return at_rest.moving(lambda place: speed * self.scene.wall_velocity(place))

    def functional(self, q, velocity, speed: float = 0.0, amplitude: float = 0.0, fluid=FLUID):
        """Return the functional's rates (3, n_points) of q and velocity."""
        force = None if self.force is None else lambda x, time: amplitude * push(x)
        functional = Functional(
            fluid,
            self.discretization,
            self.domain,
            self.walls(speed),
            force,
            resistance=self.resistance,
        )
        rates = functional.evaluate(self.position.T.copy(), q / SCALE, velocity)
        return np.vstack((SCALE * rates.density, rates.velocity))

    def rates(self, q, velocity, order, speed: float = 0.0, amplitude: float = 0.0):
        conditions = {
            "viscosity": FLUID.kinematic_viscosity,
            "wall_speed": speed,
            "amplitude": amplitude,
        }
        gradients = np.zeros((3, 2, len(self.position)))
        return self.at_points(self.points, q, velocity, gradients, conditions, order)


@pytest.fixture
def setting(scenes, point_rates) -> Callable[..., Setting]:
    return lambda name, **options: Setting(scenes, point_rates, name, **options)


def close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare by row, in units of the row's size."""
    for a, b in zip(actual, expected, strict=True):
        assert np.max(np.abs(a - b)) <= tolerance * np.max(np.abs(b))


SLOWED = Resistance(
    own=lambda at: 2.0 + np.sin(at[1]),
    inverse_permeability=lambda at: np.where(at[0] > 0.5, 300.0, 0.0),
    strip=Strip(0, 0.2, 0.6, -0.4, 20.0),
)
"""All that slows fluid in a box that repeats along x."""
NAMES = ["periodic", "box", "lid", "cavity", "forced cavity", "shapes"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "options", [{}, {"fixed_volume": True}, {"acoustic_damping": 0.7}], ids=str
)
def test_of_velocity_the_rates_are_the_functional_s(setting, name: str, options: dict) -> None:
    """At the reference density every volume is dx^2, so that all of it is equal to rounding."""
    here = setting(name, **options)
    velocity, zero = np.stack((here.u, here.v)), np.zeros_like(here.q)
    for speed in (0.0, 1.7):
        expected = here.functional(zero, velocity, speed)
        close(here.rates(zero, velocity, None, speed), expected, 1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("options", [{}, NO_DIFFUSION, {"fixed_volume": True}], ids=str)
def test_of_density_the_linear_part_is_the_functional_s(setting, name: str, options: dict) -> None:
    here = setting(name, **options)
    zero = np.zeros((2, here.q.size))

    def derivative(function) -> np.ndarray:
        """Return the central difference, without its second-order error."""
        at = [(function(s * here.q) - function(-s * here.q)) / (2.0 * s) for s in (2e-3, 1e-3)]
        return (4.0 * at[1] - at[0]) / 3.0

    expected = derivative(lambda q: here.functional(q, zero))
    actual = derivative(lambda q: here.rates(q, zero, 1))
    if "diffusion_coefficient" in options:
        assert np.max(np.abs(actual[0])) == 0.0
        assert np.max(np.abs(expected[0])) == 0.0
        actual, expected = actual[1:], expected[1:]
    close(actual, expected, 1e-8)


@pytest.mark.parametrize("name", ["periodic", "cavity", "shapes"])
def test_what_slows_the_fluid_does_so_at_fixed_points_too(setting, name: str) -> None:
    """To first order, as the functional's ghosts give way to their heads."""
    here = setting(name, resistance=SLOWED, acoustic_damping=0.7)
    for q, velocity in ((here.q, np.zeros((2, here.q.size))), (0.0 * here.q, [here.u, here.v])):
        states = [(s * q, s * np.stack(velocity)) for s in (1e-5, -1e-5)]
        found, expected = (
            np.subtract(*[rates(*state)[1:] for state in states])
            for rates in (lambda q, u: here.rates(q, u, 1), here.functional)
        )
        close(found, expected, 1e-6)


def test_driven_walls_move_with_the_amplitude(setting) -> None:
    here = setting("lid")
    driven = FixedPoints(
        here.position, FLUID, here.discretization, here.domain, here.walls(1.0), walls_driven=True
    )
    velocity, gradients = np.stack((here.u, here.v)), np.zeros((3, 2, here.q.size))
    for amplitude in (0.0, 0.7):
        around = {"viscosity": FLUID.kinematic_viscosity, "wall_speed": 2.0, "amplitude": amplitude}
        found = here.at_points(driven, 0.1 * here.q, velocity, gradients, around)
        close(found, here.rates(0.1 * here.q, velocity, None, 2.0 * amplitude), 1e-12)


@pytest.mark.parametrize("name", ["forced box", "forced cavity"])
def test_of_a_body_force_the_head_is_the_functional_s(setting, name: str) -> None:
    """To first order in the force, as the functional's ghosts give way to their heads."""
    here = setting(name, wall_kind="adjoint")
    zero, rest = np.zeros_like(here.q), np.zeros((2, here.q.size))
    force = 1e-4
    either = [here.functional(zero, rest, 0.0, sign * force)[1:] for sign in (1.0, -1.0)]
    expected = (either[0] - either[1]) / (2.0 * force)
    actual = here.rates(zero, rest, None, 0.0, 1.0)[1:]
    close(actual, expected, 1e-8)
    push_alone = push(here.position.T)
    assert np.max(np.abs(actual - push_alone)) > 0.1 * np.max(np.abs(push_alone))


@pytest.mark.parametrize("name", ["periodic", "box", "cavity", "shapes"])
def test_divergence_is_minus_the_transposed_gradient(setting, name: str) -> None:
    here = setting(name)
    left = here.points.terms(here.q[:, None], np.zeros((2, here.q.size, 1)))
    right = here.points.terms(np.zeros((here.q.size, 1)), np.stack((here.u, here.v))[..., None])
    pushed = np.sum(left.pressure_gradient[..., 0] * np.stack((here.u, here.v)))
    spread = here.q @ right.divergence[:, 0]
    scale = np.linalg.norm(left.pressure_gradient) * np.linalg.norm((here.u, here.v))
    assert abs(pushed + spread) < 1e-14 * scale
    assert abs(pushed) > 1e-3 * scale


@pytest.mark.parametrize("name", ["periodic", "box", "cavity", "shapes"])
def test_the_damper_takes_the_square_of_the_divergence(setting, name: str) -> None:
    """Its power is -alpha h c0 |D u|^2; without walls it moves the fluid as a whole nowhere."""
    here = setting(name, acoustic_damping=0.7)
    velocity = np.stack((here.u, here.v))
    terms = here.points.terms(np.zeros((here.q.size, 1)), velocity[..., None])
    force = -FLUID.sound_speed * terms.damping[..., 0]
    power = np.sum(velocity * force)
    lost = 0.7 * here.discretization.smoothing_length * FLUID.sound_speed
    lost *= np.sum(terms.divergence**2)
    assert power == pytest.approx(-lost, rel=1e-12)
    assert np.array_equal(terms.damping, terms.pressure_gradient)
    assert setting(name).points.terms(here.q[:, None], velocity[..., None]).damping is None
    if name == "periodic":
        assert np.max(np.abs(force.sum(axis=1))) < 1e-13 * np.abs(force).sum()


def test_terms_of_some_rows_are_rows_of_the_terms(setting) -> None:
    here = setting("cavity", acoustic_damping=0.7)
    fields = np.random.default_rng(0).standard_normal((3, here.q.size, 4))
    whole, rows = here.points.terms(fields[0], fields[1:]), slice(17, 60)
    some = here.points.terms(fields[0], fields[1:], rows)
    assert np.allclose(some.divergence, whole.divergence[rows], rtol=1e-13, atol=1e-12)
    assert np.allclose(some.laplacian, whole.laplacian[:, rows], rtol=1e-13, atol=1e-10)
    for part, all_of in (
        (some.pressure_gradient, whole.pressure_gradient),
        (some.damping, whole.damping),
    ):
        assert np.allclose(part, all_of[:, rows], rtol=1e-13, atol=1e-12 * np.max(np.abs(all_of)))
    slopes = here.points.gradients(fields[0])
    assert np.allclose(here.points.gradients(fields[0], rows), slopes[:, rows], atol=1e-11)


@pytest.mark.parametrize("name", ["box", "cavity"])
def test_gradients_are_exact_for_linear_fields(setting, name: str) -> None:
    here = setting(name)
    middle = 0.5 * (here.domain.lower[0] + here.domain.upper[0])
    inside = np.abs(here.position[:, 0] - middle) < 0.25
    field = 3.0 * here.position[:, 0] - 2.0 * here.position[:, 1]
    slope = here.points.gradients(field)
    assert np.allclose(slope[:, inside], [[3.0], [-2.0]], atol=1e-11)


def test_the_expansion_is_of_the_order_that_it_says(setting) -> None:
    here = setting("forced cavity")
    velocity = np.stack((here.u, here.v))
    errors = {}
    for order in (0, 1):
        for size in (1e-2, 1e-3):
            exact, expanded = (
                here.rates(size * here.q, velocity, o, 1.0, 2.0) for o in (None, order)
            )
            assert np.array_equal(exact[0], expanded[0])
            errors[order, size] = np.max(np.abs(exact - expanded))
    assert errors[0, 1e-2] / errors[0, 1e-3] == pytest.approx(10.0, rel=0.1)
    assert errors[1, 1e-2] / errors[1, 1e-3] == pytest.approx(100.0, rel=0.1)


def ghost_forces(here: Setting, q, velocity, speed: float, amplitude: float) -> np.ndarray:
    """Return the forces on ghosts (2, 2, n_ghosts) that the points have."""
    points, nu = here.points, FLUID.kinematic_viscosity
    pressure = points.ghost_pressures(q[:, None], velocity[..., None])[..., 0]
    if points.body_force is not None:
        head = (1.0 + q / FLUID.sound_speed) * points.body_force
        pressure = pressure + amplitude * points.ghost_heads(head)
    friction = points.ghost_friction(velocity[..., None])[..., 0] + speed * points.ghost_drag
    return np.stack((pressure, nu * friction))


@pytest.mark.parametrize("name", ["box", "lid", "cavity", "forced cavity"])
@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_forces_on_ghosts_are_the_functional_s(setting, name: str, damping: float) -> None:
    """All are linear in the state, but for volumes: at small densities those are dx^2."""
    here = setting(name, acoustic_damping=damping)
    small, velocity = 1e-7, np.stack((here.u, here.v))
    state = np.vstack((here.position.T, small * here.q / SCALE, small * velocity))
    speed, amplitude = 1.7 * small, 0.9 * small
    force = None if here.force is None else lambda x, time: amplitude * push(x)
    walls = here.walls(speed)
    functional = Functional(FLUID, here.discretization, here.domain, walls, force)
    wanted = functional.ghost_forces(state)
    found = ghost_forces(here, small * here.q, small * velocity, speed, amplitude)
    close(found, wanted, 1e-5)
    assert np.abs(wanted).max(axis=(1, 2)).min() > 0.0
