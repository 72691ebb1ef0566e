from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction import trial_basis
from sphrom.reduction.trial_basis import InnerProduct, SpeedBounds, TrialBasis, reconstruct


@pytest.fixture(params=[False, True], ids=["plain", "centred"])
def basis(request):
    random = np.random.default_rng(1)
    n_points = 500
    offset = (random.standard_normal(n_points), random.standard_normal((n_points, 2)))
    return TrialBasis(
        density_modes=random.standard_normal((4, n_points)),
        velocity_modes=random.standard_normal((4, n_points, 2)),
        offset=offset if request.param else None,
        singular_values={"joint": np.ones(4)},
        inner_product=InnerProduct.acoustic(1000.0, 10.0),
        weights=np.ones(n_points),
        gram_error=0.0,
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("decay", [0.1, 1.0])
def test_it_is_that_of_all_points_and_snapshots(basis, monkeypatch, seed, decay):
    monkeypatch.setattr(trial_basis, "N_FIRST", 3)
    monkeypatch.setattr(trial_basis, "N_BLOCK", 50)
    random = np.random.default_rng(seed)
    coordinates = random.standard_normal((20, 4)) * decay ** np.arange(4)
    _, velocity = reconstruct(basis, coordinates)
    expected = np.linalg.norm(velocity, axis=-1).max()
    assert SpeedBounds(basis).largest(coordinates) == pytest.approx(expected, rel=1e-14)
