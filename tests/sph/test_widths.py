"""The narrowest gaps and thinnest solids of shapes whose widths follow from their corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate

from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.polygons import disc

NEVER = math.inf


def in_box(*solids: shapely.Geometry) -> PolygonDomain:
    """Return a box of 2 by 1 with solids."""
    named = tuple((f"solid {n}", solid) for n, solid in enumerate(solids))
    return PolygonDomain((0.0, 0.0), (2.0, 1.0), (False, False), named)


def polygon(*corners: tuple[float, float]) -> shapely.Polygon:
    return shapely.Polygon(corners)


def star(points: int, inner: float, outer: float, turn: float = 0.0) -> shapely.Polygon:
    """Return a star round (1, 0.5), with a point on the right before it is turned [degrees]."""
    angle = math.pi / points * np.arange(2 * points)
    radius = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    corners = np.stack((1.0 + radius * np.cos(angle), 0.5 + radius * np.sin(angle)), axis=1)
    return rotate(shapely.Polygon(corners), turn, origin=(1.0, 0.5))


def wedge(angle: float, length: float, tip: float = 0.0) -> shapely.Polygon:
    """Return a solid on the floor that narrows upwards by an angle [degrees], to a tip [m]."""
    top = 0.5 * tip
    foot = top + length * math.tan(math.radians(0.5 * angle))
    return polygon((1 - foot, 0), (1 + foot, 0), (1 + top, length), (1 - top, length))


def foot(angle: float) -> float:
    """Return how wide a wedge of 0.6 m is at the floor [m]."""
    return 1.2 * math.tan(math.radians(0.5 * angle))


def lens(thickness: float) -> shapely.Polygon:
    """Return what two large discs share: its ends are sharp, and its middle is thick."""
    low, high = (0.5 + sign * (2.0 - 0.5 * thickness) for sign in (-1, 1))
    return shapely.intersection(disc((1.0, low), 2.0), disc((1.0, high), 2.0))


def block_with(hole: shapely.Polygon) -> shapely.Polygon:
    return shapely.difference(shapely.box(0.5, 0.0, 1.5, 0.8), hole)


@pytest.mark.parametrize(
    ("solids", "gap", "solid"),
    [
        pytest.param([disc((1.0, 0.24), 0.2)], 0.04, 0.4, id="circle near a wall"),
        pytest.param(
            [disc((0.6, 0.45), 0.2), disc((0.95, 0.6), 0.15)],
            math.hypot(0.35, 0.15) - 0.35,
            0.3,
            id="two circles",
        ),
        pytest.param([star(4, 0.25, 0.46)], 0.04, 0.5, id="corners near walls"),
        pytest.param(
            [star(5, 0.1, 0.4)],
            0.5 - 0.4 * math.sin(math.radians(72.0)),
            0.2 * math.cos(math.radians(18.0)),
            id="five-pointed star",
        ),
        pytest.param(
            [
                polygon((0.8, 0.0), (1.0, 0.4), (1.2, 0.0)),
                polygon((0.5, 1.0), (1.5, 1.0), (1.5, 0.9), (1.0, 0.5)),
            ],
            0.1,
            NEVER,
            id="corner and corner",
        ),
        pytest.param(
            [
                polygon((0.5, 0.0), (1.5, 0.0), (1.5, 0.48), (0.5, 0.2)),
                polygon((0.5, 1.0), (1.5, 1.0), (1.5, 0.52), (0.5, 0.8)),
            ],
            0.04,
            1.0,
            id="channel that narrows and stays open",
        ),
        pytest.param(
            [shapely.box(0.8, 0.4, 2.0, 1.0)], 0.4, NEVER, id="L-shaped cavity"
        ),
        pytest.param([wedge(60.0, 0.6)], 0.4, NEVER, id="blunt fin"),
        pytest.param([wedge(10.0, 0.6)], 0.4, foot(10.0), id="sharp fin"),
        pytest.param([wedge(10.0, 0.6, 0.02)], 0.4, 0.02, id="fin that is cut off"),
        pytest.param([block_with(wedge(15.0, 0.6))], foot(15.0), 0.2, id="sharp notch"),
        pytest.param([block_with(wedge(15.0, 0.6, 0.02))], 0.02, 0.2, id="notch that is cut off"),
        pytest.param([lens(0.01)], 0.495, 0.01, id="lens"),
        pytest.param([polygon((0.5, 0.2), (1.5, 0.2), (1.0, 0.7))], 0.2, 0.414, id="triangle"),
        pytest.param([block_with(shapely.box(0.8, 0.3, 0.83, 0.8))], 0.03, 0.3, id="slot"),
        pytest.param([disc((1.0, 0.19), 0.2)], 0.61, 0.125, id="circle sunk into the floor"),
    ],
)  # fmt: skip
def test_widths(solids: list[shapely.Geometry], gap: float, solid: float) -> None:
    """Corners have no width of their own; what narrows and stays open does, at any angle."""
    domain = in_box(*solids)
    assert domain.narrowest_gap == pytest.approx(gap, rel=0.06)
    assert domain.thinnest_solid == pytest.approx(solid, rel=0.06)


def test_a_circle_that_touches_a_wall_leaves_no_gap() -> None:
    """Its sides meet the wall at no angle, so that they are no corner."""
    assert in_box(disc((1.0, 0.2), 0.2)).narrowest_gap < 1e-3


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 77.0])
def test_directions_do_not_matter(angle: float) -> None:
    """Of a star beside a bar, in a cell that is periodic."""
    centre = (1.0, 0.5)
    shapes = star(3, 0.06, 0.2), shapely.box(1.25, 0.2, 1.33, 0.8)
    solids = tuple((f"solid {n}", rotate(s, angle, origin=centre)) for n, s in enumerate(shapes))
    domain = PolygonDomain((0.0, -0.5), (2.0, 1.5), (True, True), solids)
    assert domain.narrowest_gap == pytest.approx(0.05, rel=2e-3)
    assert domain.thinnest_solid == pytest.approx(0.08, rel=2e-3)


def test_thousands_of_corners_are_no_hindrance() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 20_000, endpoint=False)
    radius = 0.3 + 0.02 * np.cos(7 * angle)
    corners = np.stack((1.0 + radius * np.cos(angle), 0.5 + radius * np.sin(angle)), axis=1)
    domain = in_box(shapely.Polygon(corners))
    assert 0.18 < domain.narrowest_gap < 0.2
    assert 0.5 < domain.thinnest_solid < 0.64
