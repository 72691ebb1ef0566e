"""B-splines on a lattice: against scipy, exact polynomials, orders of convergence, walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.ndimage import map_coordinates

from sphrom.reduction.lattice_splines import fit_lattice_splines
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]

PERIODIC = BoxDomain((-1.0, 0.5), (1.0, 2.0), (True, True))
CHANNEL = BoxDomain((-1.0, 0.5), (1.0, 2.0), (True, False))
CLOSED = BoxDomain((-1.0, 0.5), (1.0, 2.0), (False, False))
DOMAINS = pytest.mark.parametrize(
    "domain", [PERIODIC, CHANNEL, CLOSED], ids=["periodic", "channel", "closed"]
)


def smooth(domain: Domain, position: Array) -> Array:
    """Return two functions (n, 2), periodic where the domain is."""
    x, y = (position - domain.lower).T / np.array(domain.lengths)[:, None]
    x, y = 2.0 * math.pi * x, (2.0 if domain.periodic[1] else 1.3) * math.pi * y
    x = x if domain.periodic[0] else 0.7 * x
    return np.stack((np.sin(x + 0.3) * np.cos(y), np.cos(x) + np.sin(y + 1.0)), axis=1)


def smooth_gradient(domain: Domain, position: Array) -> Array:
    """Return their gradients (n, 2, 2), by central differences of fourth order."""
    step = 1e-3
    gradients = []
    for axis in np.eye(2):
        near, far = (
            smooth(domain, position + s * step * axis) - smooth(domain, position - s * step * axis)
            for s in (1, 2)
        )
        gradients.append((8.0 * near - far) / (12.0 * step))
    return np.stack(gradients, axis=2)


def places(domain: Domain, n: int = 500, seed: int = 3) -> Array:
    """Return positions (n, 2) up to the domain's edges."""
    return domain.lower + np.random.default_rng(seed).random((n, 2)) * domain.lengths


def noise(domain: Domain, n: int, n_columns: int = 5) -> tuple[Array, Array]:
    """Return points and values of no smoothness at all."""
    points = domain.fill(domain.lengths[1] / n)
    return points, np.random.default_rng(n).standard_normal((len(points), n_columns))


@DOMAINS
def test_goes_through_the_points_in_any_order(domain: Domain) -> None:
    points, values = noise(domain, 12)
    order = np.random.default_rng(0).permutation(len(points))
    fitted = fit_lattice_splines(points[order], values[order], domain)
    assert tuple(fitted.lattice_shape) == (16, 12)
    np.testing.assert_allclose(fitted.values(points), values, atol=1e-13)


@DOMAINS
def test_orders_of_convergence(domain: Domain) -> None:
    """Fourth in values and third in gradients, up to the walls."""
    at, sizes = places(domain), (15, 30, 60, 120)
    # Where errors are largest, at walls, few would be: half of the positions are put there.
    at[::4, 0], at[1::4, 1] = domain.lower[0], domain.upper[1]
    exact, slope = smooth(domain, at), smooth_gradient(domain, at)
    values, gradients = [], []
    for n in sizes:
        points = domain.fill(domain.lengths[1] / n)
        fitted = fit_lattice_splines(points, smooth(domain, points), domain)
        value, gradient = fitted.values_and_gradients(at)
        values.append(float(np.max(np.abs(value - exact))))
        gradients.append(float(np.max(np.abs(gradient - slope))))
    orders = [-np.polyfit(np.log(sizes), np.log(errors), 1)[0] for errors in (values, gradients)]
    assert orders[0] == pytest.approx(4.0, abs=0.3)
    assert orders[1] == pytest.approx(3.0, abs=0.3)


def test_cubics_are_exact_up_to_and_beyond_walls() -> None:
    powers = [(i, j) for i in range(4) for j in range(4)]
    points = CLOSED.fill(1.5 / 9)
    at = 1.05 * places(CLOSED) - 0.05

    def columns(position: Array) -> Array:
        return np.stack([position[:, 0] ** i * position[:, 1] ** j for i, j in powers], axis=1)

    fitted = fit_lattice_splines(points, columns(points), CLOSED)
    value, gradient = fitted.values_and_gradients(at)
    np.testing.assert_allclose(value, columns(at), atol=1e-11)
    x, y = at.T
    exact = [
        np.stack((i * x ** max(i - 1, 0) * y**j, j * x**i * y ** max(j - 1, 0)), axis=1)
        for i, j in powers
    ]
    np.testing.assert_allclose(gradient, np.stack(exact, axis=1), atol=1e-10)


def test_equals_scipy_in_a_closed_box() -> None:
    """Inside the outermost points, with its not-a-knot ends; beyond them, one row at a time."""
    points, values = noise(CLOSED, 12, n_columns=1)
    fitted = fit_lattice_splines(points, values, CLOSED)
    x, y = np.unique(points[:, 0]), np.unique(points[:, 1])
    table = values.reshape(12, 16)
    inside = np.random.default_rng(1).uniform((x[0], y[0]), (x[-1], y[-1]), (300, 2))
    theirs = RectBivariateSpline(y, x, table)
    value, gradient = fitted.values_and_gradients(inside)
    np.testing.assert_allclose(value[:, 0], theirs.ev(inside[:, 1], inside[:, 0]), atol=1e-12)
    slope = theirs.ev(inside[:, 1], inside[:, 0], dy=1)
    np.testing.assert_allclose(gradient[:, 0, 0], slope, atol=1e-10)
    along = np.linspace(CLOSED.lower[0], CLOSED.upper[0], 101)
    row = np.stack((along, np.full(101, y[4])), axis=1)
    expected = CubicSpline(x, table[4])(along)
    np.testing.assert_allclose(fitted.values(row)[:, 0], expected, atol=1e-12)


def test_equals_scipy_in_a_periodic_box() -> None:
    points, values = noise(PERIODIC, 12, n_columns=1)
    fitted = fit_lattice_splines(points, values, PERIODIC)
    at = np.concatenate((places(PERIODIC), np.add(places(PERIODIC), (-4.0, 4.5))))
    place = (at - PERIODIC.lower) / (1.5 / 12) - 0.5
    expected = map_coordinates(values.reshape(12, 16), place.T[::-1], order=3, mode="grid-wrap")
    np.testing.assert_allclose(fitted.values(at)[:, 0], expected, atol=1e-11)
    seam = points[0] - [0.0, 1e-17]
    np.testing.assert_allclose(fitted.values(seam[None]), values[:1], atol=1e-12)


def test_noise_at_walls_is_amplified_a_little() -> None:
    points, values = noise(CLOSED, 30, n_columns=20)
    at = places(CLOSED, 4000)
    fitted = fit_lattice_splines(points, values, CLOSED).values(at)
    at_wall = np.min(np.abs(at[:, :1] - [CLOSED.lower[0], CLOSED.upper[0]]), axis=1) < 0.025
    assert float(np.std(fitted[at_wall])) < 2.5
    assert float(np.std(fitted[~at_wall])) < 1.3


def test_combinations_and_selections() -> None:
    points, values = noise(CHANNEL, 9)
    fitted, at = fit_lattice_splines(points, values, CHANNEL), places(CHANNEL, 50)
    factors = np.random.default_rng(5).standard_normal((5, 3))
    combined = fitted.combine(factors)
    assert combined.n_columns == 3
    np.testing.assert_allclose(combined.values(at), fitted.values(at) @ factors, atol=1e-12)
    assert np.array_equal(fitted.first(1).values(at), fitted.values(at)[:, :3])


def test_results_are_the_same_on_any_number_of_threads(same_on_threads) -> None:
    points, values = noise(CHANNEL, 21)
    fitted, at = fit_lattice_splines(points, values, CHANNEL), places(CHANNEL, 5000)
    same_on_threads(lambda: (fitted.values(at), *fitted.values_and_gradients(at)))


def test_points_off_a_lattice_are_refused() -> None:
    points, values = noise(PERIODIC, 9)
    moved = points.copy()
    moved[3, 0] += 1e-4
    twice = points.copy()
    twice[3] = twice[4]
    for bad in (moved, twice, points + np.array((0.05, 0.0))):
        with pytest.raises(ValueError, match="points on a lattice"):
            fit_lattice_splines(bad, values, PERIODIC)
    with pytest.raises(ValueError, match="points on a lattice"):
        fit_lattice_splines(points[1:], values[1:], PERIODIC)
