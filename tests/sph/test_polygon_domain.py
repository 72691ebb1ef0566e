"""Domains with walls of any shape: what is fluid, how far walls are, what is behind them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate

from sphrom.scenes.flows import OpenCavity
from sphrom.sph.fluid import Discretization
from sphrom.sph.packing import pack
from sphrom.sph.polygon_domain import PolygonDomain, ghost_rows
from sphrom.sph.polygons import disc, jutting_corners

FIN = shapely.Polygon([(0.9, 0.0), (1.1, 0.0), (1.0, 0.5)])
"""Its tip has 23 degrees."""
TURN = math.radians(17.0)
DOMAINS = {
    "disc": PolygonDomain((0.0, 0.0), (1.0, 1.0), (True, True), (("disc", disc((0.5, 0.4), 0.3)),)),
    "across the seam": PolygonDomain(
        (-1.0, 2.0), (0.0, 3.0), (True, True), (("disc", disc((-0.1, 2.95), 0.25)),)
    ),
    "fin": PolygonDomain((0.0, 0.0), (2.0, 1.0), (True, False), (("fin", FIN),)),
    "turned square": PolygonDomain(
        (0.0, 0.0),
        (2.0, 1.0),
        (False, False),
        (
            ("square", rotate(shapely.box(0.6, 0.4, 1.0, 0.7), TURN, use_radians=True)),
            ("other", disc((1.5, 0.5), 0.2)),
        ),
    ),
    "ring": PolygonDomain(
        (-1.1, -1.1),
        (1.1, 1.1),
        (False, False),
        (
            ("inner", disc((0.0, 0.0), 0.5)),
            ("outer", shapely.difference(shapely.box(-1.2, -1.2, 1.2, 1.2), disc((0.0, 0.0), 1.0))),
        ),
    ),
}
SPACING = 0.025


def solid_with_images(domain: PolygonDomain) -> shapely.Geometry:
    """Return all that is solid in the box and around it."""
    width, height = domain.lengths
    turns = [range(-2, 3) if periodic else (0,) for periodic in domain.periodic]
    parts = [
        translate(shape, i * width, j * height)
        for _, shape in domain.solids
        for i in turns[0]
        for j in turns[1]
    ]
    (left, low), (right, high) = domain.lower, domain.upper
    if not domain.periodic[0]:
        parts += [shapely.box(left - 9, -99, left, 99), shapely.box(right, -99, right + 9, 99)]
    if not domain.periodic[1]:
        parts += [shapely.box(-99, low - 9, 99, low), shapely.box(-99, high, 99, high + 9)]
    return shapely.union_all(parts)


@pytest.mark.parametrize("name", DOMAINS)
def test_distances_are_those_to_the_solid(name: str) -> None:
    domain = DOMAINS[name]
    low, high = np.array(domain.lower), np.array(domain.upper)
    position = np.random.default_rng(0).uniform(low - 0.3, high + 0.3, (3000, 2))
    wrapped = domain.wrap(position)
    solid, points = solid_with_images(domain), shapely.points(wrapped)
    inside = shapely.intersects(solid, points)
    away = shapely.distance(solid.boundary, points)
    distance, normal = domain.distance_and_normal(position)
    # Beyond the walls of a box the solid has no other end than ours.
    known = (np.all((wrapped >= low) & (wrapped <= high), axis=1)) | (distance > -0.1)
    np.testing.assert_allclose(distance[known], np.where(inside, -away, away)[known], atol=1e-9)
    np.testing.assert_array_equal(domain.contains(position), ~inside)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    np.testing.assert_allclose(domain.wall_distance(domain.on_wall(position)), 0.0, atol=1e-9)


@pytest.mark.parametrize("name", DOMAINS)
def test_area_shares_and_sections_agree(name: str) -> None:
    domain = DOMAINS[name]
    edges = [
        np.linspace(low, high, 41) for low, high in zip(domain.lower, domain.upper, strict=True)
    ]
    share = domain.fluid_share(edges)
    assert share.shape == (40, 40)
    assert share.mean() * math.prod(domain.lengths) == pytest.approx(domain.area)
    middles = 0.5 * (edges[0][1:] + edges[0][:-1])
    for column, x in enumerate(middles):
        lengths = [high - low for low, high in domain.sections(x)]
        assert sum(lengths) == pytest.approx(
            share[:, column].sum() * np.diff(edges[1])[0], abs=0.04
        )
        for low, high in domain.sections(x):
            place = np.array([(x, low), (x, 0.5 * (low + high)), (x, high)])
            distance = domain.distance_and_normal(place)[0]
            assert distance[1] > 0.0
            ends = np.isclose(place[[0, 2], 1], (domain.lower[1], domain.upper[1]))
            assert np.all(ends | (np.abs(distance[[0, 2]]) < 1e-9))


def test_the_open_cavity_is_the_same_in_polygons() -> None:
    """Walls along the axes: distances, ghosts and widths are those of rectangles."""
    box = OpenCavity().domain
    steps = ("left", shapely.box(0.0, 0.0, 0.1, 0.1)), ("right", shapely.box(0.3, 0.0, 0.4, 0.1))
    with pytest.raises(ValueError, match="name is taken"):
        PolygonDomain(box.lower, box.upper, box.periodic, steps)
    steps = tuple((f"{name} step", shape) for name, shape in steps)
    domain = PolygonDomain(box.lower, box.upper, box.periodic, steps)
    assert domain.wall_names == ("bottom", "top", "left step", "right step")
    position = np.random.default_rng(1).uniform((-0.2, -0.03), (0.6, 0.23), (1000, 2))
    distances = (each.distance_and_normal(position)[0] for each in (domain, box))
    np.testing.assert_allclose(*distances, atol=1e-12)
    assert domain.area == pytest.approx(box.area)
    np.testing.assert_array_equal(domain.contains(position), box.contains(position))
    for x in (0.25, 0.1, 0.02):
        np.testing.assert_allclose(domain.sections(x), box.sections(x), atol=1e-12)
    assert domain.thinnest_solid == pytest.approx(box.thinnest_solid)
    assert domain.narrowest_gap == pytest.approx(box.narrowest_gap)
    ghosts, theirs = (d.ghosts(0.01, 4).position for d in (domain, box))
    assert on_lattice(ghosts) == on_lattice(theirs)
    assert on_lattice(domain.fill(0.01)) == on_lattice(box.fill(0.01))


def on_lattice(position: np.ndarray) -> set[tuple[int, ...]]:
    """Return points in half spacings of 0.005 m, moved into one period of 0.4 m."""
    place = np.round(position / 0.005, 6)
    assert not (place % 1).any()
    return {(int(x) % 80, int(y)) for x, y in place}


def test_ghosts_and_walls_know_their_names() -> None:
    domain = DOMAINS["turned square"]
    names = domain.wall_names
    assert names == ("left", "right", "bottom", "top", "square", "other")
    position = np.array(
        [(0.01, 0.5), (1.9, 0.03), (0.8, 0.95), (1.5, 0.4), (0.7, 0.5), (2.05, 0.5)]
    )
    found = [names[i] for i in domain.nearest_wall(position)]
    assert found == ["left", "bottom", "top", "other", "square", "right"]
    ghosts = domain.ghosts(SPACING, 4)
    inside_other = np.linalg.norm(ghosts.position - (1.5, 0.5), axis=1) < 0.2
    assert {names[i] for i in ghosts.wall[inside_other]} == {"other"}
    assert set(ghosts.wall) == set(range(6))


def test_two_solids_that_touch_are_two_walls() -> None:
    halves = ("floor", shapely.box(0, 0, 2, 0.1)), ("lid", shapely.box(0, 0.1, 2, 0.2))
    domain = PolygonDomain((0.0, 0.0), (2.0, 1.0), (True, True), halves)
    position = np.array([(0.3, 0.95), (0.3, 0.3), (0.3, 0.15), (1.9, 0.05)])
    assert [domain.wall_names[i] for i in domain.nearest_wall(position)] == [
        "floor", "lid", "lid", "floor",
    ]  # fmt: skip
    assert domain.thinnest_solid == pytest.approx(0.2)
    assert domain.narrowest_gap == pytest.approx(0.8)


@pytest.mark.parametrize("name", DOMAINS)
def test_fluid_and_ghosts_have_their_areas(name: str) -> None:
    """As many particles as fill the fluid, half a spacing from walls; rows of ghosts behind."""
    domain = DOMAINS[name]
    points, ghosts = domain.fill(SPACING), domain.ghosts(SPACING, 4)
    assert len(points) == domain.n_particles(SPACING) == round(domain.area / SPACING**2)
    assert domain.wall_distance(points).min() > 0.49 * SPACING or name == "fin"
    assert domain.wall_distance(points).min() > 0.3 * SPACING
    assert len(ghosts.position) == domain.n_ghosts(SPACING, 4)
    depth = -domain.distance_and_normal(ghosts.position)[0] / SPACING
    # Along a convex wall of many corners rows lie a little deeper than the corners do.
    assert np.mean(np.abs(depth - np.rint(depth + 0.5) + 0.5) < 0.01) > 0.9
    assert depth.min() > 0.49
    band = shapely.buffer(domain.fluid_with_images, 4 * SPACING, join_style="mitre")
    beyond = np.where(domain.periodic, 0.0, 1.0)
    frame = shapely.box(*np.subtract(domain.lower, beyond), *np.add(domain.upper, beyond))
    area = shapely.area(shapely.intersection(band, frame)) - domain.area
    assert len(ghosts.position) * SPACING**2 == pytest.approx(area, rel=0.03)


@pytest.mark.parametrize(("name", "unevenness"), [("disc", 0.01), ("ring", 0.01), ("fin", 0.03)])
def test_packed_beside_walls_kernels_are_complete(
    brute_force: type, name: str, unevenness: float
) -> None:
    """Fluid and ghosts together: the kernel sums up to 1, and its gradient to nearly nothing.

    Measured: within 0.7 % beside discs and flat walls, and 2.5 % at the tip of the fin.
    """
    domain, ratio = DOMAINS[name], 2.0
    discretization = Discretization(SPACING, ratio * SPACING)
    ghosts = domain.ghosts(SPACING, 4).position
    packing = pack(domain, discretization, ghosts=ghosts, perturbation=0.3, tolerance=5e-4)
    assert packing.residual[-1] <= 5e-4
    assert domain.contains(packing.position).all()
    near = packing.position[domain.wall_distance(packing.position) < 4 * SPACING]
    everything = np.concatenate((packing.position, ghosts))
    sums = brute_force(everything, domain.lengths, domain.periodic, ratio * SPACING, SPACING)
    distance = np.linalg.norm(sums.offsets(near), axis=2)
    total = sums.kernel(distance).sum(axis=1) * SPACING**2
    assert np.abs(total - 1.0).max() < unevenness


@pytest.mark.parametrize(
    ("solids", "message"),
    [
        ([("a", shapely.box(3, 3, 4, 4))], "solid a: no part of it is in the box"),
        ([("a", shapely.Polygon())], "solid a: no part of it is in the box"),
        ([("top", shapely.box(0.2, 0.2, 0.4, 0.4))], "solid top: the name is taken"),
        (
            [("a", shapely.box(0.2, 0.2, 0.6, 0.6)), ("b", shapely.box(0.5, 0.5, 0.8, 0.8))],
            "solids a and b overlap by 0.01 m2",
        ),
        ([("a", shapely.box(-1, -1, 2, 2))], "the solids leave nothing for the fluid"),
    ],
)
def test_solids_that_make_no_sense_are_refused(solids: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PolygonDomain((0.0, 0.0), (1.0, 1.0), (True, False), tuple(solids))


def test_rounding_leaves_no_corners_in_straight_walls() -> None:
    """Images of an oblique wall overlap, and solids touch: edges are one but for rounding."""
    turn = math.radians(30.0)
    along, across = np.array((math.cos(turn), math.sin(turn))), np.array((-0.5, math.cos(turn)))
    ends = np.array([[-4.0], [4.0]]) * along
    period = 1.5 / math.cos(turn)

    def band(low: float, high: float) -> shapely.Polygon:
        return shapely.Polygon([*(ends + low * across), *(ends[::-1] + high * across)])

    domain = PolygonDomain(
        (0.0, 0.0),
        (period / math.tan(turn), period),
        (True, True),
        (("floor", band(-0.25, 0.0)), ("lid", band(-0.5, -0.25))),
    )
    segments = domain.outline.lists[0]
    assert np.hypot(*(segments[:, 2:4] - segments[:, :2]).T).min() > 0.01
    place = domain.ghosts(0.05, 4).position
    turns, height = np.divmod(place @ across, 1.5)
    length = place @ along - turns * period * math.sin(turn)
    rows = np.rint((height - 1.0) / 0.05 - 0.5)
    assert set(rows) == set(range(10)) - {4, 5}
    for row in set(rows):
        beside = np.sort(np.mod(length[rows == row], 2.0 * period))
        assert np.diff(beside).min() > 0.9 * 0.05
        assert np.diff(beside).max() < 1.2 * 0.05


def test_rows_behind_a_half_disc_are_even_from_corner_to_corner() -> None:
    """Behind the straight side, at a depth of half a spacing, corners are a metre apart."""
    half = shapely.intersection(disc((0.0, 0.0), 0.45), shapely.box(-1.0, 0.0, 1.0, 1.0))
    place = ghost_rows(half, shapely.box(-2.0, -2.0, 2.0, 2.0), 0.1, 1)
    below = place[place[:, 1] < -0.0499]
    assert below[:, 1] == pytest.approx(np.full(11, -0.05), abs=1e-9)
    assert np.sort(below[:, 0]) == pytest.approx(np.linspace(-0.5, 0.5, 11), abs=1e-3)


JAGGED = [(1.0 + 0.01 * ((k + 1) // 2), 1.0 + 0.01 * (k // 2)) for k in range(100)]
"""A slope in steps of a tenth of the spacing: it turns at its upper end alone."""


@pytest.mark.parametrize(
    ("solid", "sharpness"),
    [
        (shapely.box(1, 1, 2, 2).segmentize(0.3), 1.0),
        (shapely.box(1, 1, 2, 2).buffer(-0.01).buffer(0.01), 0.9),
        (shapely.Point(1.5, 1.5).buffer(1.0, quad_segs=2), math.tan(math.pi / 8.0) ** 2),
        (shapely.LineString([(1, 1), (2, 2)]).buffer(0.001, cap_style="flat"), 3.0),
        (disc((1.5, 1.5), 0.4), 0.0),
        (
            shapely.Polygon([*JAGGED, (1.5, 5.0), (-2.0, 5.0), (-2.0, -2.0), (1.0, -2.0)]),
            math.tan(math.pi / 8.0) ** 2,
        ),
    ],
)
def test_corners_that_jut_into_the_fluid(solid: shapely.Geometry, sharpness: float) -> None:
    """At a spacing of 0.1 fine rounding hardly matters, and a thin plate ends in tips."""
    place, found = jutting_corners(shapely.difference(shapely.box(-2, -2, 5, 5), solid), 0.1)
    assert found.max(initial=0.0) == pytest.approx(sharpness, abs=0.02)
    assert np.max(shapely.distance(solid.exterior, shapely.points(place)), initial=0.0) < 1e-12
