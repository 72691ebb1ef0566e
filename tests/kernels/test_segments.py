"""Distances from walls of any shape, and shifting velocities that let no particle through."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from sphrom.kernels.sweeps import SHIFT_V, U, V, X, Y
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain, WallSearch
from sphrom.sph.polygon_domain import PolygonDomain, chain, list_by_cell, nearest_segments

LIMITS = 0.25, 0.5, 1.5
"""Closest, touching and felt, in spacings, which are the unit of length here."""
STAR = np.array([(0, 0), (4, 1), (9, 0), (6, 4), (9, 9), (5, 6), (2, 10), (3, 5), (-2, 4)], float)
"""Fluid within corners of many angles, counter-clockwise."""
CAVITY = BoxDomain(
    (0.0, 0.0),
    (16.0, 12.0),
    (True, False),
    (Rectangle((0.0, 6.0), (16.0, 12.0)), Rectangle((4.0, 0.0), (12.0, 6.0))),
)
AS_POLYGON = PolygonDomain(
    CAVITY.lower,
    CAVITY.upper,
    CAVITY.periodic,
    (("left step", shapely.box(0, 0, 4, 6)), ("right step", shapely.box(12, 0, 16, 6))),
)
"""The same, its solid in two pieces that meet at the seam."""
component = st.floats(-2.0, 2.0, allow_subnormal=False)
pair = st.tuples(component, component)


def listed(corners: np.ndarray, cell_width: float, reach: float = 0.0) -> WallSearch:
    box = np.array([-4.0, -2.0]), np.array([11.0, 12.0])
    return list_by_cell(chain(corners), *box, cell_width, reach)


@pytest.mark.parametrize("cell_width", [0.3, 2.0, 50.0])
def test_signed_distances_are_those_to_the_nearest_edge(cell_width: float) -> None:
    """In cells, and beyond all cells; the normal is the distance's gradient."""
    walls, polygon = listed(STAR, cell_width), shapely.Polygon(STAR)
    position = np.random.default_rng(0).uniform(-8.0, 16.0, (2000, 2))
    distance, normal, nearest = nearest_segments(position, walls)
    points = shapely.points(position)
    sign = np.where(shapely.contains(polygon, points), 1.0, -1.0)
    expected = sign * shapely.distance(polygon.exterior, points)
    np.testing.assert_allclose(distance, expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    foot = shapely.points(position - distance[:, None] * normal)
    np.testing.assert_allclose(shapely.distance(polygon.exterior, foot), 0.0, atol=1e-12)
    edges = shapely.linestrings(np.stack((STAR, np.roll(STAR, -1, axis=0)), axis=1))
    np.testing.assert_allclose(shapely.distance(edges[nearest], foot), 0.0, atol=1e-12)


def test_a_point_on_a_wall_has_its_normal() -> None:
    square = listed(np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]), 1.0)
    distance, normal, _ = nearest_segments(np.array([[1.0, 0.0], [2.0, 1.5]]), square)
    np.testing.assert_allclose(distance, 0.0, atol=1e-15)
    np.testing.assert_allclose(normal, [[0.0, 1.0], [-1.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize("reach", [0.0, 1.0])
def test_lists_are_complete_and_short(reach: float) -> None:
    segments, found, start, grid = listed(STAR, 0.5, reach).lists
    edges = shapely.linestrings(segments[:, :4].reshape(-1, 2, 2))
    for point in np.random.default_rng(1).uniform((-4, -2), (11, 12), (200, 2)):
        column = int((point[0] - grid.x_origin) / grid.cell_width)
        cell = int((point[1] - grid.y_origin) / grid.cell_height) * grid.n_columns + column
        here = set(found[start[cell] : start[cell + 1]])
        distance = shapely.distance(edges, shapely.points(point))
        assert set(np.flatnonzero(distance <= reach)) | {int(distance.argmin())} <= here
    assert len(found) < 3.5 * grid.n_columns * grid.n_rows


def held(
    domain: Domain,
    position: np.ndarray,
    velocity: np.ndarray,
    shifting: np.ndarray,
    against: float = 1.0,
) -> np.ndarray:
    """Return what is left of shifting velocities (2, n_particles)."""
    target = np.full((SHIFT_V + 1, position.shape[1]), np.nan)
    target[X], target[Y] = position
    target[U], target[V] = velocity
    particle = np.arange(position.shape[1])
    out = shifting.copy()
    domain.wall_search(1.0).hold_back(particle, particle, target, LIMITS, out, against)
    return out


def test_axis_parallel_walls_are_as_rectangles() -> None:
    """Distances everywhere; shifting wherever no two walls are near, where their order matters."""
    random = np.random.default_rng(3)
    position = random.uniform(CAVITY.lower, CAVITY.upper, (3000, 2))
    position = np.ascontiguousarray(position[CAVITY.contains(position)].T)
    targets = np.arange(position.shape[1])
    found, expected = (
        d.wall_search(1.0).distances(targets, position) for d in (AS_POLYGON, CAVITY)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    velocity, shifting = random.uniform(-1.0, 1.0, (2, *position.shape))
    one, other = (held(d, position, velocity, shifting) for d in (AS_POLYGON, CAVITY))
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert np.abs(one - shifting).max() > 0.5


def test_limiting_shifting_alone_leaves_the_velocity_out() -> None:
    random = np.random.default_rng(4)
    position = random.uniform(CAVITY.lower, CAVITY.upper, (300, 2))
    position = np.ascontiguousarray(position[CAVITY.contains(position)].T)
    velocity, shifting = random.uniform(-1.0, 1.0, (2, *position.shape))
    limited = held(AS_POLYGON, position, velocity, shifting, against=0.0)
    assert np.array_equal(limited, held(AS_POLYGON, position, 0.0 * velocity, shifting))
    assert not np.array_equal(limited, held(AS_POLYGON, position, velocity, shifting))


@pytest.mark.parametrize("angle", [20.0, 50.0, 90.0, 140.0])
@given(away=st.floats(0.2, 8.0), share=st.floats(0.02, 0.98), velocity=pair, shifting=pair)
def test_nothing_moves_towards_walls_that_meet_at_any_angle(
    angle: float, away: float, share: float, velocity: tuple, shifting: tuple
) -> None:
    """With u + delta u no particle comes nearer to a wall at a quarter of a spacing or less."""
    turn = math.radians(angle)
    ways = np.array([(0.0, -1.0), (-math.sin(turn), math.cos(turn))])
    position = away * np.array((math.cos(share * turn), math.sin(share * turn)))
    u, du = np.array([velocity]).T, np.array([shifting]).T
    after = held(wedge(angle), position[:, None], u, du)[:, 0]
    size = 1e-2 * (np.abs(u).sum() + np.abs(du).sum())
    for way in ways:
        distance = -position @ way
        if distance <= LIMITS[0] and (away > 0.5 or angle < 90.0):
            assert (u[:, 0] + after) @ way <= size
        if distance <= LIMITS[1] and angle < 90.0:
            assert after @ way <= size


@cache
def wedge(angle: float) -> PolygonDomain:
    """Return fluid between two walls that meet at an angle [degrees] in the origin."""
    turn = math.radians(angle)
    end = (60.0 * math.cos(turn), 60.0 * math.sin(turn))
    fluid = shapely.Polygon([(0, 0), (60, 0), (60, 60), end])
    solid = shapely.difference(shapely.box(-60, -60, 60, 60), fluid)
    return PolygonDomain((-40.0, -40.0), (40.0, 40.0), (False, False), (("wedge", solid),))
