"""Periodic images and the list of sources, against all images of all particles."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sphrom.errors import UnstableError
from sphrom.kernels.cells import range_in_row, rows_within
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import MOVE_RATIO, Neighbourhood, periodic_images, sort_sources

PERIODIC = BoxDomain((0, 0), (1, 1), (True, True))
shares = arrays(
    np.float64, st.tuples(st.just(2), st.integers(1, 15)), elements=st.floats(-2.0, 3.0, width=32)
)
axes = st.tuples(st.booleans(), st.booleans())


def all_images(position: np.ndarray, domain: Domain, margin: float) -> set[tuple[int, ...]]:
    """Return every image within the margin: the particle and its place in rounded units."""
    inside = domain.wrap(position.T)
    turns = [range(-4, 5) if periodic else (0,) for periodic in domain.periodic]
    out = set()
    for turn in itertools.product(*turns):
        moved = inside + np.array(turn) * domain.lengths
        low = np.array([*domain.lower]) - margin
        high = np.array([*domain.upper]) + margin
        near = np.ones(len(moved), bool)
        for axis in range(2):
            if domain.periodic[axis]:
                near &= (moved[:, axis] >= low[axis]) & (moved[:, axis] < high[axis])
        out |= {(int(i), *turn) for i in np.flatnonzero(near)}
    return out


@given(shares, axes, st.floats(0.05, 2.5))
def test_every_image_within_the_margin_is_a_source_once(position, periodic, margin) -> None:
    domain = BoxDomain((0.0, -0.25), (1.0, 0.5), periodic)
    particle, image = periodic_images(position, domain, margin)
    first = domain.wrap(position.T).T - position
    assert np.array_equal(particle[: position.shape[1]], np.arange(position.shape[1]))
    assert np.array_equal(image[:, : position.shape[1]], first)
    turns = np.round((image - first[:, particle]) / np.array(domain.lengths)[:, None]).astype(int)
    found = [(int(i), *map(int, turn)) for i, turn in zip(particle, turns.T, strict=True)]
    assert len(found) == len(set(found))
    # Where rounding puts an image onto the margin itself, either answer is right.
    for sign, compare in ((1e-9, set.issubset), (-1e-9, set.issuperset)):
        assert compare(set(found), all_images(position, domain, margin + sign))


@given(shares, axes, st.floats(0.2, 0.7))
def test_every_neighbour_is_a_candidate_once(position, periodic, support) -> None:
    domain = BoxDomain((0.0, -0.25), (1.0, 0.5), periodic)
    near = sort_sources(position, domain, support, 0.1)
    x, y = position[:, near.particle] + near.image
    assert sorted(near.particle[near.targets]) == list(range(position.shape[1]))
    inside = domain.wrap(position.T).T
    assert np.array_equal(np.stack((x, y))[:, near.targets], inside[:, near.particle[near.targets]])
    for j in near.targets:
        search = near.search(support, 0.1)
        first, last = rows_within(y[j], y[j], search)
        ranges = [range_in_row(x[j], y[j], row, search) for row in range(first, last)]
        candidates = [k for low, high in ranges for k in range(low, high)]
        assert len(candidates) == len(set(candidates))
        within = np.flatnonzero(np.hypot(x - x[j], y - y[j]) < support * (1.0 - 1e-9))
        assert set(within) <= set(candidates)


def test_the_list_is_kept_until_some_particle_has_moved_far() -> None:
    spacing = 0.1
    random = np.random.default_rng(0)
    position = random.uniform(0.0, 1.0, (2, 100))
    neighbourhood = Neighbourhood(PERIODIC, Discretization(spacing, 0.2), n_fields=2)
    neighbourhood.update(position)
    built = neighbourhood.sources
    assert neighbourhood.reach == pytest.approx(0.4)
    moved = position.copy()
    moved[0, 5] += 0.9 * MOVE_RATIO * spacing
    neighbourhood.update(moved)
    assert neighbourhood.sources is built
    assert neighbourhood.reach == pytest.approx(0.4 + 0.9 * MOVE_RATIO * spacing)
    moved[0, 5] += 0.2 * MOVE_RATIO * spacing
    neighbourhood.update(moved)
    assert neighbourhood.sources is not built
    assert neighbourhood.reach == pytest.approx(0.4)
    built = neighbourhood.sources
    neighbourhood.rebuild_at(None)
    neighbourhood.update(moved)
    assert neighbourhood.sources is not built


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [0, 1])
def test_the_list_holds_what_may_come_near_across_a_periodic_edge(axis: int, side: int) -> None:
    """A particle at the edge, and one whose image lies just beyond what both may move."""
    support, limit = 0.2, MOVE_RATIO * 0.1
    outward = (-1.0, 1.0)[side]
    apart = support + 1.999 * limit
    position = np.full((2, 2), 0.5)
    position[axis] = [float(side) - 1e-9 * outward, side - outward + outward * apart]
    neighbourhood = Neighbourhood(PERIODIC, Discretization(0.1, support / 2), n_fields=2)
    neighbourhood.update(position)
    built = neighbourhood.sources
    moved = position.copy()
    moved[axis] += 0.9999 * limit * outward * np.array([1.0, -1.0])
    neighbourhood.update(moved)
    assert neighbourhood.sources is built
    places = (moved[:, built.particle] + built.image)[:, built.particle == 1]
    assert np.min(np.abs(places[axis] - moved[axis, 0])) < support


def test_another_number_of_particles_builds_the_list_anew() -> None:
    neighbourhood = Neighbourhood(PERIODIC, Discretization(0.1, 0.2), n_fields=2)
    neighbourhood.update(np.full((2, 3), 0.5))
    neighbourhood.update(np.full((2, 4), 0.5))
    assert neighbourhood.sources.targets.size == 4


def test_particles_that_no_list_can_cover_are_named():
    """Beyond walls there are no images: cells up to such a particle could take all memory."""
    box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, False))
    near = Neighbourhood(box, Discretization(0.05, 0.05), n_fields=2)
    position = np.array([[0.5, 0.2, 0.7], [0.5, 1e12, -3.0]])
    with pytest.raises(
        UnstableError, match=r"particle 1 at \(0\.2, 1e\+12\) m .* beyond the reach"
    ):
        near.update(position)
    near.update(np.array([[1e3, -1e3], [0.5, 1.01]]))  # a periodic axis has no beyond
    with pytest.raises(UnstableError, match=r"particle 2 at \(nan"):
        near.update(np.array([[0.5, 0.2, np.nan], [0.5, 0.5, 0.5]]))


def test_a_list_is_built_again_as_it_was():
    rng = np.random.default_rng(0)
    box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
    first, second = (Neighbourhood(box, Discretization(0.05, 0.1), n_fields=2) for _ in range(2))
    position = rng.random((2, 300))
    first.update(position)
    moved = position + 0.002 * rng.standard_normal(position.shape)
    first.update(moved)
    second.rebuild_at(first.built_at)
    second.update(moved)
    assert second.reach == first.reach
    for name in ("particle", "image", "targets", "cell_start"):
        np.testing.assert_array_equal(getattr(second.sources, name), getattr(first.sources, name))
    second.rebuild_at(None)
    assert second.built_at is None
