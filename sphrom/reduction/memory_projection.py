"""Projection of the closure of adjoint Petrov-Galerkin (Eq. 3.22) from the reference points.

The closure is a polynomial. Its rates are Phi^T W (f + tau J r), where f are the rates at all
points, r = Pi' f is their residual after projection, and J the Jacobian of f. With the notation of
`sphrom.reduction.forms`, a part of J is J x = L x + S(u, x), so that

    Phi^T W J r = sum_m sum_{k <= l} b_m b_k b_l Phi^T W (S(e_m, R_kl) + [m = 0] L R_kl)

for two parts, where R_kl = Pi' F_kl is of the one, and S and L are of the other. The product of
both factors is the factor of the result, so the closure is quadratic in the viscosity, and contains
two powers of an amplitude. Symmetrised over its indices this is one tensor of the third degree in
b: a cubic polynomial in a, which needs neither residual nor Jacobian online. It has n^4/6 entries
for n modes. A residual is no combination of modes, so its gradients are sums over points.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import permutations

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Tensors
from sphrom.reduction.affine import AMPLITUDE, VISCOSITY, factor_of
from sphrom.reduction.forms import LocalFields, Pairs, PointFields, parts_of, rates_of, weighted
from sphrom.reduction.mode_fields import (
    BLOCK_VALUES,
    blocks,
    mode_fields,
    summed_gradients,
    weighted_rows,
)
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reduced_operators import MemoryOperators
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints

NAMES = ("steady", "force", "force_squared")
"""The parts of the closure, by power of the amplitude."""


def project_memory(
    points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None = None
) -> MemoryOperators:
    """Return Phi^T W J r, the term of Eq. 3.22 per unit of memory length.

    Parameters: see `project_operators`. Parts that single parameters drive are left out.
    """
    parts = {name: part for name, part in parts_of(points).items() if "/" not in name}
    factors = {name: factor_of(name, points.walls_driven) for name in parts}
    rates = _Rates(points, basis)
    states = PointFields.of_states(points, basis, splines)
    fields = states.at(EVERYWHERE)
    pairs = parts["inertia"].pairs(states.n_fields)
    sums: dict[tuple[int, int], Array] = defaultdict(
        lambda: np.zeros((basis.n_modes, states.n_fields, len(pairs)))
    )
    for name, part in parts.items():
        used = part.pairs(states.n_fields)
        for some in blocks(len(used), BLOCK_VALUES // (9 * points.n_points)):
            residuals = rates.residuals(part.columns(fields, used[some]))
            for other, changing in parts.items():
                factor = factors[name] + factors[other]
                total = sums[factor.count(AMPLITUDE), factor.count(VISCOSITY)][..., some]
                total[:, 0] += rates.projected(changing.linear(residuals))
                for m in range(states.n_fields if changing.is_quadratic else 0):
                    change = changing.products(fields.some(m, m), residuals)
                    total[:, m] += rates.projected(change)
    powers = range(1 + max(power for power, _ in sums))
    # Higher powers of the amplitude multiply lower degrees in the coordinates.
    by_power = {
        NAMES[power]: tuple(
            map(np.stack, zip(*(_tensors(sums[power, k], pairs) for k in range(3)), strict=True))
        )[: 4 - power]
        for power in powers
    }
    return MemoryOperators(**by_power)


class _Rates:
    """Forms of fields at all points as rates, their coordinates and residuals."""

    def __init__(self, points: FixedPoints, basis: TrialBasis) -> None:
        self._points = points
        self._modes = mode_fields(basis, points)
        self._weights = weighted_rows(basis, self._modes, EVERYWHERE)

    def projected(self, rows: Array) -> Array:
        """Return the coordinates (n_modes, n_fields) of forms."""
        return weighted(self._weights, self._rates(rows))

    def residuals(self, rows: Array) -> LocalFields:
        """Return R = Pi' F as fields (Alg. 3.5)."""
        rates = self._rates(rows)
        coordinates = weighted(self._weights, rates)
        modes = slice(self._modes.n_modes)
        q = rates[0].T - self._modes.scaled_density[:, modes] @ coordinates
        velocity = rates[1:].swapaxes(1, 2) - self._modes.velocity[..., modes] @ coordinates
        slopes = summed_gradients(self._points, q, velocity)
        return PointFields(self._points, q, velocity, slopes).at(EVERYWHERE)

    def _rates(self, rows: Array) -> Array:
        """Return rates (1 + n_dim, n_fields, n_points), minus the mean if the volume is fixed."""
        n_dim = len(self._modes.velocity)
        rates = rates_of(rows, n_dim)
        if self._points.fixed_volume and len(rows) > n_dim:
            rates[0] -= rows[0].mean(axis=1, keepdims=True)
        return rates


def _tensors(sums: Array, pairs: Pairs) -> Tensors:
    """Return symmetric tensors by degree, from sums (n_modes, n, n_pairs) over b_m b_k b_l."""
    n = sums.shape[1]
    total = np.zeros((len(sums), n, n, n))
    for p, (k, l) in enumerate(pairs):
        total[:, :, k, l] = total[:, :, l, k] = sums[:, :, p] * (1.0 if k == l else 0.5)
    total = np.mean([total.transpose(0, *axes) for axes in permutations((1, 2, 3))], axis=0)
    modes = slice(1, None)
    return (
        total[:, 0, 0, 0],
        3.0 * total[:, modes, 0, 0],
        3.0 * total[:, modes, modes, 0],
        total[:, modes, modes, modes],
    )
