"""Local splines at walls and around solids: one-sided cells, cells without points, errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sphrom.reduction.spline import (
    LocalSplines,
    cell_grid,
    default_cell_width,
    fit_splines,
    fluid_share,
)
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]

BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
CHANNEL, CAVITY = Rectangle((0.0, 0.1), (0.4, 0.2)), Rectangle((0.1, 0.0), (0.3, 0.1))
UNION = BoxDomain((0.0, 0.0), (0.4, 0.2), (True, False), (CHANNEL, CAVITY))
SPACING = {BOX: 1.0 / 40.0, UNION: 0.005}


def layered(domain: Domain, position: Array) -> Array:
    """Return a field (n, 1) with layers of four spacings at the domain's upper wall, periodic."""
    x, y = position.T
    layer = np.exp((y - domain.upper[1]) / (4.0 * SPACING[domain]))
    return (np.sin(2.0 * np.pi * (x - domain.lower[0]) / domain.lengths[0] + 1.0) + layer)[:, None]


def fit(domain: Domain, degree: int = 3) -> LocalSplines:
    points = domain.fill(SPACING[domain])
    return fit_splines(
        points,
        layered(domain, points),
        domain,
        polynomial_degree=degree,
        cell_width=default_cell_width(domain, len(points)),
    )


def positions(domain: Domain, seed: int = 0, n: int = 20_000) -> Array:
    """Return positions in the fluid, up to its walls."""
    box = np.random.default_rng(seed).random((n, 2)) * domain.lengths + domain.lower
    return box[domain.contains(box)]


def root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def near_and_far(domain: Domain, at: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which positions lie between walls and the points next to them, and which far off."""
    distance = domain.wall_distance(at)
    return distance < 0.5 * SPACING[domain], distance > 8.0 * SPACING[domain]


@pytest.mark.parametrize("domain", [BOX, UNION], ids=["box", "union"])
def test_a_cubic_polynomial_serves_walls_as_a_linear_one_serves_the_interior(
    domain: Domain,
) -> None:
    """Measured here: 20 to 40 times less at walls, values and gradients alike."""
    at = positions(domain)
    near, far = near_and_far(domain, at)
    errors = {
        degree: np.abs(fit(domain, degree).values(at) - layered(domain, at)) for degree in (1, 3)
    }
    assert root_mean_square(errors[1][near]) > 20.0 * root_mean_square(errors[1][far])
    assert root_mean_square(errors[3][near]) < 0.15 * root_mean_square(errors[1][near])
    assert root_mean_square(errors[3][near]) < 3e-3


@pytest.mark.parametrize("domain", [BOX, UNION], ids=["box", "union"])
def test_noise_is_not_amplified_at_walls(domain: Domain) -> None:
    points = domain.fill(SPACING[domain])
    noise = np.random.default_rng(1).standard_normal((len(points), 8))
    width = default_cell_width(domain, len(points))
    fitted = fit_splines(points, noise, domain, polynomial_degree=3, cell_width=width)
    at = positions(domain, n=6000)
    near, far = near_and_far(domain, at)
    values, gradients = fitted.values_and_gradients(at)
    assert root_mean_square(values[near]) < 1.6 * root_mean_square(values[far])
    assert root_mean_square(gradients[near]) < 1.6 * root_mean_square(gradients[far])


def test_cubic_polynomials_are_exact_in_every_corner_of_the_fluid() -> None:
    """Cells that straddle a wall, and those with a sliver of fluid and no point, among them."""
    closed = BoxDomain(UNION.lower, UNION.upper, (False, False), UNION.rectangles)
    points = closed.fill(SPACING[UNION])

    def cubic(position: Array) -> Array:
        x, y = position.T / 0.1
        return np.stack((x**3 - 2.0 * x * y * y + y, x * x * y - 1.0), axis=1)

    fitted = fit_splines(points, cubic(points), closed, polynomial_degree=3, cell_width=0.0125)
    assert np.sum(np.diff(fitted.cell_start) == 0) > 0
    corners = np.array([[0.1, 0.1], [0.3, 0.1], [0.1, 0.0], [0.3, 0.0], [0.0, 0.1], [0.4, 0.2]])
    # Particles may be a little beyond a wall while a step is taken.
    around = corners[:, None] + np.linspace(-0.002, 0.002, 5)[:, None]
    at = np.concatenate((positions(closed), around.reshape(-1, 2)))
    np.testing.assert_allclose(fitted.values(at), cubic(at), atol=1e-8)


def test_a_sliver_of_fluid_without_points_is_served_by_the_cell_beside_it() -> None:
    # Cells of 0.25; the last tenth of a spacing of the fluid reaches into the third column.
    domain = BoxDomain(
        (0.0, 0.0), (1.0, 1.0), (False, False), (Rectangle((0.0, 0.0), (0.505, 1.0)),)
    )
    points = BoxDomain((0.0, 0.0), (0.5, 1.0), (False, False)).fill(0.05)
    noise = np.random.default_rng(2).standard_normal((len(points), 3))
    fitted = fit_splines(points, noise, domain, cell_width=0.25)
    assert tuple(fitted.cell_shape) == (4, 4)
    edge = np.stack((np.full(20, 0.5), np.linspace(0.02, 0.98, 20)), axis=1)
    step = np.array([1e-9, 0.0])
    np.testing.assert_allclose(fitted.values(edge + step), fitted.values(edge - step), atol=1e-6)
    seen = np.diff(fitted.cell_start).reshape(4, 4)
    assert np.array_equal(seen[:, 2], seen[:, 1])
    assert not seen[:, 3].any()


def test_inside_a_solid_there_is_no_spline() -> None:
    fitted = fit(UNION)
    empty = np.diff(fitted.cell_start) == 0
    grid = cell_grid(UNION, fitted.cell_shape)
    assert empty.any()
    assert not fluid_share(grid, UNION)[empty].any()
    assert not fitted.condition_number[empty].any()
    assert fitted.condition_number[~empty].min() >= 1.0
    solid = np.array([[0.03, 0.03], [0.37, 0.05]])
    values, gradients = fitted.values_and_gradients(solid)
    assert np.isnan(values).all()
    assert np.isnan(gradients).all()
    assert np.isnan(fitted.values(solid)).all()
    assert np.isnan(fitted.combine(np.ones((1, 2))).values(solid)).all()
    assert np.isfinite(fitted.values(positions(UNION))).all()


def test_a_solid_at_a_periodic_edge_borrows_from_beyond_it() -> None:
    """Just beyond the wall at x = 1 begins the solid at x = 0, whose cell extrapolates from 1."""
    domain = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, False), (Rectangle((0.3, 0.0), (1.0, 1.0)),))
    points = domain.fill(0.05)
    fitted = fit_splines(points, points[:, :1], domain, cell_width=0.25)
    at = np.array([[0.01, 0.5], [0.99, 0.5], [1.01, 0.5], [0.31, 0.5]])
    np.testing.assert_allclose(fitted.values(at)[:, 0], [1.01, 0.99, 1.01, 0.31], atol=1e-9)
