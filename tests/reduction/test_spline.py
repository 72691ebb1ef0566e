"""Local polyharmonic splines: against scipy, a global system, exact polynomials and derivatives."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from sphrom.reduction.spline import LocalSplines, fit_splines
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]

PERIODIC = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
CLOSED = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
ORDERS = [1, 2, 3, 4, 5, 7]


def jittered(n: int, seed: int = 0, amplitude: float = 0.2) -> Array:
    """Return n x n points of the unit square, off a lattice by a share of its spacing."""
    axis = (np.arange(n) + 0.5) / n
    x, y = np.meshgrid(axis, axis)
    lattice = np.stack((x.ravel(), y.ravel()), axis=1)
    return lattice + np.random.default_rng(seed).uniform(-amplitude, amplitude, (n * n, 2)) / n


def smooth(position: Array) -> Array:
    """Return two periodic functions (n, 2)."""
    x, y = 2.0 * math.pi * position.T
    return np.stack((np.sin(x) * np.cos(y), np.cos(x) + np.sin(y)), axis=1)


def smooth_gradient(position: Array) -> Array:
    """Return their gradients (n, 2, 2)."""
    x, y = 2.0 * math.pi * position.T
    first = np.stack((np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)), axis=1)
    second = np.stack((-np.sin(x), np.cos(y)), axis=1)
    return 2.0 * math.pi * np.stack((first, second), axis=1)


def fit_smooth(n: int = 12, domain: Domain = PERIODIC, **options: float) -> LocalSplines:
    points = jittered(n)
    options = {"cell_width": 3.0 / n, **options}
    return fit_splines(points, smooth(points), domain, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def splines() -> LocalSplines:
    return fit_smooth()


@pytest.fixture(scope="module")
def positions() -> Array:
    return np.random.default_rng(7).random((60, 2))


@pytest.mark.parametrize("domain", [PERIODIC, CLOSED])
@pytest.mark.parametrize("order", ORDERS)
def test_interpolates_the_points(order: int, domain: Domain) -> None:
    points = jittered(8)
    noise = np.random.default_rng(3).standard_normal((64, 3))
    fitted = fit_splines(
        points, noise, domain, order=order, polynomial_degree=order // 2, cell_width=3.0 / 8.0
    )
    # What rounding does to the residual of a linear system.
    rounding = 10.0 * np.finfo(np.float64).eps * np.max(fitted.condition_number)
    np.testing.assert_allclose(fitted.values(points), noise, atol=rounding)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("degree", range(4))
def test_reproduces_polynomials(order: int, degree: int, positions: Array) -> None:
    powers = [(n - m, m) for n in range(degree + 1) for m in range(n + 1)]

    def polynomial(position: Array) -> Array:
        x, y = position.T
        return np.stack([x**a * y**b for a, b in powers], axis=1)

    points = jittered(12)
    fitted = fit_splines(
        points, polynomial(points), CLOSED, order=order, polynomial_degree=degree, cell_width=0.25
    )
    values, gradients = fitted.values_and_gradients(positions)
    np.testing.assert_allclose(values, polynomial(positions), atol=1e-9)
    x, y = positions.T
    along_x = [a * x ** max(a - 1, 0) * y**b for a, b in powers]
    along_y = [b * x**a * y ** max(b - 1, 0) for a, b in powers]
    np.testing.assert_allclose(gradients[..., 0], np.stack(along_x, axis=1), atol=1e-8)
    np.testing.assert_allclose(gradients[..., 1], np.stack(along_y, axis=1), atol=1e-8)


SCIPY_KERNELS = [
    ("linear", 1, -1),
    ("linear", 1, 0),
    ("linear", 1, 1),
    ("cubic", 3, 1),
    ("cubic", 3, 2),
    ("quintic", 5, 2),
    ("thin_plate_spline", 2, 1),
    ("thin_plate_spline", 2, 3),
]


@pytest.mark.parametrize(("kernel", "order", "degree"), SCIPY_KERNELS)
def test_equals_scipy_with_one_system(
    kernel: str, order: int, degree: int, positions: Array
) -> None:
    points = jittered(8)
    noise = np.random.default_rng(3).standard_normal((64, 3))
    ours = fit_splines(points, noise, CLOSED, order=order, polynomial_degree=degree, cell_width=2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a degree below the theory's
        theirs = RBFInterpolator(points, noise, kernel=kernel, degree=degree)
    assert tuple(ours.cell_shape) == (1, 1)
    np.testing.assert_allclose(ours.values(positions), theirs(positions), atol=1e-9)


def test_equals_scipy_cell_by_cell() -> None:
    points = jittered(12)
    noise = np.random.default_rng(3).standard_normal((144, 2))
    ours = fit_splines(points, noise, CLOSED, order=3, cell_width=0.25)
    for low in ([0.0, 0.0], [0.25, 0.5], [0.75, 0.25]):
        corner = np.array(low)
        inside = corner + 0.25 * np.random.default_rng(5).random((10, 2))
        seen = np.all((points >= corner - 0.25) & (points < corner + 0.5), axis=1)
        theirs = RBFInterpolator(points[seen], noise[seen], kernel="cubic", degree=1)
        np.testing.assert_allclose(ours.values(inside), theirs(inside), atol=1e-9)


@pytest.mark.parametrize(
    ("order", "degree", "value_order", "gradient_order"), [(3, 1, 2, 1), (5, 1, 2, 1), (5, 2, 3, 2)]
)
def test_converges(
    order: int, degree: int, value_order: int, gradient_order: int, positions: Array
) -> None:
    """A local spline converges at least as the polynomials that it reproduces."""
    sizes = np.array([10, 20, 40])
    errors = []
    for n in sizes:
        values, gradients = fit_smooth(
            int(n), order=order, polynomial_degree=degree
        ).values_and_gradients(positions)
        errors.append(
            (
                np.sqrt(np.mean((values - smooth(positions)) ** 2)),
                np.sqrt(np.mean((gradients - smooth_gradient(positions)) ** 2)),
            )
        )
    slopes = np.polyfit(np.log(1.0 / sizes), np.log(errors), 1)[0]
    assert slopes[0] > value_order
    assert slopes[1] > gradient_order


@pytest.mark.parametrize("n_cells", [1, 2, 3, 5])
def test_is_periodic_with_any_number_of_cells(n_cells: int, positions: Array) -> None:
    fitted = fit_smooth(10, cell_width=1.0 / n_cells)
    assert tuple(fitted.cell_shape) == (n_cells, n_cells)
    values, gradients = fitted.values_and_gradients(positions)
    for shift in ([1.0, 0.0], [-2.0, 3.0]):
        moved = fitted.values_and_gradients(positions + shift)
        np.testing.assert_allclose(moved[0], values, atol=1e-10)
        np.testing.assert_allclose(moved[1], gradients, atol=1e-9)
    np.testing.assert_allclose(values, smooth(positions), atol=0.02)
    # The images are the points themselves, so nothing changes when the points are shifted too.
    points = jittered(10)
    shifted = fit_splines(points - [1.0, 0.0], smooth(points), PERIODIC, cell_width=1.0 / n_cells)
    np.testing.assert_allclose(shifted.values(positions), values, atol=1e-10)


def test_beyond_a_closed_axis_the_nearest_cell_extrapolates(positions: Array) -> None:
    points = jittered(12)
    fitted = fit_splines(points, points @ [[1.0], [2.0]], CLOSED, cell_width=0.25)
    outside = positions + np.array([0.6, -0.5])
    np.testing.assert_allclose(fitted.values(outside), outside @ [[1.0], [2.0]], atol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 7])
def test_moving_and_scaling_the_box_changes_nothing(order: int, positions: Array) -> None:
    points, size, lower = jittered(12), 1e-3, np.array([-3e-3, 5e-3])
    small = BoxDomain((-3e-3, 5e-3), (-2e-3, 6e-3), (True, True))
    fitted, values = fit_smooth(order=order), smooth(points)
    scaled = fit_splines(lower + size * points, values, small, order=order, cell_width=0.25 * size)
    np.testing.assert_allclose(scaled.condition_number, fitted.condition_number, rtol=1e-4)
    ours = scaled.values_and_gradients(lower + size * positions)
    theirs = fitted.values_and_gradients(positions)
    np.testing.assert_allclose(ours[0], theirs[0], atol=1e-8)
    np.testing.assert_allclose(size * ours[1], theirs[1], atol=1e-7)


def test_condition_number_is_an_estimate_from_below(splines: LocalSplines) -> None:
    start = splines.cell_start
    for cell in range(start.size - 1):
        x, y = splines.points[:, start[cell] : start[cell + 1]]
        distance = np.hypot(x[:, None] - x, y[:, None] - y)
        polynomial = np.stack((np.ones_like(x), x, y), axis=1)
        matrix = np.block([[distance**3, polynomial], [polynomial.T, np.zeros((3, 3))]])
        exact = np.linalg.cond(matrix, 1)
        assert 0.3 * exact < splines.condition_number[cell] < 1.001 * exact


def test_combinations_are_splines_of_the_combined_values(
    splines: LocalSplines, positions: Array
) -> None:
    coefficients = np.array([[1.0, 0.0, 2.0], [0.5, -1.0, 3.0]])
    combined = splines.combine(coefficients)
    values, gradients = splines.values_and_gradients(positions)
    found = combined.values_and_gradients(positions)
    np.testing.assert_allclose(found[0], values @ coefficients, atol=1e-11)
    np.testing.assert_allclose(
        found[1], np.einsum("pcd,cf->pfd", gradients, coefficients), atol=1e-10
    )


def test_is_bitwise_the_same_on_any_number_of_threads_and_in_any_order(
    splines: LocalSplines, positions: Array, same_on_threads
) -> None:
    same_on_threads(lambda: splines.values_and_gradients(positions))
    same_on_threads(lambda: (splines.combine(np.array([[0.3], [-1.7]])).radial_weights,))
    shuffled = np.random.default_rng(0).permutation(60)
    assert np.array_equal(splines.values(positions[shuffled]), splines.values(positions)[shuffled])


def test_bad_data_are_refused() -> None:
    points = jittered(8)
    values = smooth(points)

    def refuse(
        message: str, points: Array, domain: Domain = PERIODIC, width: float = 0.375
    ) -> None:
        with pytest.raises(ValueError, match=message):
            fit_splines(points, values, domain, cell_width=width)

    refuse("use wider cells", points, width=0.01)
    refuse("1 points are not inside", np.where(points == points[5], 1.2, points), CLOSED)
    refuse("they coincide", np.where(points == points[5], points[6], points))
    refuse("lie on one line", points * [1.0, 0.0], CLOSED)


def test_splines_of_the_first_modes_are_those_of_the_whole_basis(settings, positions) -> None:
    whole = settings["periodic"].splines
    first = whole.first(2)
    np.testing.assert_array_equal(first.values(positions), whole.values(positions)[:, :6])
