"""Distances to walls, against a search through points all over the solid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sphrom.metrics.grids import grid_points
from sphrom.scenes.flows import LidDrivenCavity, OpenCavity
from sphrom.sph.box_domain import BoxDomain, Rectangle


@pytest.mark.parametrize("cavity_length", [0.2, 0.36])
def test_fluid_of_an_open_cavity_against_a_search(cavity_length: float) -> None:
    """Behind floors, beside the cavity, and where its image across the seam is nearer; and back."""
    domain = OpenCavity(cavity_length=cavity_length).domain
    around = grid_points((-0.4, -0.1), (0.8, 0.3), (100, 300))
    there = domain.contains(around)
    points = np.random.default_rng(1).uniform((0.0, -0.08), (0.4, 0.28), (500, 2))
    inside = domain.contains(points)
    for some, others in ((points[inside], around[~there]), (points[~inside], around[there])):
        searched = np.linalg.norm(some[:, None] - others, axis=2).min(axis=1)
        found = np.abs(domain.distance_and_normal(some)[0])
        assert np.all(found <= searched)
        assert np.all(found >= searched - 0.004)
        assert found.max() > 0.04


DOMAINS = {
    "box": LidDrivenCavity(2.0, 1.0).domain,
    "channel": BoxDomain((0.0, 0.0), (1.0, 2.0), (True, False)),
    "cavity": OpenCavity().domain,
}


@pytest.mark.parametrize("name", DOMAINS)
def test_signed_distance_grows_along_the_normal(name: str) -> None:
    domain = DOMAINS[name]
    random = np.random.default_rng(2)
    low, high = np.array(domain.lower), np.array(domain.upper)
    points = random.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (400, 2))
    distance, normal = domain.distance_and_normal(points)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    np.testing.assert_array_equal(distance >= 0.0, domain.contains(points))
    np.testing.assert_array_equal(np.maximum(distance, 0.0), domain.wall_distance(points))
    feet = points - distance[:, None] * normal
    np.testing.assert_allclose(domain.distance_and_normal(feet)[0], 0.0, atol=1e-12)


def test_normals_on_walls_and_corners() -> None:
    points = np.array([[1.0, 0.0], [2.0, 1.0], [2.0, 2.0]])
    distance, normal = DOMAINS["box"].distance_and_normal(points)
    assert not distance.any()
    half = np.sqrt(0.5)
    np.testing.assert_allclose(normal, [[0.0, 1.0], [-1.0, 0.0], [-half, -half]], atol=1e-12)


def test_nothing_is_near_in_a_periodic_box() -> None:
    box = BoxDomain((0.0, 0.0), (1.0, 2.0), (True, True))
    distance, normal = box.distance_and_normal(np.array([[0.2, 0.3]]))
    assert np.isposinf(distance).all()
    assert not normal.any()


def test_solid_between_fluid_and_fluid() -> None:
    """Beside the cavity, between it and its image; and a floor between two channels."""
    assert OpenCavity(cavity_length=0.3).domain.thinnest_solid == pytest.approx(0.1)
    assert np.isinf(DOMAINS["box"].thinnest_solid)
    halves = Rectangle((0.0, 0.0), (1.0, 0.4)), Rectangle((0.0, 0.5), (1.0, 1.0))
    apart = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, False), halves)
    assert apart.thinnest_solid == pytest.approx(0.1)
    assert apart.narrowest_gap == pytest.approx(0.4)


@pytest.mark.parametrize("name", DOMAINS)
def test_counts_are_those_of_what_is_there(name: str) -> None:
    domain = DOMAINS[name]
    assert domain.fits_lattice(0.02)
    assert domain.n_particles(0.02) == len(domain.fill(0.02))
    assert domain.n_ghosts(0.02, 4) == len(domain.ghosts(0.02, 4).position)
    assert domain.area == pytest.approx(domain.n_particles(0.02) * 0.02**2)


def test_ghosts_know_their_walls() -> None:
    """Beyond the corners of a box they are the side walls'; within it the solid's."""
    box, cavity = DOMAINS["box"], DOMAINS["cavity"]
    assert box.wall_names == ("left", "right", "bottom", "top")
    assert cavity.wall_names == ("bottom", "top", "solid")
    for domain, place, expected in (
        (box, (-0.05, 2.05), "left"),
        (box, (1.95, 2.05), "top"),
        (box, (2.05, 0.05), "right"),
        (cavity, (0.03, 0.09), "solid"),
        (cavity, (0.21, -0.01), "bottom"),
    ):
        ghosts = domain.ghosts(0.02 if domain is cavity else 0.1, 4)
        nearest = np.linalg.norm(ghosts.position - place, axis=1).argmin()
        assert np.linalg.norm(ghosts.position[nearest] - place) < 1e-9
        assert domain.wall_names[ghosts.wall[nearest]] == expected


BOX = BoxDomain((-0.3, 2.0), (0.4, 2.5), (True, True))
positions = arrays(
    np.float64, st.tuples(st.integers(1, 20), st.just(2)), elements=st.floats(-50.0, 50.0)
)


@given(positions)
def test_wrapped_positions_are_inside_whole_turns_away(position: np.ndarray) -> None:
    before = position.copy()
    wrapped = BOX.wrap(position)
    assert np.all(wrapped >= BOX.lower)
    assert np.all(wrapped < np.array(BOX.upper) + 1e-15)
    turns = (wrapped - position) / BOX.lengths
    assert np.max(np.abs(turns - np.round(turns))) < 1e-12
    assert np.array_equal(position, before)


def test_what_is_just_below_the_box_does_not_land_on_its_upper_side() -> None:
    unit = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
    assert np.array_equal(unit.wrap(np.array([[-1e-20, -0.0]])), [[0.0, 0.0]])
