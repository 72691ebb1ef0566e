"""Maps, splines, modes and projected operators in three dimensions, on exact fields."""

import numpy as np
import pytest

from sphrom.reduction.decomposition import decompose
from sphrom.reduction.lattice_splines import LatticeSplines, fit_lattice_splines
from sphrom.reduction.mode_splines import basis_columns
from sphrom.reduction.operator_projection import project_operators, residual_factor
from sphrom.reduction.reduced_operators import residual_norm
from sphrom.reduction.reference_space import ReferenceMap, TooFewParticlesError
from sphrom.reduction.trial_basis import InnerProduct, ModeVelocities, TrialBasis, reconstruct
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.lattice_points import LatticePoints
from sphrom.sph.space_box import SpaceBox

EDGE = 2.0 * np.pi
FLUID = Fluid(reference_density=1000.0, sound_speed=10.0, kinematic_viscosity=0.01, max_speed=1.0)
CLOSED = SpaceBox((0.0, 0.0, 0.0), (1.0, 0.8, 0.6), (False, True, False))
PERIODIC = SpaceBox((0.0, 0.0, 0.0), (EDGE, EDGE, EDGE), (True, True, True))


def test_splines_reproduce_cubic_polynomials_up_to_walls() -> None:
    def field(place: np.ndarray) -> np.ndarray:
        x, _, z = place.T
        return np.stack((x**3 - x**2 * z**3, 1.0 + x * z), axis=1)

    points = CLOSED.fill(0.1)
    order = np.random.default_rng(0).permutation(len(points))
    splines = fit_lattice_splines(points[order], field(points[order]), CLOSED)
    place = np.random.default_rng(1).uniform(size=(60, 3)) * CLOSED.upper
    values, gradients = splines.values_and_gradients(place)
    x, _, z = place.T
    slope_x = 3.0 * x**2 - 2.0 * x * z**3
    slope_z = -3.0 * x**2 * z**2
    slope = np.stack((slope_x, 0.0 * x, slope_z), axis=1)
    np.testing.assert_allclose(values, field(place), atol=1e-13)
    np.testing.assert_allclose(splines.values(place), values, atol=1e-13)
    np.testing.assert_allclose(gradients[:, 0], slope, atol=1e-11)
    again = LatticeSplines.of(splines, domain=CLOSED)
    np.testing.assert_array_equal(again.values(place), splines.values(place))


def test_the_map_reproduces_quadratic_fields() -> None:
    box = SpaceBox((0.0, 0.0, 0.0), (1.0, 0.8, 0.6), (False, False, False))
    points = box.fill(0.1)
    noise = np.random.default_rng(0).uniform(-0.03, 0.03, points.shape)
    particles = points + noise

    def fields(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = place.T
        return 1.0 + x - z, np.stack((x**2, x * y - 1.0, z**2 + y * z), axis=1)

    to_points = ReferenceMap(points, box, particle_spacing=0.1, smoothing_length=0.2)
    for found, exact in zip(to_points(particles, *fields(particles)), fields(points), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-12)
    few = particles[particles[:, 2] < 0.1]
    with pytest.raises(TooFewParticlesError, match=r"\(.*, .*, .*\)"):
        to_points(few, *fields(few))


def vortex(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pressure [Pa] and velocity [m/s] of the Taylor-Green vortex (Brachet et al. 1983)."""
    x, y, z = place.T
    pressure = FLUID.reference_density / 16.0 * (np.cos(2 * x) + np.cos(2 * y))
    u = np.sin(x) * np.cos(y) * np.cos(z)
    v = -np.cos(x) * np.sin(y) * np.cos(z)
    return pressure * (np.cos(2 * z) + 2.0), np.stack((u, v, 0.0 * u), axis=1)


def basis_of_vortices(points: LatticePoints) -> TrialBasis:
    """Return three modes of states with the vortex's velocity, its pressure and a wave."""
    pressure, velocity = vortex(points.position)
    density = pressure / FLUID.sound_speed**2
    z = points.position[:, 2]
    sound = np.stack((0.0 * z, 0.3 * np.sin(z), np.cos(z)), axis=1)
    densities = np.stack((density, 10.0 * np.sin(z), 5.0 * density))
    velocities = np.stack((velocity, 0.0 * velocity, sound))
    return decompose(
        lambda rows: (densities[:, rows], velocities[:, rows]),
        points.n_points,
        3,
        InnerProduct.acoustic(FLUID.reference_density, FLUID.sound_speed),
        np.full(points.n_points, (EDGE / 8) ** 3),
        {"all": 3},
        {"all": np.arange(3)},
        ram_limit=2**16,
    )["all"]


def test_projected_rates_are_those_at_the_points() -> None:
    spacing = EDGE / 8
    discretization = Discretization(spacing, 1.5 * spacing)
    points = LatticePoints(PERIODIC.fill(spacing), FLUID, discretization, PERIODIC)
    basis = basis_of_vortices(points)
    assert basis.gram_error < 1e-12
    splines = fit_lattice_splines(points.position, basis_columns(basis), PERIODIC)
    operators = project_operators(points, basis, splines)
    assert operators.skewness < 1e-13
    state = np.array([0.7, -0.4, 0.3])
    density, velocity = reconstruct(basis, state)
    q = (points.density_scale * density)[:, None]
    u = velocity.T[..., None]
    terms = points.terms(q, u)
    slopes = np.einsum(
        "m,nmfd->fdn",
        state,
        splines.values_and_gradients(points.position)[1].reshape(points.n_points, 3, 4, 3),
    )
    viscosity = FLUID.kinematic_viscosity
    excess = q[:, 0] / FLUID.sound_speed
    advection = np.einsum("dn,fdn->fn", velocity.T, slopes)
    continuity = (
        points.diffusion(q)[:, 0] - FLUID.sound_speed * (1.0 + excess) * (terms.divergence[:, 0])
    )
    force = viscosity * terms.laplacian - FLUID.sound_speed * terms.pressure_gradient
    momentum = (1.0 - excess) * force[..., 0]
    rates = np.concatenate(((continuity - advection[0])[None], momentum - advection[1:]))
    tests = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
    projected = np.einsum("mnf,fn,n->m", tests, rates, basis.weights)
    found = operators.at(viscosity)(state, 0.0)
    np.testing.assert_allclose(found, projected, rtol=1e-10, atol=1e-12 * np.abs(projected).max())
    # The residual is what the modes miss of the rates.
    factor = residual_factor(points, basis, operators, splines)
    size = np.sqrt(np.sum(rates**2 * basis.weights) - np.sum(projected**2))
    assert residual_norm(factor, viscosity, state[None])[0] == pytest.approx(size, rel=1e-4)


def test_speeds_and_energies_of_modes_have_three_components() -> None:
    spacing = EDGE / 8
    points = LatticePoints(
        PERIODIC.fill(spacing), FLUID, Discretization(spacing, 1.5 * spacing), PERIODIC
    )
    basis = basis_of_vortices(points)
    state = np.array([[0.7, -0.4, 0.3]])
    _, velocity = reconstruct(basis, state)
    of_modes = ModeVelocities(basis)
    fastest = np.linalg.norm(velocity, axis=-1).max()
    assert of_modes.largest_speed(state) == pytest.approx(fastest)
    energy = 0.5 * np.sum(velocity**2)
    assert of_modes.kinetic_energy(state, 1.0)[0] == pytest.approx(energy)
