"""Boxes, and positions moved into them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sphrom.sph.box_domain import BoxDomain

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


@given(positions)
def test_wrapping_twice_is_wrapping_once(position: np.ndarray) -> None:
    once = BOX.wrap(position)
    apart = np.abs(BOX.wrap(once) - once)
    assert np.max(np.minimum(apart, BOX.lengths - apart)) < 1e-12


def test_what_is_just_below_the_box_does_not_land_on_its_upper_side() -> None:
    unit = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
    assert np.array_equal(unit.wrap(np.array([[-1e-20, -0.0]])), [[0.0, 0.0]])
