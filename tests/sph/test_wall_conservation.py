"""What walls give and take: energy, volume and mass; symmetries; and that far from them is far."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.scenes.flows import LidDrivenCavity
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import runge_kutta_step
from sphrom.sph.walls.kinds import KINDS

SPACING = 0.0625
FLUID = Fluid(800.0, 7.0, 0.013, 0.9)
IDEAL = Fluid(800.0, 7.0, 0.0, 0.9)
BARE = {"shifting": False, "diffusion_coefficient": 0.0}
EVERYTHING = {"acoustic_damping": 1.0, "fixed_volume": True}


def powers(functional: Functional, state: np.ndarray) -> tuple[float, float, float]:
    """Return the power [W/m] of pressure, what compression takes, and the size of either."""
    out = functional(state)
    density = functional.fluid.reference_density + state[2]
    kinetic = functional.mass * state[3:] * out[3:]
    pressure = functional.fluid.sound_speed**2 * state[2]
    internal = pressure * functional.volume(state[2]) * out[2] / density
    return float(kinetic.sum()), float(internal.sum()), float(np.abs(internal).sum())


@pytest.mark.parametrize("name", ["box", "lid", "cavity", "shapes"])
@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
def test_walls_neither_make_nor_take_sound(scenes: dict, name: str, ratio: float) -> None:
    """The power of the pressure's forces is what continuity stores, whatever the lid does.

    For any state: with V = m / rho both sums are the same, term by term, and not for small
    fluctuations alone, which are a tenth of the density here.
    """
    functional = scenes[name].functional(ratio, fluid=IDEAL, **BARE)
    state = scenes[name].state(seed=1)
    state[2] *= 80.0
    kinetic, internal, size = powers(functional, state)
    assert abs(kinetic + internal) < 1e-12 * size


@pytest.mark.parametrize("name", ["box", "lid", "cavity", "shapes"])
@pytest.mark.parametrize("ratio", [1.5, 4.0])
def test_the_damper_takes_the_square_of_the_divergence(
    scenes: dict, name: str, ratio: float
) -> None:
    """-alpha rho0 c0 h sum V (D u)^2, for any state; without diffusion continuity is -rho D u."""
    bare, damped = (
        scenes[name].functional(ratio, fluid=IDEAL, acoustic_damping=alpha, **BARE)
        for alpha in (0.0, 0.7)
    )
    state = scenes[name].state(seed=1)
    state[2] *= 80.0
    out, with_damper = bare(state), damped(state)
    assert np.array_equal(out[:3], with_damper[:3])
    power = np.sum(damped.mass * state[3:] * (with_damper - out)[3:])
    divergence = out[2] / (IDEAL.reference_density + state[2])
    lost = np.sum(damped.volume(state[2]) * divergence**2)
    lost *= 0.7 * IDEAL.reference_density * IDEAL.sound_speed * ratio * SPACING
    assert power == pytest.approx(-lost, rel=1e-11)


@pytest.mark.parametrize("lid", ["regularised", "uniform"])
@pytest.mark.parametrize(
    ("kind", "is_a_sink"), [("adjoint", False), ("normal", False), ("adami-as-fluid", True)]
)
def test_a_lid_that_starts_moves_no_mass(lid: str, kind: str, is_a_sink: bool) -> None:
    """As printed, ghosts count as fluid: density falls where the lid's speed grows along it."""
    scene = LidDrivenCavity(1.0, 1.0, lid)  # type: ignore[arg-type]
    discretization = Discretization(SPACING, 2.0 * SPACING, wall_kind=kind)
    walls = scene.domain.ghosts(SPACING, discretization.n_layers).moving(scene.wall_velocity)
    functional = Functional(Fluid(1.0, 10.0, 0.01, 1.0), discretization, scene.domain, walls)
    position = scene.domain.fill(SPACING)
    state = np.zeros((5, len(position)))
    state[:2] = position.T
    out = functional(state)
    assert np.max(np.abs(out[3])) > 0.1
    if is_a_sink:
        upstream = np.argmin(np.hypot(*(position - np.array([0.0, 1.0])).T))
        assert out[2].min() < -3.0
        assert out[2, upstream] < -1.0
    else:
        assert np.max(np.abs(out[2])) < 1e-12


@pytest.mark.parametrize("name", ["lid", "forced box", "forced cavity"])
@pytest.mark.parametrize("kind", KINDS)
def test_volumes_keep_filling_the_domain(scenes: dict, name: str, kind: str) -> None:
    options = {"wall_kind": kind, "acoustic_damping": 1.0}
    state = scenes[name].state(seed=2)
    changes = {}
    for fixed in (True, False):
        functional = scenes[name].functional(fixed_volume=fixed, **options)
        density = FLUID.reference_density + state[2]
        change = -functional.mass / density**2 * functional(state, 0.3)[2]
        changes[fixed] = abs(change.sum()) / np.abs(change).sum()
    assert changes[True] < 1e-14
    assert changes[False] > 1e-4


ADJOINT = {"wall_kind": "adjoint"}


@pytest.mark.parametrize(
    ("name", "options", "supports"),
    [
        ("lid", {**BARE, "viscosity": "pair"}, 2),
        ("lid", {**ADJOINT, **BARE, "viscosity": "pair"}, 1),
        ("forced cavity", {**ADJOINT, **BARE, "viscosity": "pair"}, 1),
        ("lid", {**ADJOINT, **BARE}, 2),
        ("lid", {**ADJOINT, "acoustic_damping": 1.0}, 2),
    ],
    ids=["mirrored", "lid", "cavity", "normalised", "everything"],
)
def test_far_from_walls_they_are_not_felt(
    scenes: dict, name: str, options: dict, supports: int
) -> None:
    """Bitwise; damping, shifting, fits and neighbours' factors may be those at walls."""
    scene = scenes[name]
    walled = scene.functional(1.5, **options)
    bare = Functional(FLUID, walled.discretization, scene.domain, body_force=scene.body_force)
    state = scene.state(seed=5)
    first, second = walled(state, 0.2), bare(state, 0.2)
    distance = scene.domain.wall_distance(state[:2].T)
    far = distance > supports * walled.discretization.support_radius
    assert np.count_nonzero(far) >= 4
    assert np.array_equal(first[:, far], second[:, far])
    beside = distance < 0.5 * walled.discretization.support_radius
    assert np.all(np.any(first[:, beside] != second[:, beside], axis=0))


@pytest.mark.parametrize("transport", ["advective", "paper"])
@pytest.mark.parametrize("name", ["periodic", "lid", "forced cavity"])
def test_is_bitwise_the_same_on_any_number_of_threads(
    scenes: dict, same_on_threads, name: str, transport: str
) -> None:
    functional = scenes[name].functional(**EVERYTHING, shifting_transport=transport)
    state = scenes[name].state(seed=6)
    same_on_threads(
        lambda: (functional(state, 0.4), functional.advection(state[:2], state[2], state[3:]))
    )


def test_a_uniform_force_moves_a_periodic_box_as_a_whole() -> None:
    """b = (1 + 2 t, -3 t^2): Runge-Kutta gets the polynomials right that follow from it."""
    box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))

    def force(position: np.ndarray, time: float) -> np.ndarray:
        return np.outer([1.0 + 2.0 * time, -3.0 * time**2], np.ones(position.shape[1]))

    functional = Functional(
        FLUID, Discretization(SPACING, 2.0 * SPACING, **EVERYTHING), box, body_force=force
    )
    position = box.fill(SPACING).T
    state = np.zeros((5, position.shape[1]))
    state[:2] = position
    step = 0.01
    for n in range(10):
        state = runge_kutta_step(functional, state, n * step, step)
    time = 0.1
    exact = np.array([time + time**2, -(time**3)])
    path = np.array([time**2 / 2.0 + time**3 / 3.0, -(time**4) / 4.0])
    assert np.max(np.abs(state[3:] - exact[:, None])) < 1e-11
    assert np.max(np.abs(state[:2] - position - path[:, None])) < 1e-11
    assert np.max(np.abs(state[2])) < 1e-8


def hydrostatic(n: int, gravity: float, **options) -> tuple[Functional, np.ndarray]:
    """Return fluid at rest in a unit box under gravity, and its functional."""
    box, spacing = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False)), 1.0 / n
    discretization = Discretization(spacing, 2.0 * spacing, **options)
    fluid = Fluid(1000.0, 20.0, 0.01, 1.0)

    def force(position: np.ndarray, _: float) -> np.ndarray:
        return np.outer([0.0, -gravity], np.ones(position.shape[1]))

    walls = box.ghosts(spacing, discretization.n_layers)
    position = box.fill(spacing)
    state = np.zeros((5, len(position)))
    state[:2] = position.T
    state[2] = 1000.0 * gravity * (0.5 - position[:, 1]) / fluid.sound_speed**2
    return Functional(fluid, discretization, box, walls, force), state


@pytest.mark.parametrize("kind", ["mirrored", "adjoint", "normal"])
def test_fluid_at_rest_stays_so_under_gravity(kind: str) -> None:
    """Measured over 0.5 s, in which free fall gives 0.5 m/s: speeds of 2.3e-4 m/s at most."""
    gravity = 1.0
    functional, state = hydrostatic(16, gravity, wall_kind=kind, **EVERYTHING)
    step = 0.5 * functional.discretization.smoothing_length / functional.fluid.sound_speed
    speeds = []
    for n in range(round(0.5 / step)):
        state = runge_kutta_step(functional, state, n * step, step)
        speeds.append(float(np.hypot(*state[3:]).max()))
    assert max(speeds) < 5e-4
    pressure = functional.fluid.sound_speed**2 * state[2]
    slope, _ = np.polyfit(state[1], pressure, 1)
    assert slope == pytest.approx(-1000.0 * gravity, rel=0.005)


def test_without_the_head_at_ghosts_gravity_pulls_fluid_through_the_floor() -> None:
    """Eq. 2.15's second term at work: what the floor carries at the start is the weight above."""
    functional, state = hydrostatic(16, 1.0, wall_kind="adjoint", **BARE)
    floor = state[1] < 1.0 / 16.0
    with_head = functional(state)[4, floor]
    force, functional.body_force = functional.body_force, None
    without_head = functional(state)[4, floor] + force(state[:2], 0.0)[1, floor]
    assert np.max(np.abs(with_head)) < 0.02
    assert np.all(without_head < -0.3)
