"""What a fit says of parameters that the data don't determine."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.fit.fit import _undetermined


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ([0.3, 0.0], ["the data don't determine reynolds within"]),
        ([1.0, 0.0], ["the data don't determine reynolds within"]),
        ([0.5, 0.5], ["a combination of reynolds and lid only"]),
        ([0.0, 0.0], []),
    ],
)
def test_what_data_do_not_determine_is_said(shares, words):
    found = list(_undetermined(("reynolds", "lid"), np.array(shares)))
    assert [said in text for said, text in zip(words, found, strict=True)] == [True] * len(words)
