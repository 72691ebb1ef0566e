"""Porous bodies and open flows against exact ones: Darcy, Brinkman, Poiseuille, Kovasznay."""

from __future__ import annotations

import math

import numpy as np
import pytest

import sphrom


def study(out, resolution: int, viscosity: float, end: float, scene, speed=1.0, **sections):
    """Return a study of a flow of one's own, of a viscosity [m2/s] and a length of 1 m."""
    case = {
        "name": "flow",
        "fluid": {"reference_speed": speed},
        "discretization": {"resolution": resolution},
        "time": {"final_time": end},
        "parameters": {"train": {"reynolds": [speed / viscosity]}},
        "scene": {"kind": "custom", "reference_length": 1.0, **scene},
    }
    return sphrom.Study({**case, **sections}, out=out, threads=1, quiet=True)


def late_states(study: sphrom.Study) -> np.ndarray:
    """Return x, y, u, v and p/rho (n_snapshots, 5, n_particles) over a full run's last third."""
    study.run_stage("fom")
    with sphrom.open(next(study.folder.glob("fom-*.h5"))) as run:
        late = run.time.values > 2.0 / 3.0 * study.case.time.final_time
        place, velocity = run.position.values[late], run.velocity.values[late]
        pressure = run.pressure.values[late] / study.case.fluid.reference_density
    return np.concatenate((place, velocity, pressure[..., None]), axis=2).swapaxes(1, 2)


def between(states: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the states (5, n) of particles between two places along x [m], at all instants."""
    found = np.concatenate([*states], axis=1)
    return found[:, (found[0] > low) & (found[0] < high)]


@pytest.mark.parametrize(
    ("resolution", "rate", "most"),
    [(16, 2, 0.004), (32, 2, 0.004), (16, 40, 0.015), (32, 40, 0.008)],
)
def test_flux_through_a_porous_plate_is_darcy_s(tmp_path, resolution, rate, most) -> None:
    """f L = nu/k U d. Measured: 0.1 % off, and of the denser plate 1.2 and 0.6 %.

    Over that one the pressure falls by a fifth of rho c0^2, were c0 not raised for it.
    """
    shape = {"rectangle": {"lower": [0.75, -1.0], "upper": [1.25, 2.0]}}
    scene = {
        "box": {"upper": [2, 0.5], "periodic": ["x", "y"]},
        "porous": {"plate": {**shape, "permeability": 0.05 / rate}},
        "body_force": [rate * 0.5 / 2.0, 0],
        "initial": {"u": 0.9},
    }
    states = late_states(study(tmp_path, resolution, 0.05, max(1.5, 20.0 / rate), scene))
    assert states[:, 2].mean() == pytest.approx(1.0, rel=most)


BED = {
    "box": {"upper": [0.5, 1], "periodic": ["x"]},
    "porous": {"bed": {"rectangle": {"lower": [-1, -1], "upper": [2, 2]}, "permeability": 0.02}},
    "body_force": [5.0, 0],
}


def brinkman(y: np.ndarray) -> np.ndarray:
    """Return the velocity in that bed between walls, at 0.1 m2/s."""
    root = math.sqrt(0.02)
    return 1.0 - np.cosh((y - 0.5) / root) / math.cosh(0.5 / root)


@pytest.mark.parametrize(("resolution", "most"), [(16, 0.02), (32, 0.007)])
def test_flow_in_a_porous_bed_between_walls_is_brinkman_s(tmp_path, resolution, most) -> None:
    """Measured, of the largest speed: 1.7 and 0.5 % at worst, beside walls; flux 0.5 and 0.2 %."""
    y, u = late_states(study(tmp_path, resolution, 0.1, 1.5, BED))[-1, 1:3]
    assert np.abs(u - brinkman(y)).max() < most * brinkman(y).max()
    assert u.mean() == pytest.approx(brinkman(y).mean(), rel=0.007)


def test_a_fast_model_has_that_flow_between_its_training_runs(tmp_path) -> None:
    """Measured: 1.4 % at worst, and 0.3 % of the flux."""
    parameters = {"train": {"reynolds": [5.0, 20.0]}, "test": {"reynolds": [10.0]}}
    rom = [{"name": "fast", "evaluation": "operators", "n_modes": 4}]
    here = study(tmp_path, 20, 0.1, 2.0, BED, parameters=parameters, rom=rom)
    here.run(until="operators")
    y = np.linspace(0.02, 0.98, 49)
    places = np.stack((np.full_like(y, 0.2), y), axis=1)
    u = here.model("fast", reynolds=10.0).run().fields(places).velocity.values[-1, :, 0]
    assert np.abs(u - brinkman(y)).max() < 0.02
    assert u.mean() == pytest.approx(brinkman(y).mean(), rel=0.01)


@pytest.mark.parametrize("resolution", [10, pytest.param(20, marks=pytest.mark.slow)])
def test_an_open_channel_has_its_profile_flow_rate_and_pressure(tmp_path, resolution: int) -> None:
    """From rest, at Re 20. Measured: profiles 0.8 and 0.4 % off at worst, slopes 0.3 and 0.1 %."""
    width = 20.0 / resolution
    inflow = {"strip": {"from": -width, "to": 0}, "velocity": ["6*y*(1 - y)", 0]}
    box = {"lower": [-width, 0], "upper": [2, 1], "periodic": ["x"]}
    scene, line = {"box": box, "inflow": inflow}, {"line": 1.0}
    states = late_states(study(tmp_path, resolution, 0.05, 10.0, scene, 1.5, compare=line))
    for low in np.arange(0.0, 2.0, 0.25):
        _, y, u, v, _ = between(states, low, low + 0.25)
        error = u - 6.0 * y * (1.0 - y)
        assert math.sqrt(np.mean(error**2 + v**2)) < 0.01
        assert abs(error.mean()) < 0.005  # it changes as the density does
    x, *_, pressure = between(states, 0.25, 1.5)
    assert np.polyfit(x, pressure, 1)[0] == pytest.approx(-12.0 * 0.05, rel=0.01)


DECAY = 20.0 - math.sqrt(400.0 + 4.0 * math.pi**2)
"""Of Kovasznay's flow at Re 40 [1/m]."""


@pytest.mark.parametrize(
    ("resolution", "end", "most"),
    [(10, 4.0, 0.006), (20, 4.0, 0.003), pytest.param(10, 25.0, 0.006, marks=pytest.mark.slow)],
)
def test_kovasznay_s_flow_leaves_the_strip_and_stays(tmp_path, resolution, end, most) -> None:
    """Measured up to 0.8 m before the outflow: 0.3 and 0.1 % of U, and 0.3 % after 10 periods.

    Nearer to it the flow feels what the strip forces next, by exp(-2 pi d) at a distance d.
    """
    field = f"exp({DECAY}*x)", f"{DECAY / (2.0 * math.pi)}*exp({DECAY}*x)"
    velocity = [f"1 - {field[0]}*cos(2*pi*y)", f"{field[1]}*sin(2*pi*y)"]
    scene = {
        "box": {"upper": [2.4, 1], "periodic": ["x", "y"]},
        "inflow": {"strip": {"from": 0, "to": 1}, "velocity": velocity, "strength": 100.0},
        "initial": {"u": 1.0},
    }
    states = late_states(study(tmp_path, resolution, 0.025, end, scene, 2.0, compare={"line": 1.2}))
    x, y, u, v, _ = between(states, 1.0, 1.6)
    share, wave = np.exp(DECAY * x), 2.0 * math.pi * y
    u -= 1.0 - share * np.cos(wave)
    v -= DECAY / (2.0 * math.pi) * share * np.sin(wave)
    assert math.sqrt(np.mean(u**2 + v**2)) < most
    assert np.ptp(np.mean(states[:, 2:4] ** 2, axis=(1, 2))) < 0.01
    assert np.abs(states[:, 4].mean(axis=1)).max() < 0.01  # no mean pressure grows
