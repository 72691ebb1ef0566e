"""The full model in three dimensions, against sums over all pairs and exact balances."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sphrom.arrays import Array
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight
from sphrom.scenes.flows import TaylorGreen3D
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.packing import pack
from sphrom.sph.space_box import SpaceBox
from sphrom.sph.space_functional import SpaceFunctional

N = 8
SPACING = 1.0 / N
FLUID = Fluid(reference_density=2.0, sound_speed=5.0, kinematic_viscosity=0.1, max_speed=1.0)
SIZES = Discretization(SPACING, smoothing_length=2.0 * SPACING, acoustic_damping=0.5)


def box(*periodic: bool) -> SpaceBox:
    return SpaceBox((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), periodic)


def random_state(domain: SpaceBox, shake: float = 0.2) -> Array:
    random = np.random.default_rng(3)
    position = domain.fill(SPACING)
    position += shake * SPACING * random.uniform(-1.0, 1.0, position.shape)
    others = random.uniform(-0.1, 0.1, (4, len(position)))
    return np.vstack((position.T, others))


def lid(position: Array) -> Array:
    velocity = np.zeros_like(position)
    velocity[position[:, 1] > 1.0, 0] = 0.3
    return velocity


def steady_force(position: Array, time: float) -> Array:
    return np.stack((np.sin(position[1]), -0.5 - position[0], np.ones_like(position[0])))


def all_images(domain: SpaceBox, state: Array) -> tuple[Array, Array, Array, Array]:
    """Return particle, place, factors of velocity and wall velocity of every image in 27 boxes."""
    particle, place, flip = [], [], []
    for copy in itertools.product((-1, 0, 1), repeat=3):
        at = state[:3].copy()
        sign = np.ones((3, 1))
        for axis, c in enumerate(copy):
            if c and not domain.periodic[axis]:
                at[axis] = 1.0 - at[axis]
                sign[axis] = -1.0
            at[axis] += c
        particle.append(np.arange(state.shape[1]))
        place.append(at)
        flip.append(np.broadcast_to(sign, at.shape))
    joined = np.concatenate(place, axis=1)
    return np.concatenate(particle), joined, np.concatenate(flip, axis=1), lid(joined.T).T


def brute_force(functional: SpaceFunctional, state: Array) -> Array:
    """Return the rates by sums over all pairs of particles and images."""
    domain = functional.domain
    assert isinstance(domain, SpaceBox)
    density, velocity = state[3], state[4:]
    j, place, flip, wall = all_images(domain, state)
    ghost = (flip < 0.0).any(axis=0)
    force = steady_force(state[:3], 0.0)
    steep = FLUID.reference_density / FLUID.sound_speed**2 * force[:, j]
    heads = np.sum((flip < 0.0) * (place - state[:3][:, j]) * steep, axis=0)
    offset = state[:3][:, :, None] - place[:, None, :]
    square = np.sum(offset**2, axis=0)
    inverse = 1.0 / SIZES.smoothing_length
    weigh = np.vectorize(lambda r: gradient_factor(r, inverse, 3))
    near = square < SIZES.support_radius**2
    factor = np.zeros(square.shape)
    factor[near] = weigh(np.sqrt(square[near]))
    full = FLUID.reference_density + density
    factor *= (functional.mass / full)[j]
    slope = factor * offset
    shape = np.vectorize(lambda s: laplacian_weight(s, inverse, 3))(square)
    jump = (density[j] + heads)[None] - density[:, None]
    first = flip * velocity[:, j]
    divergence = np.sum((first[:, None, :] - velocity[:, :, None]) * slope, axis=(0, 2))
    matrix = np.einsum("aij,bij->iab", offset, slope)
    gradient = -np.linalg.solve(matrix, np.einsum("ij,aij->ia", jump, slope)[..., None])[..., 0].T
    c = -3.0 / np.sum(square * shape * factor, axis=1)
    damping = SIZES.acoustic_damping * SIZES.smoothing_length / FLUID.sound_speed
    pressure = density - damping * FLUID.reference_density * divergence
    kernels = np.zeros(square.shape)
    kernels[near] = np.vectorize(lambda r: kernel(r, inverse, 3))(np.sqrt(square[near]))
    closeness = kernels / kernel(SPACING, inverse, 3)
    push = np.sum((1.0 + SIZES.shifting_amplitude * closeness**4) * slope, axis=2)
    magnitude = 2.0 * SIZES.smoothing_length * FLUID.max_speed
    shift = -magnitude * push
    shift *= np.minimum(1.0, 0.5 * FLUID.max_speed / np.linalg.norm(shift, axis=0))
    far = np.where(ghost, flip * (gradient[:, j] - steep) + steep, gradient[:, j])
    sums = np.einsum("aij,aij->ij", far[:, None, :] + gradient[:, :, None], offset)
    carried = np.einsum("ai,aij->ij", shift, offset)
    diffusion = 2.0 * SIZES.diffusion_coefficient * SIZES.smoothing_length * FLUID.sound_speed
    rate = np.sum((jump * carried - diffusion * (jump + 0.5 * sums)) * factor, axis=1)
    rate -= full * divergence
    compressibility = functional.mass / full**2
    if SIZES.fixed_volume:
        rate -= np.sum(compressibility * rate) / np.sum(compressibility)
    odd = np.prod(flip, axis=0)
    second = (1.0 - odd) * wall + odd * velocity[:, j]
    relative = second[:, None, :] - velocity[:, :, None]
    total = pressure[:, None] + np.where(ghost, pressure[j] + heads, pressure[j])[None]
    drag = FLUID.kinematic_viscosity * FLUID.reference_density * (c[:, None] + c[j][None]) * shape
    carry = FLUID.reference_density * carried - drag
    gain = np.sum(carry * relative * factor - FLUID.sound_speed**2 * total * slope, axis=2)
    return np.vstack((velocity + shift, rate, gain / full + force))


@pytest.mark.parametrize("periodic", [(True, True, True), (True, False, False)])
def test_rates_are_those_of_sums_over_all_pairs(periodic: tuple[bool, ...]) -> None:
    domain = box(*periodic)
    state = random_state(domain)
    functional = SpaceFunctional(FLUID, SIZES, domain, body_force=steady_force, wall_velocity=lid)
    found = functional(state)
    expected = brute_force(functional, state)
    size = np.abs(expected).max(axis=1)
    assert np.abs(found - expected).max(axis=1) == pytest.approx(0.0, abs=1e-10 * size.max())


def test_momentum_is_conserved_in_a_periodic_box() -> None:
    domain = box(True, True, True)
    state = random_state(domain)
    sizes = Discretization(SPACING, smoothing_length=2.0 * SPACING, shifting=False)
    acceleration = SpaceFunctional(FLUID, sizes, domain)(state)[4:]
    assert np.abs(acceleration.mean(axis=1)).max() < 1e-13 * np.abs(acceleration).max()


def test_water_at_rest_stays_at_rest_and_its_weight_is_on_the_walls() -> None:
    domain = box(False, False, False)
    gravity = 0.1

    def pull(position: Array, time: float) -> Array:
        force = np.zeros_like(position)
        force[1] = -gravity
        return force

    functional = SpaceFunctional(FLUID, SIZES, domain, body_force=pull)
    position = domain.fill(SPACING).T
    density = FLUID.reference_density * gravity * (0.5 - position[1]) / FLUID.sound_speed**2
    state = np.vstack((position, density, np.zeros_like(position)))
    # On a lattice the sums find a linear pressure's gradient to 1 %, beside walls too.
    assert np.abs(functional(state)[4:]).max() < 0.01 * gravity
    names = domain.wall_names
    loads = functional.wall_loads(names, state, 0.0)
    total = sum(loads[name].sum(axis=0) for name in names)
    assert total == pytest.approx([0.0, -FLUID.reference_density * gravity, 0.0], abs=0.002)
    assert loads["left"][0, 0] == pytest.approx(-loads["right"][0, 0], rel=1e-9)


def test_forces_on_all_walls_are_those_that_the_fluid_lacks() -> None:
    domain = box(False, True, False)
    sizes = Discretization(SPACING, smoothing_length=2.0 * SPACING, shifting=False)
    state = random_state(domain)
    functional = SpaceFunctional(FLUID, sizes, domain, wall_velocity=lid)
    acceleration = functional(state)[4:]
    loads = functional.wall_loads(domain.wall_names, state, 0.0)
    total = sum(loads[name].sum(axis=0) for name in domain.wall_names)
    assert total == pytest.approx(-functional.mass * acceleration.sum(axis=1), rel=1e-9)


def test_the_vortex_loses_energy_by_its_viscosity() -> None:
    length = 2.0 * math.pi
    n = 16
    sizes = Discretization(length / n, smoothing_length=2.0 * length / n)
    flow = TaylorGreen3D(length, speed=1.0, reference_density=FLUID.reference_density)
    functional = SpaceFunctional(FLUID, sizes, flow.domain)
    position = flow.domain.fill(length / n)
    velocity = flow.initial_velocity(position).T
    density = flow.initial_pressure(position) / FLUID.sound_speed**2
    rates = functional(np.vstack((position.T, density, velocity)))
    power = np.sum(velocity * rates[4:]) / len(position)
    energy = 0.5 * np.mean(np.sum(velocity**2, axis=0))
    # All its waves have the wave vector (1, 1, 1).
    assert power == pytest.approx(-6.0 * FLUID.kinematic_viscosity * energy, rel=0.02)


def test_particles_near_walls_cannot_pass_them() -> None:
    domain = box(False, True, True)
    functional = SpaceFunctional(FLUID, SIZES, domain)
    state = np.vstack((domain.fill(SPACING).T, np.zeros((4, N**3))))
    first = state[0] < SPACING
    state[0, first] = 0.1 * SPACING
    state[4, first] = -FLUID.max_speed
    rates = functional(state)
    assert rates[0, first] == pytest.approx(-0.1 * FLUID.max_speed, rel=1e-9)
    state[4, first] = 0.0
    assert (functional(state)[0, first] >= -0.1 * FLUID.max_speed).all()


def test_packing_spreads_particles_evenly() -> None:
    found = pack(box(True, True, True), SIZES)
    assert found.residual[-1] < 1e-3 < 0.02 < found.residual[0]
    assert found.position.shape == (N**3, 3)


def test_walls_make_friction_no_stiffer() -> None:
    random = np.random.default_rng(1)
    largest = []
    for domain in (box(True, True, True), box(False, False, False)):
        sizes = Discretization(SPACING, 2.0 * SPACING, diffusion_coefficient=0.0, shifting=False)
        functional = SpaceFunctional(Fluid(1.0, 1e-9, 1.0, 1.0), sizes, domain)
        position = domain.fill(SPACING).T
        velocity = random.normal(size=position.shape)
        for _ in range(60):
            velocity /= np.linalg.norm(velocity)
            state = np.vstack((position, np.zeros(position.shape[1]), velocity))
            velocity = functional(state)[4:]
        largest.append(float(np.linalg.norm(velocity)))
    assert largest[1] < 1.02 * largest[0]
    # The limit of the step: 2.78 over it, at least 0.125 h^2 / nu.
    assert max(largest) * sizes.smoothing_length**2 < 2.78 / 0.125
