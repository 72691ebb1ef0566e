"""Projection of the rates from the reference points, and of their residual, done once.

The rates of `sphrom.reduction.forms` are quadratic, so their Galerkin projection (Eq. 3.21) is
quadratic in the generalized coordinates. As in `sphrom.reduction.reduced_operators`, the columns of
the residual are replaced by the triangular factor of their QR decomposition, without directions
that no state near the training states reaches.

Points are read in blocks; the memory holds the basis, its copy as fields, and the diffusion of q, a
third of that size. With a separate mean, states have no mean density here: it drives no flow, and
is conserved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.reduction.forms import Part, PointFields, Sound, parts_of, rates_of, weighted
from sphrom.reduction.mode_fields import BLOCK_VALUES, blocks, mode_fields, weighted_rows
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.monomials import monomials
from sphrom.reduction.own_pressure import PressureBalance
from sphrom.reduction.reduced_operators import (
    ReducedOperators,
    ResidualFactor,
    pack,
    unpack,
)
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints

Advance = Callable[[int], None]
"""Called with the number of points that were completed."""
Weigh = Callable[[slice], Array]
"""Return the weights (n_weights, 2 + n_dim, n) of the rows of forms at some points."""

DROPPED = 1e-5
"""Directions are dropped if their singular value, relative to the largest, is below this."""


def _ignore(n_points: int) -> None:
    """Do nothing when points were completed."""


def project_operators(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None = None,
    *,
    advance: Advance = _ignore,
) -> ReducedOperators:
    """Project the rates of fixed points onto a basis (Eq. 3.21).

    Advection uses the gradients of `splines`, those of the basis; by default, sums over the points.
    """
    modes = mode_fields(basis, points)
    mean_weight = np.zeros((basis.n_modes, 1, 1))
    if points.fixed_volume:
        # Subtracting the mean from rates is the same as subtracting it from their weights.
        total = basis.density_modes @ basis.weights
        mean_weight[:, 0, 0] = total / (modes.density_ratio * points.n_points)

    def weigh(rows: slice) -> Array:
        tests = weighted_rows(basis, modes, rows)
        return np.concatenate((tests[:, :1] - mean_weight, tests), axis=1)

    parts = {**parts_of(points), "acoustic": Sound(points)}
    states = PointFields.of_states(points, basis, splines)
    sums = _weighted_sums(states, parts, weigh, advance)
    tensors = {name: unpack(columns, basis.n_modes) for name, columns in sums.items()}
    acoustic = tensors.pop("acoustic")[1]
    return ReducedOperators.of_parts(
        tensors, points.drives, acoustic=acoustic, walls_driven=points.walls_driven
    )


def residual_factor(
    points: FixedPoints,
    basis: TrialBasis,
    operators: ReducedOperators,
    splines: ModeSplines | None = None,
    *,
    largest: Array | None = None,
    scales: Mapping[str, float] | None = None,
    advance: Advance = _ignore,
) -> ResidualFactor:
    """Factorise the columns of the residual, block by block.

    Parameters
    ----------
    operators : projected with the same points, basis and splines.
    largest : (n_modes,) largest coordinates that states reach; by default one each. Directions
        whose residuals are below `DROPPED` for these coordinates are dropped.
    scales : values of the parameters by part for this purpose; by default one.
    """
    parts = parts_of(points)
    projected = [pack(operators.by_part[name]) for name in parts]
    widths = [columns.shape[1] for columns in projected]
    columns_of = _residual_columns(points, basis, splines, np.concatenate(projected, axis=1))
    triangle = np.zeros((0, sum(widths)))
    for rows in blocks(points.n_points, triangle.shape[1]):
        block = np.concatenate((triangle, columns_of(rows)))
        triangle = np.asarray(np.linalg.qr(block, mode="r"))
        advance(rows.stop - rows.start)
    reached = np.ones(basis.n_modes) if largest is None else largest
    # Every coordinate counts at least a little.
    floor = np.finfo(float).eps * float(np.max(reached))
    size = monomials(np.maximum(reached, floor)[None])[0]
    factors = [(scales or {}).get(name, 1.0) for name in parts]
    scale = np.concatenate([f * size[:n] for f, n in zip(factors, widths, strict=True)])
    # The fewest rows that give the same norms.
    _, values, directions = np.linalg.svd(triangle * scale, full_matrices=False)
    kept = values > DROPPED * values[0]
    reduced = np.asarray(values[kept, None] * directions[kept] / scale)
    by_part = zip(parts, np.split(reduced, np.cumsum(widths)[:-1], axis=1), strict=True)
    return ResidualFactor.of_parts(dict(by_part), points.drives, walls_driven=points.walls_driven)


def project_pressure(
    points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None, pressure_modes: Array
) -> PressureBalance:
    """Project the balance of momentum onto the gradients of pressure modes.

    Parameters
    ----------
    splines : those of the basis; without them, gradients are sums over the points.
    pressure_modes : q (n_pressure_modes, n_points) [m/s] without mean; the basis is acoustic.
    """
    own = np.ascontiguousarray(pressure_modes.T)
    at_rest = np.zeros((basis.n_dim, *own.shape))
    pushes = points.sound_speed * points.terms(own, at_rest).pressure_gradient
    modes = mode_fields(basis, points)
    weights = basis.weights[:, None]

    def weigh(rows: slice) -> Array:
        tests = (pushes[:, rows] * weights[rows]).transpose(2, 0, 1)
        return np.concatenate((np.zeros_like(tests), tests), axis=1)

    def products(fields: Array) -> Array:
        return np.einsum("dnk,dnm->km", pushes * weights, fields, optimize=True)

    states = PointFields.of_states(points, basis, splines)
    sums = _weighted_sums(states, parts_of(points), weigh)
    width = sums["inertia"].shape[1]
    return PressureBalance(
        parts={
            name.replace("/", "."): np.pad(x, ((0, 0), (0, width - x.shape[1])))
            for name, x in sums.items()
        },
        gradients=products(pushes),
        rates=products(modes.velocity),
        joint=(modes.scaled_density * weights).T @ own,
        walls_driven=int(points.walls_driven),
    )


def _residual_columns(
    points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None, projected: Array
) -> Callable[[slice], Array]:
    """Return a function for the residual's columns ((1 + n_dim) n, n_columns) at some points.

    They are orthogonal to the modes and weighted as in the product. `projected` are the packed
    operators (n_modes, n_columns) of all parts.
    """
    states = PointFields.of_states(points, basis, splines)
    parts = parts_of(points)
    density_ratio = mode_fields(basis, points).density_ratio
    means = np.zeros((projected.shape[1], 1))
    if points.fixed_volume:

        def share(rows: slice) -> Array:
            weights = np.zeros((1, 2 + basis.n_dim, rows.stop - rows.start))
            weights[:, 0] = 1.0 / points.n_points
            return weights

        means = np.concatenate(list(_weighted_sums(states, parts, share).values()), axis=1).T

    def columns(rows: slice) -> Array:
        fields = states.at(rows)
        by_part = [part.columns(fields, part.pairs(states.n_fields)) for part in parts.values()]
        rates = np.concatenate([rates_of(forms, basis.n_dim) for forms in by_part], axis=1)
        rates[0] = (rates[0] - means) / density_ratio
        rates[0] -= projected.T @ basis.density_modes[:, rows]
        rates[1:] -= projected.T @ basis.velocity_modes[:, rows].transpose(2, 0, 1)
        rates *= np.sqrt(basis.weights[rows])
        return np.concatenate(rates, axis=1).T

    return columns


def _weighted_sums(
    states: PointFields, parts: Mapping[str, Part], weigh: Weigh, advance: Advance = _ignore
) -> dict[str, Array]:
    """Return the weighted sums (n_weights, n_pairs) of the columns of parts over the points."""
    sums = dict.fromkeys(parts, np.zeros(()))
    n_pairs = states.n_fields * (states.n_fields + 1) // 2
    for rows in blocks(states.n_points, BLOCK_VALUES // (4 * n_pairs)):
        fields = states.at(rows)
        weights = weigh(rows)
        for name, part in parts.items():
            columns = part.columns(fields, part.pairs(states.n_fields))
            sums[name] = sums[name] + weighted(weights, columns)
        advance(rows.stop - rows.start)
    return sums
