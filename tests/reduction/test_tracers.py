"""Particles that a reduced run carries along."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.online.tracers import modal_flow, path_lines
from sphrom.reduction.spline import fit_splines
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain

BOX = BoxDomain((-1.0, -1.0), (1.0, 1.0), (False, False))
SPACING = 0.125


def splines_of(domain: Domain, *flows):
    """Return splines of modes without density, from their velocities."""
    points = domain.fill(SPACING)
    columns = [np.column_stack((np.zeros(len(points)), flow(points))) for flow in flows]
    return fit_splines(points, np.hstack(columns), domain, cell_width=3.0 * SPACING)


def turning(position: np.ndarray) -> np.ndarray:
    """Turn about the origin once in 2 pi seconds."""
    return np.column_stack((-position[:, 1], position[:, 0]))


def along(direction):
    return lambda position: np.broadcast_to(np.array(direction, dtype=float), position.shape)


def paths(flow, start, time, steps=4, domain=BOX):
    return np.array(list(path_lines(flow, np.asarray(start, dtype=float), time, steps, domain)))


def test_a_particle_follows_the_path_line_of_a_steady_vortex():
    time = np.linspace(0.0, 2.0 * np.pi, 17)
    flow = modal_flow(splines_of(BOX, turning), time, np.ones((len(time), 1)))
    found = paths(flow, [[0.6, 0.0], [0.0, -0.3]], time, steps=16)
    exact = np.stack((np.cos(time), np.sin(time)), axis=1)
    np.testing.assert_allclose(found[:, 0], 0.6 * exact, atol=2e-6)
    np.testing.assert_allclose(found[:, 1], 0.3 * exact[:, ::-1] * [1, -1], atol=2e-6)


def test_steps_are_of_fourth_order():
    time = np.linspace(0.0, 2.0, 3)
    exact = 0.6 * np.array([np.cos(2.0), np.sin(2.0)])
    errors = [
        np.linalg.norm(paths(lambda x, t: turning(x), [[0.6, 0.0]], time, steps)[-1, 0] - exact)
        for steps in (4, 8)
    ]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)


def test_a_flow_changes_with_its_coordinates_and_its_mean():
    """Of two modes along x and y, and a mean along x; cubic coordinates are followed exactly."""
    time = np.linspace(0.5, 1.5, 6)
    coordinates = np.stack((0.3 * time**3, -0.4 * time), axis=1)
    splines = splines_of(BOX, along((1, 0)), along((0, 1)), along((-0.5, 0)))
    flow = modal_flow(splines, time, coordinates)
    np.testing.assert_allclose(flow(np.zeros((2, 2)), 0.77), [[0.3 * 0.77**3 - 0.5, -0.308]] * 2)
    (found,) = paths(flow, [[0.1, 0.2]], time)[-1]
    moved = 0.3 / 4.0 * (1.5**4 - 0.5**4) - 0.5, -0.2 * (1.5**2 - 0.5**2)
    np.testing.assert_allclose(found, np.array([0.1, 0.2]) + moved, atol=1e-12)


def test_walls_are_not_crossed_but_followed():
    """Over a step in the floor, against it, and out of the box."""
    domain = BoxDomain(
        (0.0, 0.0),
        (2.0, 1.0),
        (False, False),
        (Rectangle((0.0, 0.5), (2.0, 1.0)), Rectangle((1.0, 0.0), (2.0, 0.5))),
    )
    time = np.linspace(0.0, 3.0, 31)
    flow = modal_flow(splines_of(domain, along((0.2, -0.3))), time, np.ones((31, 1)))
    start = np.array([[0.3, 0.55], [1.2, 0.9], [1.9, 0.6]])
    found = paths(flow, start, time, domain=domain)
    for position in found:
        assert domain.contains(position).all()
    np.testing.assert_allclose(found[1:, :, 0].max(axis=0), [0.9, 1.8, 2.0], atol=0.01)
    # The first slides along the step's top, the second falls to the floor, the third to its corner.
    np.testing.assert_allclose(found[-1, :, 1], [0.5, 0.0, 0.0], atol=0.01)


def test_a_particle_that_leaves_a_periodic_box_comes_back():
    domain = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
    time = np.linspace(0.0, 1.0, 5)
    found = paths(lambda x, t: along((1.3, 0.0))(x), [[0.9, 0.5]], time, domain=domain)
    np.testing.assert_allclose(found[:, 0, 0], (0.9 + 1.3 * time) % 1.0)


def test_a_run_without_splines_there_leaves_particles_where_they_are():
    """Deep in a solid there is no spline; a substep that looks there sees no flow."""
    solid = BoxDomain((0.0, 0.0), (4.0, 1.0), (False, False), (Rectangle((0.0, 0.0), (1.0, 1.0)),))
    flow = modal_flow(splines_of(solid, along((1, 0))), np.arange(2.0), np.ones((2, 1)))
    assert np.array_equal(flow(np.array([[3.5, 0.5]]), 0.0), [[0.0, 0.0]])
    found = paths(flow, [[0.9, 0.5]], np.arange(2.0), 1, solid)
    np.testing.assert_array_equal(found[-1], [[0.9, 0.5]])
