"""Distances to solids, and shifting velocities that let no particle through."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sphrom.kernels import rectangles
from sphrom.kernels.sweeps import SHIFT_V, U, V, X, Y
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain

CLOSEST, TOUCHING, FELT = 0.25, 0.5, 1.5
"""In spacings, which are the unit of length here."""
BOX = BoxDomain((0.0, 0.0), (12.0, 10.0), (False, False))
CAVITY = BoxDomain(
    (0.0, 0.0),
    (16.0, 12.0),
    (True, False),
    rectangles=(Rectangle((0.0, 6.0), (16.0, 12.0)), Rectangle((4.0, 0.0), (12.0, 6.0))),
)
CORNERS = {
    "concave": (BOX, (0.0, 0.0)),
    "concave, opposite": (BOX, (12.0, 10.0)),
    "convex": (CAVITY, (4.0, 6.0)),
    "convex, opposite": (CAVITY, (12.0, 6.0)),
    "floor at the seam": (CAVITY, (0.0, 6.0)),
    "ceiling over the corner": (CAVITY, (4.0, 12.0)),
    "foot of the cavity": (CAVITY, (12.0, 0.0)),
}
component = st.floats(-2.0, 2.0, allow_subnormal=False)
pair = st.tuples(component, component)
# As often among those that are held back as beyond.
near = st.one_of(component, st.floats(-0.3, 0.3))
places = st.tuples(near, near)


def rows(domain: Domain) -> np.ndarray:
    return np.array([(*solid.lower, *solid.upper) for solid in domain.solids])


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
    limits = CLOSEST, TOUCHING, FELT
    rectangles.hold_back(particle, particle, target, rows(domain), *limits, against, out)
    return out


def ways(domain: Domain, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (n,) and direction (n, 2) of every solid from one point."""
    solid = rows(domain)
    way = np.clip(position, solid[:, :2], solid[:, 2:]) - position
    distance = np.linalg.norm(way, axis=1)
    return distance, way / np.where(distance > 0.0, distance, 1.0)[:, None]


@pytest.mark.parametrize("domain", [BOX, CAVITY], ids=["box", "cavity"])
def test_distances_are_those_to_the_nearest_wall(domain: Domain) -> None:
    """Of every second source only, in the order of the targets."""
    random = np.random.default_rng(0)
    position = random.uniform(domain.lower, domain.upper, (400, 2))
    position = position[domain.contains(position)].T
    target = np.full((Y + 1, position.shape[1]), np.nan)
    target[X], target[Y] = position
    targets = np.arange(position.shape[1])[::-2].copy()
    out = np.full(targets.size, np.nan)
    rectangles.wall_distances(targets, target, rows(domain), out)
    np.testing.assert_allclose(out, domain.wall_distance(position.T)[targets], atol=1e-14)


def test_distances_past_the_seam_are_those_of_the_image() -> None:
    """A particle may have left the box along its periodic axis since its list was built."""
    position = np.array([[-0.3, 16.25, 16.0], [6.4, 11.9, 6.1]])
    out = np.empty(3)
    rectangles.wall_distances(np.arange(3), position, rows(CAVITY), out)
    np.testing.assert_allclose(out, [0.4, 0.1, 0.1], atol=1e-14)


@pytest.mark.parametrize("name", CORNERS)
@given(place=places, velocity=pair, shifting=pair)
def test_nothing_moves_towards_a_wall_that_is_close(
    name: str, place: tuple, velocity: tuple, shifting: tuple
) -> None:
    """With u + delta u no particle comes nearer to a wall at a quarter of a spacing or less."""
    domain, corner = CORNERS[name]
    position = np.add(corner, place)
    assume(domain.contains(position[None])[0])
    u, du = np.array([velocity]).T, np.array([shifting]).T
    after = held(domain, position[:, None], u, du)
    total = (u + after)[:, 0]
    for distance, way in zip(*ways(domain, position), strict=True):
        if 0.0 < distance <= CLOSEST:
            assert total @ way <= 1e-12
        if 0.0 < distance <= TOUCHING:
            assert after[:, 0] @ way <= 1e-12
        if distance < FELT:
            assert after[:, 0] @ way <= max(du[:, 0] @ way, 0.0) + 1e-12


@pytest.mark.parametrize("name", CORNERS)
@given(place=places, shifting=pair, velocity=pair)
def test_shifting_is_only_ever_turned_away_from_walls(
    name: str, place: tuple, shifting: tuple, velocity: tuple
) -> None:
    """What is left alone: particles beyond 1.5 spacings, and those that move away from walls."""
    domain, corner = CORNERS[name]
    position = np.add(corner, place)
    assume(domain.contains(position[None])[0])
    u, du = np.array([velocity]).T, np.array([shifting]).T
    change = (held(domain, position[:, None], u, du) - du)[:, 0]
    distance, way = ways(domain, position)
    felt = way[(distance > 0.0) & (distance < FELT)]
    if np.all(felt @ du[:, 0] <= 0.0) and np.all(felt @ u[:, 0] <= 0.0):
        assert not change.any()
    assert np.all(felt @ change <= 1e-12)
    if not change.any():
        return
    # A sum of pushes away from the walls that are felt.
    push, *_ = np.linalg.lstsq(-felt.T, change, rcond=None)
    assert np.allclose(-felt.T @ push, change, atol=1e-12)
    if len(felt) <= 2:
        assert np.all(push >= -1e-12)


@given(
    across=st.floats(0.01, 2.0),
    along=st.floats(-1.0, 17.0),
    speed=component,
    shift=component,
)
def test_flow_along_a_ceiling_is_left_alone(
    across: float, along: float, speed: float, shift: float
) -> None:
    """All along it, over the corners of the cavity and across the seam: it has no corner."""
    position = np.array([[along], [12.0 - across]])
    u, du = np.array([[speed], [0.0]]), np.array([[shift], [0.0]])
    assert np.array_equal(held(CAVITY, position, u, du), du)


def test_pushes_fade_between_the_second_layer_and_the_first() -> None:
    """Straight at a floor: all beyond 1.5 spacings, half at 1, none at 0.5."""
    distance = np.array([2.0, 1.5, 1.0, 0.75, 0.5, 0.1])
    position = np.stack((np.full(6, 6.0), distance))
    pushed = np.tile([[0.3], [-0.8]], (1, 6))
    after = held(BOX, position, np.zeros((2, 6)), pushed)
    assert after[0] == pytest.approx(pushed[0])
    assert after[1] == pytest.approx(-0.8 * np.array([1.0, 1.0, 0.5, 0.25, 0.0, 0.0]))


def test_velocity_across_is_taken_back_from_the_first_layer_on() -> None:
    """Straight at a floor: nothing at 0.5 spacings, half at 0.375, all of it at 0.25."""
    distance = np.array([0.6, 0.5, 0.375, 0.25, 0.1])
    position = np.stack((np.full(5, 6.0), distance))
    velocity = np.tile([[0.4], [-1.0]], (1, 5))
    after = held(BOX, position, velocity, np.zeros((2, 5)))
    assert not after[0].any()
    assert after[1] == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])


def test_what_has_left_is_not_touched() -> None:
    """Within the solid there is no way to the wall: the run stops such a particle, not this."""
    position = np.array([[-0.5, 6.0], [5.0, 10.2]])
    shifting = np.array([[-1.0, 0.3], [0.2, 2.0]])
    assert np.array_equal(held(BOX, position, shifting, shifting), shifting)
