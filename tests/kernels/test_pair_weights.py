"""The kernel at many distances is the kernel at each."""

from __future__ import annotations

import numpy as np

from sphrom.kernels.wendland import gradient_factor, kernel, weigh


def test_weights_are_the_kernel_and_its_factor() -> None:
    distance = np.array([0.0, 0.1, 0.37, 0.8, 0.81])
    values, factors = np.full((2, 5), np.nan)
    weigh(distance, 2.5, values, factors)
    assert np.allclose(values, [kernel(r, 2.5) for r in distance], rtol=1e-13)
    assert np.allclose(factors, [gradient_factor(r, 2.5) for r in distance], rtol=1e-13)
    assert values[-1] == factors[-1] == 0.0
