"""What slows the fluid: the strip of an open flow, what it holds, and the steps it allows."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import FALL, RISE, Discretization, Fluid, Resistance, Strip, step_limits
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import runge_kutta_step

SPACING = 0.1


@pytest.mark.parametrize("speed", [0.5, -0.5])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_strip_is_as_strong_as_asked_and_falls_where_fluid_leaves_it(axis, speed) -> None:
    strip = Strip(axis, 1.0, 3.0, speed, strength=20.0)
    along = np.linspace(0.0, 4.0, 4001)
    rates = strip.rates(np.roll(np.stack((along, np.full_like(along, 0.3))), axis, axis=0))
    assert np.trapezoid(rates, along) == pytest.approx(20.0 * abs(speed), rel=1e-6)
    assert rates.max() == pytest.approx(strip.largest)
    assert not rates[(along <= 1.0) | (along >= 3.0)].any()
    share = (along - 1.0) / 2.0 if speed > 0.0 else (3.0 - along) / 2.0
    assert np.all(rates[(share > RISE) & (share < 1.0 - FALL)] == strip.largest)
    # No slope is steeper than twice the mean one of the flank that falls.
    assert np.abs(np.diff(rates)).max() == pytest.approx(1e-3 * strip.largest / FALL, rel=1e-3)


def test_what_a_strip_holds_is_an_orthogonal_projection() -> None:
    """Of the accelerations along the flow alone, onto what has no share of the strip's rates."""
    random, strip = np.random.default_rng(0), Strip(0, 1.0, 3.0, 1.0, strength=20.0)
    place, (a, b) = random.uniform(0.0, 4.0, (2, 50)), random.standard_normal((2, 2, 50))
    held_a, held_b, again = a.copy(), b.copy(), a.copy()
    for each in (held_a, held_b, again, again):
        Resistance(strip=strip).hold(place, each)
    assert again == pytest.approx(held_a, abs=1e-14)
    assert held_a[0] @ strip.rates(place) == pytest.approx(0.0, abs=1e-10)
    assert np.array_equal(held_a[1], a[1])
    assert np.sum(held_a * b) == pytest.approx(np.sum(a * held_b))


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    ("rate", "viscosity", "damping"), [(60, 0.1, 0), (100, 0.01, 0), (400, 0.1, 1), (1000, 0.01, 1)]
)
def test_steps_of_resistances_are_stable_up_to_their_limit(rate, viscosity, damping, held) -> None:
    """With viscosity and sound, all over the fluid and in a strip that holds the flow rate."""
    resistance = Resistance(own=lambda at: np.full(at.shape[1], float(rate)))
    if held:
        resistance = Resistance(strip=Strip(0, 0.0, 2.0, 1.0, strength=1.6 * rate))
    fluid = Fluid(1.0, sound_speed=10.0, kinematic_viscosity=viscosity, max_speed=1.0)
    cut = Discretization(SPACING, 2.0 * SPACING, acoustic_damping=damping)
    domain = BoxDomain((0.0, 0.0), (4.0, 1.0), (True, True))
    functional = Functional(fluid, cut, domain, resistance=resistance)
    random, limits = np.random.default_rng(0), step_limits(fluid, cut, resistance=rate)
    noise = 1e-6 * np.array([0.1, 1.0, 1.0])[:, None] * random.standard_normal((3, 400))

    def growth(step: float) -> float:
        state = np.vstack((domain.fill(SPACING).T, noise))
        for n in range(60):
            state = runge_kutta_step(functional, state, n * step, step)
            if (grown := np.abs(state[2:]).max() / np.abs(noise).max()) > 100.0:
                break
        return float(grown)

    assert growth(limits.least) < 1.0
    assert growth(2.0 * limits.least) > 100.0
