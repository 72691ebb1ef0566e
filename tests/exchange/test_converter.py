"""Which axes of a file the plane of the flow has."""

from __future__ import annotations

import pytest

from sphrom.exchange.converter import Components


@pytest.mark.parametrize(
    ("names", "plane"),
    [
        (("x", "y"), (0, 1, 2)),
        (("x", "z"), (0, 2, 1)),
        (("Points.y", "Points.z"), (1, 2, 0)),
        (("x", "x"), (0, 1, 2)),
        (("east", "north"), (0, 1, 2)),
    ],
)
def test_a_plane_is_named_by_its_axes(names: tuple[str, str], plane: tuple[int, int, int]) -> None:
    assert Components(names).plane == plane
