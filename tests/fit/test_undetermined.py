"""Parameters, and combinations of some, that data don't determine, in words."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.fit.estimates import _undetermined
from sphrom.fit.model import Box

BOX = Box({"reynolds": 50.0, "lid": 0.5}, {"reynolds": 200.0, "lid": 1.0}, {})


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_one_alone_is_undetermined_itself(share: float) -> None:
    shares = np.array([share, 0.0])
    found = list(_undetermined(BOX, np.array([0.5, 0.5]), np.diag(shares), shares))
    assert found == ["the data don't determine reynolds within its range"]


def test_of_two_that_share_a_direction_a_combination_is_determined() -> None:
    projection = np.full((2, 2), 0.5)
    found = list(_undetermined(BOX, np.array([0.5, 0.5]), projection, np.diag(projection)))
    assert len(found) == 1
    assert found[0].startswith("the data determine a combination of reynolds and lid only")


def test_of_all_that_data_determine_nothing_is_said() -> None:
    assert not list(_undetermined(BOX, np.array([0.5, 0.5]), np.zeros((2, 2)), np.zeros(2)))
