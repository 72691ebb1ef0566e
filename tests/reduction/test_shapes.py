"""The reference space and its splines between walls of any shape."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sphrom.reduction.spline import default_cell_width, fit_splines
from sphrom.sph.fluid import Discretization
from sphrom.sph.packing import pack
from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.polygons import disc

SPACING = 0.025
RING = PolygonDomain(
    (-1.1, -1.1),
    (1.1, 1.1),
    (False, False),
    (
        ("inner", disc((0.0, 0.0), 0.5)),
        ("outer", shapely.difference(shapely.box(-2, -2, 2, 2), disc((0.0, 0.0), 1.0))),
    ),
)
CHANNEL = PolygonDomain(
    (0.0, 0.0),
    (2.0, 1.0),
    (True, False),
    (
        ("disc", disc((0.05, 0.6), 0.2)),
        ("fin", shapely.Polygon([(0.9, 0.0), (1.3, 0.0), (1.0, 0.5)])),
    ),
)
DOMAINS = {"ring": RING, "channel": CHANNEL}


def smooth(place: np.ndarray) -> np.ndarray:
    """Return fields (n, 3) with the channel's period."""
    x, y = place.T
    return np.stack((np.sin(np.pi * x) * y, np.cos(np.pi * x), np.exp(y)), axis=1)


@pytest.mark.parametrize("name", DOMAINS)
def test_splines_serve_all_of_the_fluid(name: str) -> None:
    """Measured: errors of 8e-6 at worst, and no place in the fluid is without a spline."""
    domain = DOMAINS[name]
    ghosts = domain.ghosts(SPACING, 4).position
    discretization = Discretization(SPACING, 2.0 * SPACING)
    points = pack(domain, discretization, ghosts=ghosts, perturbation=0.3).position
    places = np.random.default_rng(0).uniform(domain.lower, domain.upper, (5000, 2))
    # As near to walls as particles come.
    places = places[domain.wall_distance(places) > 0.25 * SPACING]
    width = default_cell_width(domain, len(points))
    splines = fit_splines(points, smooth(points), domain, polynomial_degree=3, cell_width=width)
    error = np.abs(splines.values(places) - smooth(places))
    assert not np.isnan(error).any()
    assert error.max() < 2e-5
    assert np.sqrt(np.mean(error**2)) < 1e-6
