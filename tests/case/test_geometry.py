"""What of a scene has to fit the lattice that it starts from."""

from __future__ import annotations

import pytest

from sphrom.case.geometry import nearest_fitting_resolution
from sphrom.case.models import Case


@pytest.mark.parametrize(
    ("resolution", "nearest"), [(40, 40), (41, 40), (42, 44), (43, 44), (45, 44), (47, 48)]
)
def test_the_nearest_resolution_that_fits_may_be_coarser_or_finer(
    resolution: int, nearest: int
) -> None:
    """Walls of the open cavity lie at quarters of the channel's length."""
    case = Case.model_construct(
        scene=Case.model_validate({"name": "x", "scene": {"kind": "open-cavity"}}).scene,
        discretization=type("Section", (), {"resolution": resolution}),
    )
    assert nearest_fitting_resolution(case) == nearest
