"""Linear theory of fluid in a tank that a horizontal force shakes, from rest.

The surface is the sum of cosines c_n cos(n pi x/L). An odd one is an oscillator,

    c'' + 2 d c' + w^2 c = -w^2 4 L f(t)/(g n^2 pi^2),    w^2 = g k tanh(k H),    k = n pi/L,

and a uniform force moves no even one. The damping d is 2 nu k^2 by viscosity (Lamb, Hydrodynamics,
section 348), and without slip that of layers along the floor and both ends, too (Mei and Liu,
J. Fluid Mech. 59, 1973).
"""

from __future__ import annotations

import math

import numpy as np

from sphrom.arrays import Array

WAVES = (1, 3, 5)
"""n; a smooth force moves later ones by less than a hundredth of the first."""
PER_PERIOD = 40
"""Instants in a period of the last wave, at which sums are within a percent of integrals."""
N_PLACES = 25
"""Places along half the tank, on which the slope is symmetric."""


def rate_and_damping(
    n: int, width: float, depth: float, gravity: float, viscosity: float, slips: bool
) -> tuple[float, float]:
    """Return the frequency w [rad/s] and the damping d [1/s] of a wave."""
    k = n * math.pi / width
    rate = math.sqrt(gravity * k * math.tanh(k * depth))
    damping = 2.0 * viscosity * k**2
    if not slips:
        # 1/sinh and its product with the layers' height, each as it is for deep fluid.
        inverse = 1.0 / math.sinh(min(2.0 * k * depth, 700.0))
        share = 2.0 * k / width * (0.5 * width - depth) * inverse + 1.0 / width
        damping += math.sqrt(0.5 * viscosity * rate) * share
    return rate, damping


def instants(end: float, width: float, depth: float, gravity: float, longest: float) -> Array:
    """Return times (n_times,) [s] from zero that resolve the waves, at most `longest` apart [s]."""
    rate, _ = rate_and_damping(WAVES[-1], width, depth, gravity, 0.0, True)
    step = min(longest, 2.0 * math.pi / rate / PER_PERIOD)
    return np.linspace(0.0, end, 1 + max(1, math.ceil(end / step)))


def largest_slope(
    times: Array,
    force: Array,
    *,
    width: float,
    depth: float,
    gravity: float,
    viscosity: float,
    slips: bool,
) -> float:
    """Return the largest slope of the surface, at all places and times.

    Parameters
    ----------
    times : (n_times,) [s], equally spaced from zero, as `instants` gives them.
    force : (n_times,) [m/s2] along the tank.
    width, depth, gravity, viscosity : [m], [m], [m/s2], [m2/s].
    slips : whether fluid slips along the walls.
    """
    step = times[1] - times[0]
    x = np.linspace(0.0, 0.5 * width, N_PLACES)
    slope = np.zeros((len(times), N_PLACES))
    for n in WAVES:
        rate, damping = rate_and_damping(n, width, depth, gravity, viscosity, slips)
        damped = np.sqrt(complex(rate**2 - damping**2))  # imaginary if no wave remains
        answer = np.exp(-damping * times) * (np.sin(damped * times) / damped).real
        push = -(rate**2) * 4.0 * width / (gravity * (n * math.pi) ** 2) * force
        amplitude = step * _convolved(answer, push)
        slope -= amplitude[:, None] * (n * math.pi / width) * np.sin(n * math.pi / width * x)
    return float(np.abs(slope).max())


def _convolved(left: Array, right: Array) -> Array:
    """Return the leading terms (n,) of the convolution of series (n,)."""
    length = 2 * len(left)
    product = np.fft.rfft(left, length) * np.fft.rfft(right, length)
    return np.asarray(np.fft.irfft(product, length)[: len(left)])
