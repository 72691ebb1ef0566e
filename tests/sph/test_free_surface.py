"""Fluid with a free surface: at rest, in a standing wave, as a drop, and as spray."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

from sphrom.case.checks import case_problems
from sphrom.case.models import Case
from sphrom.errors import UnstableError
from sphrom.setup import particles
from sphrom.sph.fluid import fluctuation_of
from sphrom.sph.time_loop import Clock, march

Array = NDArray[np.float64]
HEIGHT = 0.5
RATE = math.sqrt(math.pi * math.tanh(math.pi * HEIGHT))
"""Of the first standing wave in a tank one wide, with a gravity of one [rad/s]."""
PERIOD = 2.0 * math.pi / RATE


def tank(
    final_time: float, scene: dict[str, Any], reynolds: float = 250.0, **discretization: Any
) -> Case:
    """Return a tank one wide at Re = H sqrt(g H) / nu, with a free surface."""
    viscosity = HEIGHT**1.5 / reynolds
    own = {"kind": "custom", "fluid": {"level": HEIGHT, "gravity": 1.0}, "slip": "free"}
    return Case.model_validate(
        {
            "name": "tank",
            "scene": own | scene,
            "fluid": {"reference_density": 1.0, "reference_speed": 0.3},
            "discretization": {"resolution": 16, **discretization},
            "parameters": {"train": {"reynolds": [0.3 / viscosity]}},
            "snapshots": {"every": 5},
            "time": {"final_time": final_time},
        }
    )


def run(case: Case) -> tuple[Array, Array]:
    """Return the times [s] and the states (n_snapshots, 5, n_particles) of a full run."""
    plan, point = case.plan, case.plan.points[0]
    flow, position = plan.flow(point), case.scene.fill(plan.particle_spacing)
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    start = np.vstack((position.T, density, flow.initial_velocity(position).T))
    model = particles.functional(case, point)
    states = march(model, start, plan.steps, 1.0, Clock(), lambda steps: None)
    steps, found = zip(*states, strict=True)
    return plan.steps.time_step * np.array(steps), np.array(found)


@pytest.mark.parametrize("slip", ["free", "none"])
def test_fluid_at_rest_stays_at_rest(slip: str) -> None:
    case = tank(3.0 * PERIOD, {"slip": slip})
    times, states = run(case)
    late = states[times > 2.0 * PERIOD]
    pressure = case.plan.sound_speed**2 * late[:, 2]
    error = np.sqrt(np.mean((pressure - (HEIGHT - late[:, 1])) ** 2))
    # With eight rows, measured: 0.0030 and 0.032; the pressure's error is a quarter of a spacing.
    assert np.abs(late[:, 3:]).max() < 5e-3 * math.sqrt(HEIGHT)
    assert error < 0.04 * HEIGHT


def test_water_at_rest_gains_no_motion() -> None:
    """At Re 3 million: measured 0.005 of sqrt(g H), and with `normal` walls 0.05, growing."""
    scene = {"box": {"upper": [1, 1.5]}, "fluid": {"level": 1.0, "gravity": 1.0}}
    times, states = run(tank(10.0 * 2.0 * math.pi / math.sqrt(math.pi), scene, 1e6))
    assert np.abs(states[times > 4.0, 3:]).max() < 0.008


def test_a_standing_wave_has_its_frequency() -> None:
    speed = 0.05 * HEIGHT * RATE / math.sinh(math.pi * HEIGHT)
    u, v = f"{speed}*cosh(pi*y)*sin(pi*x)", f"-{speed}*sinh(pi*y)*cos(pi*x)"
    times, states = run(tank(3.0 * PERIOD, {"initial": {"u": u, "v": v}}, resolution=32))
    mode = np.mean(np.cos(math.pi * states[:, 0]) * np.cosh(math.pi * states[:, 1]), axis=1)

    def damped(t: Array, a: float, b: float, mean: float, rate: float, decay: float) -> Array:
        return mean + np.exp(-decay * t) * (a * np.sin(rate * t) + b * np.cos(rate * t))

    (_, _, _, rate, _), _ = curve_fit(damped, times, mode, [np.ptp(mode), 0.0, 0.0, RATE, 0.03])
    assert abs(rate / RATE - 1.0) < 0.005  # measured: 0.0015


def test_a_drop_stays_the_ellipse_of_its_equations() -> None:
    drop = {"circle": {"centre": [0.5, 0.5], "radius": 0.25}, "gravity": 0.0}
    start = {"u": "0.5*(x - 0.5)", "v": "-0.5*(y - 0.5)"}
    start["p"] = "0.625*(0.0625 - (x - 0.5)**2 - (y - 0.5)**2)"
    scene = {"fluid": drop, "body_force": ["0.5 - x", "0.5 - y"], "initial": start}
    times, states = run(tank(4.5, scene, 1e4, resolution=32))

    def rates(t: float, state: Array) -> tuple[float, float, float]:
        stretch, a, b = state
        return (stretch**2 + 1.0) * (b**2 - a**2) / (b**2 + a**2), stretch * a, -stretch * b

    exact = solve_ivp(rates, (0.0, times[-1]), (0.5, 0.25, 0.25), t_eval=times, rtol=1e-8).y[1:]
    axes = 2.0 * np.sqrt(np.mean((states[:, :2] - 0.5) ** 2, axis=2)).T
    # Measured, with sixteen particles across: 0.044 after a whole period.
    assert np.abs(axes / axes[:, :1] / exact * 0.25 - 1.0).max() < 0.06


@pytest.mark.parametrize("slip", ["free", "none"])
def test_a_front_runs_along_the_floor_and_nothing_leaves_the_walls(slip: str) -> None:
    scene = {
        "box": {"lower": [0, 0], "upper": [1, 1]},
        "fluid": {"rectangle": {"lower": [0, 0], "upper": [0.25, 0.5]}, "gravity": 1.0},
        "slip": slip,
    }
    times, states = run(tank(1.4, scene, resolution=32))
    front = states[:, 0].max(axis=1) + 1.0 / 64.0
    # Martin and Moyce (1952), for t sqrt(2 g / a) and z / a; it takes theirs time to let go.
    scaled = np.interp([0.832, 1.997], times * math.sqrt(2.0 / 0.25), front / 0.25)
    np.testing.assert_allclose(scaled, [1.217, 2.292], rtol=0.15)
    assert front[-1] > 0.99
    assert states[:, :2].min() > 0.0
    assert states[:, 0].max() < 1.0


def test_a_drop_keeps_its_momentum_and_falls_freely() -> None:
    drop = {"circle": {"centre": [0.5, 0.6], "radius": 0.2}, "gravity": 1.0}
    times, states = run(tank(0.4, {"fluid": drop}))
    np.testing.assert_allclose(states[:, 4].mean(axis=1), -times, atol=1e-12)
    np.testing.assert_allclose(states[:, 3].mean(axis=1), 0.0, atol=1e-12)


def test_the_body_force_changes_along_each_axis_in_its_own_way() -> None:
    scene = {
        "constants": {"rate": 3.0},
        "body_force": ["sin(rate*t)", "2*t"],
        "fluid": {"polygon": [[0.3, 0.3], [0.7, 0.3], [0.5, 0.7]], "gravity": 0.5},
    }
    case = tank(0.1, scene)
    force = case.plan.flow(case.plan.points[0]).body_force
    np.testing.assert_allclose(force(np.zeros((2, 3)), 0.2)[:, 1], [math.sin(0.6), -0.1])


def test_a_lonely_particle_flies_and_what_leaves_the_box_is_named() -> None:
    spray = {"rectangle": {"lower": [0.5, 0.5], "upper": [0.55, 0.55]}, "gravity": 1.0}
    case = tank(2.0, {"fluid": spray, "slip": "none", "initial": {"v": 3.0}})
    assert case.plan.n_particles == 1
    with pytest.raises(UnstableError, match=r"particle 0 at .* beyond a wall"):
        run(case)


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"fluid": {"level": 1.5}}, "fluid.level: must be above 0 and below 1; got 1.5"),
        ({"fluid": {}}, "exactly one of level, circle, rectangle, polygon; got none"),
        ({"fluid": {"sphere": {}}}, "exactly one of level, circle, rectangle, polygon; got sphere"),
        ({"fluid": {"circle": {"centre": [0, 0.5], "radius": 0.3}}}, "within the box"),
        ({"box": {"periodic": ["y"]}}, "fluid.level: needs a floor"),
        ({"walls": {"top": {"velocity": [1, 0]}}}, "slip: moving walls"),
    ],
)
def test_what_makes_no_sense_is_refused(scene: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tank(1.0, scene)


@pytest.mark.parametrize(
    ("fluid", "discretization", "message"),
    [
        ({"level": 0.53}, {}, "don't end at 0.53 m; they do at 0.5 m"),
        ({"level": 0.5}, {"initial_particles": "packed"}, "starts on a lattice"),
        ({"level": 0.5}, {"shifting": {"enabled": True}}, "out of a free surface"),
        ({"circle": {"centre": [0.5, 0.5], "radius": 0.001}}, {}, "no particle is in it"),
    ],
)
def test_fluid_that_particles_cannot_fill_is_refused(
    fluid: dict[str, Any], discretization: dict[str, Any], message: str
) -> None:
    problems = case_problems(tank(1.0, {"fluid": fluid}, **discretization))
    assert any(message in problem.reason for problem in problems)
