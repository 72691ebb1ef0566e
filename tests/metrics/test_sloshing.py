"""Linear theory of a shaken tank, against its own closed forms."""

import math

import numpy as np
import pytest

from sphrom.metrics.sloshing import instants, largest_slope, rate_and_damping

TANK = {"width": 1.0, "depth": 0.5, "gravity": 1.0}
NU = 0.5 * math.sqrt(0.5) / 250.0


def slope(ratio: float, strength: float, end: float, slips: bool = True) -> float:
    rate, _ = rate_and_damping(1, *TANK.values(), NU, slips)
    times = instants(end, *TANK.values(), 0.05)
    force = strength * np.sin(ratio * rate * times)
    return largest_slope(times, force, **TANK, viscosity=NU, slips=slips)


def test_a_resonance_grows_to_the_height_that_damping_allows() -> None:
    """The first wave's slope is 4 f/(g pi) w/(2 d), which e^-dt approaches."""
    rate, damping = rate_and_damping(1, *TANK.values(), NU, True)
    for end in (37.0, 200.0):
        expected = 4.0 / math.pi * 1e-3 * rate / (2.0 * damping) * (1.0 - math.exp(-damping * end))
        assert slope(1.0, 1e-3, end) == pytest.approx(expected, rel=0.02)


def test_a_slow_force_tilts_the_surface() -> None:
    times = np.linspace(0.0, 400.0, 8001)
    force = 1e-3 * np.minimum(times / 200.0, 1.0)
    found = largest_slope(times, force, **TANK, viscosity=NU, slips=True)
    # The slope f/g is a square wave, of which three waves overshoot by 19 %.
    assert found == pytest.approx(1.19e-3, rel=0.01)


def test_layers_at_walls_damp_as_in_theory() -> None:
    """At Re 1,000 they and the fluid damp by 0.0241/s (docs/free-surfaces.md)."""
    damping = rate_and_damping(1, *TANK.values(), NU / 4.0, False)[1]
    assert damping == pytest.approx(0.0241, rel=0.02)
    deep = rate_and_damping(1, 1.0, 500.0, 1.0, NU, False)[1]
    shallower = rate_and_damping(1, 1.0, 5.0, 1.0, NU, False)[1]
    assert deep == pytest.approx(shallower, rel=1e-6)
