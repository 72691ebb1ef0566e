"""The vortex solves the Navier-Stokes equations, with the pressure's right sign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.metrics.series import exponential_rate, kinetic_energy
from sphrom.scenes.flows import TaylorGreen

FLOW = TaylorGreen(length=2.0, speed=1.5, reference_density=800.0, kinematic_viscosity=0.03)
STEP = 1e-3
"""Of fourth-order differences [m] and [s]: errors near 1e-10 of the terms."""


def difference(field, axis: int, position: np.ndarray, time: float) -> np.ndarray:
    """Return d/dx, d/dy or (axis 2) d/dt of a field, to fourth order."""
    weights = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
    total = 0.0
    for offset, weight in weights.items():
        shift = np.zeros(2)
        if axis < 2:
            shift[axis] = offset * STEP
        later = time + (offset * STEP if axis == 2 else 0.0)
        total = total + weight * field(position + shift, later)
    return np.asarray(total / STEP)


def laplacian(field, position: np.ndarray, time: float) -> np.ndarray:
    return sum(
        difference(lambda x, t, a=axis: difference(field, a, x, t), axis, position, time)
        for axis in range(2)
    )


def momentum_residual(flow: TaylorGreen, position: np.ndarray, time: float) -> np.ndarray:
    """Return du/dt + u . grad u + grad p / rho - nu lap u."""
    velocity = flow.velocity(position, time)
    carried = sum(
        velocity[:, axis : axis + 1] * difference(flow.velocity, axis, position, time)
        for axis in range(2)
    )
    push = np.stack([difference(flow.pressure, axis, position, time) for axis in range(2)], axis=1)
    return (
        difference(flow.velocity, 2, position, time)
        + carried
        + push / flow.reference_density
        - flow.kinematic_viscosity * laplacian(flow.velocity, position, time)
    )


@pytest.fixture
def position() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.0, 3.0, (50, 2))


@pytest.mark.parametrize("time", [0.0, 0.4])
def test_solves_the_momentum_equation(position: np.ndarray, time: float) -> None:
    size = FLOW.speed**2 * FLOW.wave_number
    assert np.max(np.abs(momentum_residual(FLOW, position, time))) < 1e-8 * size


def test_the_printed_sign_does_not(position: np.ndarray) -> None:
    """It leaves twice the pressure's gradient."""
    printed = replace(FLOW, pressure_sign=-1.0)
    residual = momentum_residual(printed, position, 0.0)
    push = [difference(printed.pressure, axis, position, 0.0) for axis in range(2)]
    expected = 2.0 * np.stack(push, axis=1) / FLOW.reference_density
    assert np.allclose(residual, expected, atol=1e-6)
    assert np.max(np.abs(residual)) > 0.5 * FLOW.speed**2 * FLOW.wave_number
    assert np.array_equal(printed.pressure(position, 0.2), -FLOW.pressure(position, 0.2))


def test_has_no_divergence(position: np.ndarray) -> None:
    parts = [difference(FLOW.velocity, axis, position, 0.3)[:, axis] for axis in range(2)]
    assert np.max(np.abs(sum(parts))) < 1e-8 * FLOW.speed * FLOW.wave_number


def test_equals_the_printed_fields_in_the_unit_box() -> None:
    """Eq. 4.4, but for the pressure's sign."""
    flow = TaylorGreen(1.0, 1.0, 1000.0, 0.01)
    x, y = np.array([0.1, 0.7]), np.array([0.3, 0.55])
    decay = np.exp(-2.0 * 0.01 * (2.0 * np.pi) ** 2 * 0.5)
    u, v = flow.velocity(np.stack((x, y), axis=1), 0.5).T
    assert np.allclose(u, np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y) * decay)
    assert np.allclose(v, -np.cos(2 * np.pi * x) * np.sin(2 * np.pi * y) * decay)
    pressure = 250.0 * (np.cos(4 * np.pi * x) + np.cos(4 * np.pi * y)) * decay**2
    assert np.allclose(flow.pressure(np.stack((x, y), axis=1), 0.5), pressure)


def test_energy_decays_at_its_rate() -> None:
    x, y = np.meshgrid(*[(np.arange(40) + 0.5) * FLOW.length / 40] * 2)
    position = np.stack((x.ravel(), y.ravel()), axis=1)
    times = np.linspace(0.0, 1.0, 5)
    energy = [kinetic_energy(FLOW.velocity(position, t), 1.0) for t in times]
    rate = exponential_rate(times, np.array(energy))
    assert rate == pytest.approx(FLOW.energy_decay_rate, rel=1e-12)
    assert rate == pytest.approx(-4.0 * 0.03 * np.pi**2, rel=1e-12)


def test_as_a_scene_it_starts_with_its_own_sign_and_is_exact_with_the_right_one(position) -> None:
    printed = replace(FLOW, pressure_sign=-1.0)
    assert np.array_equal(printed.initial_pressure(position), -FLOW.pressure(position, 0.0))
    assert np.array_equal(printed.initial_velocity(position), FLOW.velocity(position, 0.0))
    assert printed.exact == FLOW
