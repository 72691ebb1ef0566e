"""Fluid that starts from rest between walls at an angle to its lattice, against the exact series.

`scripts/wall_flows.py` measures the same with more particles.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
import shapely

from sphrom.sph.fluid import Discretization, Fluid, step_limits
from sphrom.sph.functional import Functional
from sphrom.sph.packing import pack
from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.time_loop import runge_kutta_step

VISCOSITY, END, SOLID_LAYERS, PERTURBATION = 0.1, 1.5, 10, 0.3


def series(height: np.ndarray, force: float, lid: float) -> np.ndarray:
    """Return the velocity (n,) of fluid that was at rest, along walls 1 m apart."""
    number = np.arange(1, 400)[:, None]
    wave, sign = number * math.pi, (-1.0) ** number
    shapes = np.sin(wave * height) * np.exp(-(wave**2) * VISCOSITY * END)
    driven = 0.5 * height * (1.0 - height) - np.sum(2.0 * (1.0 - sign) / wave**3 * shapes, axis=0)
    return force / VISCOSITY * driven + lid * (height + np.sum(2.0 * sign / wave * shapes, axis=0))


@cache
def largest_error(n: int, angle: float, lid: float) -> float:
    """Return the largest error of any particle, over the largest speed, at the end."""
    turn, solid, spacing = math.radians(angle), SOLID_LAYERS / n, 1.0 / n
    period = (1.0 + solid) / math.cos(turn)
    along = np.array((math.cos(turn), math.sin(turn)))
    across = np.array((-along[1], along[0]))
    ends = np.array([[-4.0], [4.0]]) * along

    def band(low: float, high: float) -> shapely.Polygon:
        return shapely.Polygon([*(ends + low * across), *(ends[::-1] + high * across)])

    solids = ("floor", band(-0.5 * solid, 0.0)), ("lid", band(-solid, -0.5 * solid))
    domain = PolygonDomain((0.0, 0.0), (period / math.tan(turn), period), (True, True), solids)
    fluid = Fluid(1.0, 10.0, VISCOSITY, 1.0)
    discretization = Discretization(spacing, 2.0 * spacing, acoustic_damping=1.0, fixed_volume=True)
    walls = domain.ghosts(spacing, discretization.n_layers).moving(
        lambda place: lid * np.outer(domain.nearest_wall(place) == 1, along)
    )
    packing = pack(
        domain, discretization, ghosts=walls.position, perturbation=PERTURBATION, tolerance=3e-4
    )
    force = (0.0 if lid else 8.0 * VISCOSITY) * along[:, None]
    functional = Functional(
        fluid, discretization, domain, walls, lambda x, time: np.tile(force, x.shape[1])
    )
    limits = step_limits(fluid, discretization, has_walls=True)
    n_steps = math.ceil(END / min(limits.acoustic, limits.viscous))
    state = np.zeros((5, len(packing.position)))
    state[:2] = packing.position.T
    for _ in range(n_steps):
        state = runge_kutta_step(functional, state, 0.0, END / n_steps)
    height = np.mod(domain.wrap(state[:2].T) @ across, 1.0 + solid)
    exact = np.outer(along, series(height, 0.0 if lid else 8.0 * VISCOSITY, lid))
    return float(np.hypot(*(state[3:] - exact)).max())


@pytest.mark.parametrize("lid", [0.0, 1.0], ids=["Poiseuille", "Couette"])
@pytest.mark.parametrize("angle", [30.0, 45.0])
def test_channel_at_an_angle(angle: float, lid: float) -> None:
    """Measured at 10 across: 1.1 and 1.0 % under a force, 0.5 and 0.4 % under a lid.

    By the script at 40, under a force: 0.2 % at no angle and at 30 degrees, 0.1 % at 45.
    """
    assert largest_error(10, angle, lid) < 0.013


@pytest.mark.parametrize("angle", [30.0, 45.0])
def test_order(angle: float) -> None:
    """Of the largest error under a force: measured, 1.3 at 30 degrees and 1.7 at 45.

    By the script it is 1.2 from 10 to 20 across and 0.8 from 20 to 40 in steady flow where walls
    lie along the axes: rows of particles come to lie 0.4 % closer in the middle at 20 across.
    """
    counts = np.array([10, 20])
    errors = np.array([largest_error(n, angle, 0.0) for n in counts])
    assert np.polyfit(np.log(1.0 / counts), np.log(errors), 1)[0] > 1.2
