"""Distances to walls, against a search through points all over the solid."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.probes import grid_points
from sphrom.scenes.lid_driven_cavity import LidDrivenCavity
from sphrom.scenes.open_cavity import OpenCavity
from sphrom.sph.domain import Domain
from sphrom.sph.wall_distance import fluid_distance, wall_distance


def test_closed_box() -> None:
    box = LidDrivenCavity(2.0, 1.0).domain
    points = np.array([[0.25, 1.0], [1.0, 1.9], [1.0, 1.0], [1.5, 0.3], [2.0, 1.0], [2.5, 1.0]])
    np.testing.assert_allclose(wall_distance(box, points), [0.25, 0.1, 1.0, 0.3, 0.0, 0.0])


def test_nothing_bounds_a_periodic_box() -> None:
    box = Domain((0.0, 0.0), (1.0, 2.0), (True, True))
    assert np.all(np.isinf(wall_distance(box, np.array([[0.0, 0.0], [0.5, 1.0]]))))


def test_corners_and_images() -> None:
    """Near a corner that juts into the fluid the corner is nearest; so it may be as an image."""
    domain = OpenCavity(cavity_length=0.36).domain
    points = np.array([[0.05, 0.1], [0.4, 0.13], [0.0, 0.13], [0.2, 0.1], [0.2, 0.03]])
    expected = [0.03, 0.03, 0.03, 0.1, 0.03]
    np.testing.assert_allclose(wall_distance(domain, points), expected, atol=1e-12)
    corner = np.array([[0.02 + 0.03, 0.1 + 0.04]])
    np.testing.assert_allclose(wall_distance(domain, corner), 0.05)


@pytest.mark.parametrize("cavity_length", [0.2, 0.36])
def test_open_cavity_against_a_search(cavity_length: float) -> None:
    domain = OpenCavity(cavity_length=cavity_length).domain
    spacing = 0.004
    around = grid_points((-0.4, -0.1), (0.8, 0.3), (100, 300))
    solid = around[~domain.contains(around)]
    points = np.random.default_rng(0).uniform((0.0, 0.0), (0.4, 0.2), (200, 2))
    points = points[domain.contains(points)]
    searched = np.linalg.norm(points[:, None] - solid, axis=2).min(axis=1)
    found = wall_distance(domain, points)
    assert np.all(found <= searched)
    assert np.all(found >= searched - spacing)


def test_fluid_beside_a_closed_box() -> None:
    """Straight behind a wall, behind a corner, and within."""
    box = LidDrivenCavity(2.0, 1.0).domain
    points = np.array([[-0.25, 1.0], [1.0, 2.1], [2.3, 2.4], [-0.3, -0.4], [1.0, 1.0], [2.0, 0.0]])
    np.testing.assert_allclose(fluid_distance(box, points), [0.25, 0.1, 0.5, 0.5, 0.0, 0.0])


def test_fluid_along_a_periodic_axis_has_no_end() -> None:
    channel = Domain((0.0, 0.0), (1.0, 2.0), (True, False))
    points = np.array([[0.5, -0.3], [1.7, -0.3], [-0.01, 2.2], [7.0, 1.0]])
    np.testing.assert_allclose(fluid_distance(channel, points), [0.3, 0.3, 0.2, 0.0], atol=1e-12)


@pytest.mark.parametrize("cavity_length", [0.2, 0.36])
def test_fluid_of_an_open_cavity_against_a_search(cavity_length: float) -> None:
    """Behind floors, beside the cavity, and where its image across the seam is nearer."""
    domain = OpenCavity(cavity_length=cavity_length).domain
    spacing = 0.004
    around = grid_points((-0.4, -0.1), (0.8, 0.3), (100, 300))
    fluid = around[domain.contains(around) & (around[:, 1] > 0.0) & (around[:, 1] < 0.2)]
    points = np.random.default_rng(1).uniform((0.0, -0.08), (0.4, 0.28), (300, 2))
    points = points[~domain.contains(points)]
    searched = np.linalg.norm(points[:, None] - fluid, axis=2).min(axis=1)
    found = fluid_distance(domain, points)
    assert np.all(found <= searched)
    assert np.all(found >= searched - spacing)
    assert found.max() > 0.05
