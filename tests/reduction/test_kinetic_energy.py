from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.metrics.series import kinetic_energy
from sphrom.reduction.trial_basis import InnerProduct, KineticEnergy, TrialBasis, reconstruct


@pytest.mark.parametrize("centred", [False, True])
def test_it_is_that_of_the_rebuilt_velocity(centred):
    random = np.random.default_rng(0)
    basis = TrialBasis(
        density_modes=random.standard_normal((3, 40)),
        velocity_modes=random.standard_normal((3, 40, 2)),
        singular_values={"joint": np.ones(3)},
        inner_product=InnerProduct.acoustic(1000.0, 10.0),
        weights=np.ones(40),
        gram_error=0.0,
    )
    if centred:
        basis = replace(basis, offset=(np.zeros(40), random.standard_normal((40, 2))))
    coordinates = random.standard_normal((5, 3))
    expected = kinetic_energy(reconstruct(basis, coordinates)[1], 2.5)
    np.testing.assert_allclose(KineticEnergy(basis, 2.5).of(coordinates), expected, rtol=1e-13)
