"""Measurements in generalized coordinates, against those of the fields that they mean."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.measures import Quantities
from sphrom.reduction.reduced_measures import project_measures
from sphrom.reduction.trial_basis import reconstruct

MEAN = 0.3
NAMES = ["lid", "lid with its mean", "raw", "raw and forced"]


def weighed(density: np.ndarray, velocity: np.ndarray) -> dict[str, Quantities]:
    """Weigh fields at random, as an interpolation would, with what walls add."""
    weights = np.random.default_rng(7).standard_normal((4, len(density)))
    found = np.tensordot(weights, velocity, 1) + 0.3
    flow_rate = np.asarray(found[:, 0].sum())
    return {
        "line": {"velocity": found, "pressure": weights @ density},
        "flux": {"flow_rate": flow_rate},
    }


@pytest.mark.parametrize("name", NAMES)
def test_what_is_measured_is_that_of_the_fields(settings, name: str) -> None:
    setting = settings[name]
    measures = project_measures(setting.basis, setting.splines.values, setting.position, weighed)
    states = np.outer((1.0, 0.3), setting.coordinates)
    for each in ("line", "flux"):
        found = measures[each].at(states, MEAN)
        few = measures[each].of_modes(np.array([0, 2])).at(states[:, [0, 2]], MEAN)
        some = measures[each].at(states * [1.0, 0.0, 1.0, 0.0, 0.0], MEAN)
        for quantity, values in some.items():
            np.testing.assert_allclose(few[quantity], values, rtol=1e-12)
        for i, coordinates in enumerate(states):
            wanted = weighed(*reconstruct(setting.basis, coordinates, MEAN))[each]
            for quantity, values in wanted.items():
                scale = np.abs(values).max()
                np.testing.assert_allclose(found[quantity][i], values, atol=1e-10 * scale)
