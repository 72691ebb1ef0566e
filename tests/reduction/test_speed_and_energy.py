"""The largest speed and the kinetic energy of coordinates, against those of rebuilt fields."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.series import kinetic_energy
from sphrom.reduction import trial_basis
from sphrom.reduction.trial_basis import (
    InnerProduct,
    ModeVelocities,
    TrialBasis,
    reconstruct,
)

RANDOM = np.random.default_rng(1)
BASIS = TrialBasis(
    density_modes=RANDOM.standard_normal((4, 500)),
    velocity_modes=RANDOM.standard_normal((4, 500, 2)),
    singular_values={"joint": np.ones(4)},
    inner_product=InnerProduct.acoustic(1000.0, 10.0),
    weights=np.ones(500),
    gram_error=0.0,
)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("decay", [0.1, 1.0])
def test_they_are_those_of_all_points_and_snapshots(monkeypatch, seed, decay):
    monkeypatch.setattr(trial_basis, "N_FIRST", 3)
    monkeypatch.setattr(trial_basis, "N_BLOCK", 50)
    coordinates = np.random.default_rng(seed).standard_normal((20, 4)) * decay ** np.arange(4)
    _, velocity = reconstruct(BASIS, coordinates)
    expected = np.linalg.norm(velocity, axis=-1).max()
    modes = ModeVelocities(BASIS)
    assert modes.largest_speed(coordinates) == pytest.approx(expected, rel=1e-14)
    energy = modes.kinetic_energy(coordinates, 2.5)
    np.testing.assert_allclose(energy, kinetic_energy(velocity, 2.5), rtol=1e-13)
