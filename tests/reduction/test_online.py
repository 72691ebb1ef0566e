"""The reduced model on moving particles, against dense algebra on a tiny case."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.reduction.particle_model import ParticleModel, reduced_jacobian
from sphrom.reduction.spline import LocalSplines, fit_splines
from sphrom.reduction.trial_basis import InnerProduct
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

N_MODES = 3
SPACING = 0.1
BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
FLUID = Fluid(1000.0, 10.0, 0.01, 1.0)
DISCRETIZATION = Discretization(
    SPACING, 1.5 * SPACING, shifting_amplitude=0.2, shifting_transport="paper"
)
ACOUSTIC = InnerProduct.acoustic(FLUID.reference_density, FLUID.sound_speed)
RAW = InnerProduct.raw(FLUID.reference_density)
COORDINATES = np.array([1.0, -0.4, 0.3])
MEAN = -7.5
"""A mean density fluctuation [kg/m3]."""


@pytest.fixture(scope="module")
def points(scatter: Callable) -> np.ndarray:
    return scatter((0.0, 0.0), SPACING, (10, 10), "jittered", seed=1)[:2].T


def smooth_modes(points: np.ndarray) -> np.ndarray:
    """Return periodic modes (n_points, 3, N_MODES): the first field, and the velocity."""
    x, y = 2.0 * np.pi * points.T
    return np.stack(
        (
            np.stack((0.02 * np.cos(2 * x), np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)), 1),
            np.stack((0.03 * np.sin(x + y), 0.5 * np.cos(y), 0.3 * np.sin(2 * x)), 1),
            np.stack((0.01 * np.cos(y), np.sin(2 * y), 0.4 * np.cos(x)), 1),
        ),
        axis=2,
    )


def fit(points: np.ndarray, modes: np.ndarray) -> LocalSplines:
    columns = modes.transpose(0, 2, 1).reshape(len(points), -1)
    return fit_splines(points, columns, BOX, cell_width=3.0 * SPACING)


@pytest.fixture(scope="module")
def splines(points: np.ndarray) -> LocalSplines:
    return fit(points, smooth_modes(points))


def build(splines: LocalSplines, **options) -> ParticleModel:
    functional = Functional(FLUID, DISCRETIZATION, BOX)
    return ParticleModel(functional, splines, ACOUSTIC, **options)


def reference_functional(model: ParticleModel, position, fields, gradient) -> np.ndarray:
    """Return f-bar (3, N) of fields (3, N) in the state's scaling, `gradient` (N, 3, 2)."""
    scale = np.array([[model.product.density_scale], [1.0], [1.0]])
    density, velocity = fields[0] / scale[0], fields[1:]
    full = model.functional.evaluate(position, density, velocity)
    rates = np.vstack((full.density, full.velocity))
    if model.advection == "paper":
        return scale * (rates - model.functional.advection(position, density, velocity))
    carrier = velocity + full.shifting_velocity
    return scale * rates - np.einsum("nfd,dn->fn", gradient, carrier)


def basis_rows(model: ParticleModel, position) -> np.ndarray:
    """Return Phi (3 N, n_coordinates) at particles; a particle's fields stand together."""
    values = model.modes.values(position.T)[:, : 3 * model.n_modes]
    rows = values.reshape(-1, model.n_modes, 3).transpose(0, 2, 1).reshape(-1, model.n_modes)
    if model.separate_mean:
        rows = np.column_stack((rows, np.tile([1.0, 0.0, 0.0], position.shape[1])))
    return rows


def parts(model: ParticleModel, state: np.ndarray):
    """Return position, fields (3, N) scaled, their gradient, and the inverse of the basis."""
    position, fields = model.position(state), model.fields(state)
    scaled = np.vstack((model.product.density_scale * fields.density_fluctuation, fields.velocity))
    weights = model.product.weights(model.functional.volume(fields.density_fluctuation))
    root = np.repeat(np.sqrt(weights), 3)
    inverse = np.linalg.pinv(root[:, None] * basis_rows(model, position)) * root
    return position, scaled, fields.gradient, inverse


@pytest.mark.parametrize("advection", ["paper", "consistent"])
@pytest.mark.parametrize("separate_mean", [False, True])
def test_rates_are_the_projected_reference_functional(
    splines: LocalSplines, points: np.ndarray, advection: str, separate_mean: bool
) -> None:
    """A mean density is projected as one column more, which is not orthogonal to the others."""
    model = build(splines, advection=advection, separate_mean=separate_mean)
    state = model.initial_state(COORDINATES, points, MEAN)
    position, fields, gradient, inverse = parts(model, state)
    expected = inverse @ reference_functional(model, position, fields, gradient).T.ravel()
    out, scale = model.rates(state), np.max(np.abs(expected))
    assert np.max(np.abs(out[: model.n_coordinates] - expected)) < 1e-10 * scale
    assert not separate_mean or abs(expected[-1]) > 1e-3 * scale
    density = fields[0] / ACOUSTIC.density_scale
    shifting = model.functional.evaluate(position, density, fields[1:]).shifting_velocity
    assert np.allclose(model.position(out), fields[1:] + shifting, rtol=1e-12)


def test_fields_are_those_of_the_basis_and_move_with_the_particles(
    splines: LocalSplines, points: np.ndarray
) -> None:
    model = build(splines)
    fields = model.fields(model.initial_state(COORDINATES, points))
    expected = (smooth_modes(points) @ COORDINATES).T
    assert np.allclose(fields.density_fluctuation, 100.0 * expected[0], atol=1e-9)
    assert np.allclose(fields.velocity, expected[1:], atol=1e-11)
    slopes = splines.values_and_gradients(points)[1].reshape(len(points), N_MODES, 3, 2)
    assert np.allclose(fields.gradient, np.einsum("nmfd,m->nfd", slopes, COORDINATES), atol=1e-10)
    moved = points + np.array([0.02, -1.01])
    there = model.fields(model.initial_state(COORDINATES, moved))
    assert np.allclose(there.velocity, (smooth_modes(moved) @ COORDINATES).T[1:], atol=0.06)
    assert not np.allclose(there.velocity, fields.velocity, atol=0.06)


@pytest.mark.parametrize(
    ("advection", "separate_mean"), [("paper", False), ("consistent", False), ("consistent", True)]
)
def test_closure_is_the_dense_jacobians_action(
    splines: LocalSplines, points: np.ndarray, advection: str, separate_mean: bool
) -> None:
    """Eq. 3.22 against a Jacobian built column by column, particles held where they are."""
    memory = 1e-2
    options = {"advection": advection, "separate_mean": separate_mean}
    galerkin = build(splines, **options)
    closed = build(splines, memory_length=memory, **options)
    state = galerkin.initial_state(COORDINATES, points, MEAN)
    position, fields, gradient, inverse = parts(galerkin, state)
    rates = reference_functional(galerkin, position, fields, gradient).T.ravel()
    residual = rates - basis_rows(galerkin, position) @ (inverse @ rates)
    state_fields = fields[0] / ACOUSTIC.density_scale, fields[1:]
    jacobian = np.empty((residual.size, residual.size))
    for column in range(residual.size):
        unit = np.zeros_like(fields)
        particle, field = divmod(column, 3)
        unit[field, particle] = 1.0
        slope = galerkin.functional.evaluate(position, *state_fields, along=unit).slopes
        ends = [
            reference_functional(
                galerkin, position, fields + sign * 1e-5 * unit, gradient + sign * 1e-5 * slope
            )
            for sign in (1.0, -1.0)
        ]
        jacobian[:, column] = ((ends[0] - ends[1]) / 2e-5).T.ravel()
    expected = inverse @ (jacobian @ residual)
    actual = (closed.rates(state) - galerkin.rates(state))[: galerkin.n_coordinates] / memory
    assert np.max(np.abs(actual - expected)) < 1e-5 * np.max(np.abs(expected))
    assert np.max(np.abs(memory * expected)) > 1e-2 * np.max(np.abs(inverse @ rates))


def test_raw_and_acoustic_states_have_the_same_fields(
    splines: LocalSplines, points: np.ndarray
) -> None:
    """In the raw product the first field is the whole density, here in a mode of its own."""
    modes = smooth_modes(points)
    raw_modes = np.concatenate((modes, np.zeros_like(modes[..., :1])), axis=2)
    raw_modes[:, 0, :N_MODES] /= ACOUSTIC.density_scale
    raw_modes[:, 0, N_MODES] = FLUID.reference_density
    functional = Functional(FLUID, DISCRETIZATION, BOX)
    raw = ParticleModel(functional, fit(points, raw_modes), RAW)
    acoustic = build(splines)
    first = raw.fields(raw.initial_state(np.append(COORDINATES, 1.0), points))
    second = acoustic.fields(acoustic.initial_state(COORDINATES, points))
    assert np.allclose(first.velocity, second.velocity, atol=1e-10)
    assert np.allclose(first.density_fluctuation, second.density_fluctuation, atol=1e-8)


def test_reduced_jacobian(splines: LocalSplines, points: np.ndarray) -> None:
    """Against central differences with another step."""
    model = build(splines)
    state = model.initial_state(COORDINATES, points)
    jacobian = np.empty((N_MODES, N_MODES))
    for m in range(N_MODES):
        ends = []
        for sign in (1.0, -1.0):
            moved = state.copy()
            moved[m] += sign * 1e-5
            ends.append(model.rates(moved)[:N_MODES])
        jacobian[:, m] = (ends[0] - ends[1]) / 2e-5
    scale = np.max(np.abs(jacobian))
    assert np.allclose(reduced_jacobian(model, state), jacobian, atol=1e-3 * scale)


def test_the_gauge_is_a_coordinate_of_its_own(splines: LocalSplines, points: np.ndarray) -> None:
    """The mean stands behind the modes, in the state's scaling, and adds to the density alone."""
    plain, gauged = build(splines), build(splines, separate_mean=True)
    state = gauged.initial_state(COORDINATES, points, MEAN)
    assert (plain.n_coordinates, gauged.n_coordinates) == (N_MODES, N_MODES + 1)
    assert state[N_MODES] == pytest.approx(ACOUSTIC.density_scale * MEAN)
    assert np.array_equal(gauged.coordinates(state), COORDINATES)
    assert np.array_equal(gauged.position(state), points.T)
    assert gauged.mean_density_fluctuation(state) == pytest.approx(MEAN)
    fields = gauged.fields(state)
    same = plain.fields(plain.initial_state(COORDINATES, points))
    assert np.array_equal(fields.velocity, same.velocity)
    assert np.array_equal(fields.gradient, same.gradient)
    assert np.allclose(fields.density_fluctuation, same.density_fluctuation + MEAN, atol=1e-12)


def test_every_evaluation_is_at_the_time_of_the_call(
    splines: LocalSplines, points: np.ndarray
) -> None:
    """The closure's and the Jacobian's too."""
    times = []

    def force(position: np.ndarray, time: float) -> np.ndarray:
        times.append(time)
        return np.zeros_like(position)

    functional = Functional(FLUID, DISCRETIZATION, BOX, body_force=force)
    model = ParticleModel(functional, splines, ACOUSTIC, memory_length=1e-3)
    state = model.initial_state(COORDINATES, points)
    model.rates(state, 2.5)
    assert times == [2.5, 2.5]
    reduced_jacobian(model, state, 4.5)
    assert set(times[2:]) == {4.5}
    assert len(times[2:]) == 2 * (N_MODES + 1)
