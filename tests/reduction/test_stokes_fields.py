"""Stokes flows around walls, against exact ones and what every one of them must be."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sphrom.reduction.stokes_fields import StokesFields, stokes_fields
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.polygon_domain import PolygonDomain

BOX = (0.0, 0.0), (4.0, 4.0)
CENTRE = np.array([2.0, 2.0])


def disc(radius: float) -> shapely.Polygon:
    return shapely.Point(CENTRE).buffer(radius, quad_segs=64)


def ring() -> Domain:
    """Return the fluid between a shaft of radius 0.5 and a bore of radius 1.5."""
    around = shapely.difference(shapely.box(*BOX[0], *BOX[1]), disc(1.5))
    return PolygonDomain(*BOX, (False, False), (("shaft", disc(0.5)), ("bore", around)))


def fields(domain: Domain, spacing: float) -> tuple[np.ndarray, dict[str, StokesFields]]:
    position, ghosts = domain.fill(spacing), domain.ghosts(spacing, 4).position
    return position, stokes_fields(domain, position, ghosts, spacing, domain.wall_names)


def test_a_shaft_that_turns_drives_a_couette_flow() -> None:
    position, found = fields(ring(), 0.05)
    shaft = found["shaft"]
    assert shaft.follows.tolist() == [True, True, True]
    x, y = (position - CENTRE).T
    radius = np.hypot(x, y)
    speed = (0.5**2 / (1.5**2 - 0.5**2)) * (1.5**2 / radius - radius)
    exact = np.stack((-y, x), axis=1) * (speed / radius)[:, None]
    error = np.linalg.norm(shaft.value[2] - exact) / np.linalg.norm(exact)
    assert error < 0.06
    divergence = np.trace(shaft.gradient, axis1=2, axis2=3)
    assert np.abs(divergence).max() < 1e-10


def test_all_walls_together_move_as_one_body() -> None:
    position, found = fields(ring(), 0.05)
    x, y = (position - CENTRE).T
    together = found["shaft"].value + found["bore"].value
    for moved, expected in zip(together, ((1.0, 0.0), (0.0, 1.0), (-y, x)), strict=True):
        assert np.abs(moved - np.stack(np.broadcast_arrays(*expected), axis=-1)).max() < 0.02


def test_the_floor_of_a_channel_drags_a_linear_profile() -> None:
    position, found = fields(BoxDomain(*BOX, (True, False)), 0.1)
    floor = found["bottom"]
    # It leaves no room for what it would displace.
    assert floor.follows.tolist() == [True, False, False]
    assert floor.value[0, :, 0] == pytest.approx(1.0 - position[:, 1] / 4.0, abs=1e-3)
    assert floor.gradient[0, :, 0, 1] == pytest.approx(-0.25, abs=0.02)


def test_a_disc_alone_carries_the_whole_fluid() -> None:
    _, found = fields(PolygonDomain(*BOX, (True, True), (("disc", disc(0.7)),)), 0.1)
    for motion in range(2):
        expected = np.eye(2)[motion]
        assert np.abs(found["disc"].value[motion] - expected).max() < 1e-3


def test_the_sides_of_a_closed_box_have_no_flows() -> None:
    _, found = fields(BoxDomain(*BOX, (False, False)), 0.1)
    assert not any(each.follows.any() for each in found.values())


def test_a_hill_slides_along_its_floor_but_does_not_lift_off() -> None:
    hill = shapely.Polygon([(1.2, -0.2), (2.8, -0.2), (2.4, 0.7), (1.6, 0.7)])
    domain = PolygonDomain(*BOX, (True, False), (("hill", hill),))
    _, found = fields(domain, 0.1)
    assert found["hill"].follows.tolist() == [True, False, False]
    assert found["top"].follows.tolist() == [True, False, False]
