"""The map onto fixed points: what it keeps, what it loses, what it refuses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.reduction.reference_space import ReferenceMap, relative_error
from sphrom.scenes.taylor_green import TaylorGreen
from sphrom.sph.domain import Domain
from sphrom.sph.packing import lattice

SPACING = 1.0 / 32.0
BOX = Domain((0.0, 0.0), (1.0, 1.0), (True, True))
FLOW = TaylorGreen(1.0, 1.0, 1000.0, 0.01)


def attenuation(method: str, ratio: float, position: np.ndarray) -> tuple[float, float]:
    """Return the relative L2 errors of velocity and pressure, of the vortex on a lattice."""
    points = lattice(BOX, SPACING)
    to_reference = ReferenceMap(
        points, BOX, particle_spacing=SPACING, smoothing_length=ratio * SPACING, method=method
    )
    pressure, velocity = to_reference(
        position, FLOW.pressure(position, 0.0), FLOW.velocity(position, 0.0)
    )
    return (
        relative_error(velocity, FLOW.velocity(points, 0.0)),
        relative_error(pressure, FLOW.pressure(points, 0.0)),
    )


@pytest.mark.parametrize("ratio", [2.0, 4.0])
def test_shepard_attenuates_by_the_kernels_second_moment(ratio: float) -> None:
    """A wave of wave vector k loses (5/36) h^2 k^2, as far as this is small."""
    position = lattice(BOX, SPACING) + 0.37 * SPACING
    velocity, pressure = attenuation("shepard", ratio, position)
    # |k|^2 is 2 kappa^2 for the velocity, and 4 kappa^2 for the pressure.
    loss = 5.0 / 36.0 * (ratio * SPACING * FLOW.wave_number) ** 2
    assert velocity == pytest.approx(2.0 * loss, rel=0.1)
    assert pressure == pytest.approx(4.0 * loss, rel=0.2)


def test_moving_least_squares_hardly_attenuate(scatter: Callable) -> None:
    """Measured on these sets: 0.24 % of velocity at h = 2 dx, where Shepard loses 2.1 and more."""
    position = scatter((0.0, 0.0), SPACING, (32, 32), "jittered", seed=1)[:2].T
    velocity, pressure = attenuation("mls", 2.0, position)
    shepard = attenuation("shepard", 2.0, position)
    assert velocity < 0.004
    assert pressure < 0.02
    assert velocity < 0.2 * shepard[0]


def test_error_of_moving_least_squares_falls_faster_than_the_second_order() -> None:
    """On even particles the odd terms cancel: fourth order."""
    errors = []
    for count in (16, 32, 64):
        points = lattice(BOX, 1.0 / count)
        to_reference = ReferenceMap(
            points, BOX, particle_spacing=1.0 / count, smoothing_length=2.0 / count
        )
        position = points + 0.3 / count
        velocity = to_reference(position, np.zeros(len(points)), FLOW.velocity(position, 0.0))[1]
        errors.append(relative_error(velocity, FLOW.velocity(points, 0.0)))
    order = -np.polyfit(np.log([16, 32, 64]), np.log(errors), 1)[0]
    assert order > 2.5


@pytest.mark.parametrize("method", ["shepard", "mls"])
def test_equals_the_sums_over_all_particles(
    brute_force: type, scatter: Callable, method: str
) -> None:
    state = scatter((0.0, 0.0), 0.0625, (16, 16), "jittered", seed=2)
    points = np.random.default_rng(3).uniform(-2.0, 3.0, (60, 2))
    sums = brute_force(state[:2].T, (1.0, 1.0), (True, True), 0.125, 0.0625)
    expected = sums.shepard if method == "shepard" else sums.moving_least_squares
    to_reference = ReferenceMap(
        points, BOX, particle_spacing=0.0625, smoothing_length=0.125, method=method
    )
    density, velocity = to_reference(state[:2].T, state[2], state[3:].T)
    assert velocity.shape == (60, 2)
    for field, mapped in zip(state[2:], (density, *velocity.T), strict=True):
        assert np.max(np.abs(mapped - expected(points, field))) < 1e-10


def test_a_place_without_particles_is_named() -> None:
    half = Domain((0.0, 0.0), (1.0, 1.0), (False, False))
    to_reference = ReferenceMap(
        np.array([[0.2, 0.2], [0.9, 0.25]]), half, particle_spacing=0.05, smoothing_length=0.1
    )
    position = lattice(Domain((0.0, 0.0), (0.5, 0.5), (False, False)), 0.05)
    with pytest.raises(ValueError, match=r"0\.2 m of the point \(0\.9, 0\.25\)"):
        to_reference(position, np.zeros(len(position)), np.zeros_like(position))


def test_unknown_methods_are_refused() -> None:
    with pytest.raises(ValueError, match="shepard"):
        ReferenceMap(np.zeros((1, 2)), BOX, particle_spacing=1, smoothing_length=1, method="rbf")


def test_relative_error() -> None:
    assert relative_error(np.array([1.0, 1.0]), np.array([1.0, 0.0])) == pytest.approx(1.0)
    assert relative_error(np.array([3.0, 4.0]), np.zeros(2)) == pytest.approx(5.0)
