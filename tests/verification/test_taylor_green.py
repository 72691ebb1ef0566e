"""The full model against the exact vortex: order, compressibility, energy, momentum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.metrics.series import exponential_rate, kinetic_energy

RESOLUTIONS = (25, 36, 50)
MACHS = (0.2, 0.1, 0.05)
TIME = 0.3


@pytest.fixture(scope="module")
def by_resolution(full_run: Callable, vortex: type) -> dict:
    return {n: full_run(vortex(n), TIME) for n in RESOLUTIONS}


@pytest.fixture(scope="module")
def by_mach(full_run: Callable, vortex: type, by_resolution: dict) -> dict:
    runs = {mach: full_run(vortex(36, mach=mach), 0.2) for mach in MACHS if mach != 0.1}
    return {0.1: full_run(vortex(36), 0.2), **runs}


def decay(run) -> float:
    """Return the fitted rate of decay of the kinetic energy over the exact one."""
    energy = kinetic_energy(run.states[:, 3:].transpose(0, 2, 1), 1.0)
    return exponential_rate(run.time, energy) / run.vortex.flow.energy_decay_rate


def order(by_resolution: dict, errors: list[float]) -> float:
    return np.polyfit(np.log(1.0 / np.array(RESOLUTIONS)), np.log(np.array(errors)), 1)[0]


def test_order_of_the_velocity(by_resolution: dict) -> None:
    """Measured: errors of 0.48, 0.28, 0.20 % (mean over time), order 1.24.

    The smooth part of the error falls with the fourth power: with a Laplacian of second order
    errors are 1.6, 0.7 and 0.4 %. What is left is what rearranging particles do.
    """
    errors = [run.velocity_errors().mean() for run in by_resolution.values()]
    assert order(by_resolution, errors) > 1.0
    assert np.all(np.array(errors) < [0.72, 0.43, 0.31])


def test_order_of_the_pressure(by_resolution: dict) -> None:
    """Measured: errors of 17, 10, 6.2 % (mean over time), order 1.5."""
    errors = [run.pressure_errors().mean() for run in by_resolution.values()]
    assert order(by_resolution, errors) > 1.2
    assert errors[-1] < 9.3


def test_energy_decays_as_it_should(by_resolution: dict) -> None:
    """Measured: 1.0027, 0.9996 and 1.0001 of the exact rate."""
    for run in by_resolution.values():
        assert decay(run) == pytest.approx(1.0, abs=0.005)
    assert decay(by_resolution[50]) == pytest.approx(1.0, abs=0.002)


@pytest.mark.parametrize(("reynolds", "off", "error"), [(60.0, 0.003, 0.35), (400.0, 0.015, 0.5)])
def test_energy_decays_as_it_should_at_other_viscosities(
    full_run: Callable, vortex: type, reynolds: float, off: float, error: float
) -> None:
    """Measured: 0.9991 and 1.0095 of the exact rate, velocities off by 0.21 and 0.34 % at the end.

    A Laplacian of second order takes 0.991 at Re 60, shifting as printed 1.02 at Re 400.
    """
    run = full_run(vortex(50, reynolds=reynolds), TIME)
    assert decay(run) == pytest.approx(1.0, abs=off)
    assert run.velocity_errors()[-1] < error


def test_momentum_stays_small(by_resolution: dict) -> None:
    """Shifting doesn't conserve it: measured, mean velocities of 5.2e-4 m/s at most."""
    for run in by_resolution.values():
        assert np.max(np.abs(run.states[:, 3:].mean(axis=2))) < 8e-4


def test_compressibility_falls_with_the_mach_number(by_mach: dict) -> None:
    """Measured at Ma 0.2, 0.1, 0.05: r.m.s. of rho' 9.2, 2.3 and 0.70 kg/m3 (order 1.86),
    velocity errors 0.42, 0.26 and 0.31 %, decay 0.9935, 0.9987 and 1.0014 of the exact one.
    """
    runs = [by_mach[mach] for mach in MACHS]
    fluctuation = [float(np.sqrt(np.mean(run.states[:, 2] ** 2))) for run in runs]
    assert np.polyfit(np.log(np.array(MACHS)), np.log(np.array(fluctuation)), 1)[0] > 1.5
    velocity = [run.velocity_errors().mean() for run in runs]
    assert velocity[0] > 1.2 * velocity[1]
    losses = [1.0 - decay(run) for run in runs]
    assert losses[0] > 2.0 * losses[1] > 2.0 * losses[2]


def test_the_printed_sign_starts_a_sound_wave(
    full_run: Callable, vortex: type, by_mach: dict
) -> None:
    """Measured: pressure errors of 30 % (mean over time) against 9.7 %; without a damper 132 %."""
    printed = full_run(vortex(36, pressure_sign=-1.0), 0.2)
    errors = printed.pressure_errors()
    assert errors.mean() > 2.0 * by_mach[0.1].pressure_errors().mean()


def test_particles_stay_even(by_resolution: dict) -> None:
    """Shifting at work: no two particles come close, nor does any region empty.

    Measured on 50x50: nearest neighbours between 0.67 and 1.08 spacings away.
    """
    run = by_resolution[50]
    state = run.states[-1]
    offset = state[:2, :, None] - state[:2, None, :]
    offset -= np.round(offset)
    distance = np.hypot(*offset) + np.eye(state.shape[1])
    assert distance.min() > 0.55 / 50
    assert distance.min(axis=1).max() < 1.2 / 50
