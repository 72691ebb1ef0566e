"""The factor of a residual's norm, computed once from the reference points.

The residual's columns (`sphrom.reduction.reduced_operators`) are computed in blocks of points, and
replaced by the triangular factor of their QR decomposition. Directions that no state near the
training ones reaches are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.declaration import Tensors
from sphrom.reduction.mode_fields import blocks, mode_fields, mode_gradients
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.operator_projection import (
    drag_rates,
    drags_and_forces,
    folded,
    force_rates,
    product_rates,
)
from sphrom.reduction.reduced_operators import (
    DriveResidual,
    ReducedOperators,
    ResidualFactor,
    monomials,
)
from sphrom.reduction.reduced_rates import pack
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Terms

Array = NDArray[np.float64]

DROPPED = 1e-5
"""Singular values of the scaled columns over the largest, below which directions are dropped."""


def residual_factor(
    points: FixedPoints,
    basis: TrialBasis,
    operators: ReducedOperators,
    splines: ModeSplines | None = None,
    *,
    largest: Array | None = None,
    scales: Mapping[str, float] | None = None,
    advance: Callable[[int], None] = lambda n_points: None,
) -> ResidualFactor:
    """Factorise the residual's columns, block by block.

    Parameters
    ----------
    operators : those that were projected with the same points, basis and splines.
    largest : (n_modes,) coordinates that states reach; by default one each. Directions below
        `DROPPED` there, at `scales` of the parameters by part (by default one), are dropped.
    advance : called with the number of points that have been done.
    """
    residuals = _Residuals(points, basis, operators, splines)
    triangle = np.zeros((0, residuals.n_columns))
    for rows in blocks(points.n_points, residuals.n_columns):
        block = np.concatenate((triangle, residuals.columns(rows)))
        triangle = np.asarray(np.linalg.qr(block, mode="r"))
        advance(rows.stop - rows.start)
    ends = np.cumsum(residuals.widths)
    reached = np.ones(basis.n_modes) if largest is None else largest
    # No coordinate counts for nothing.
    floor = np.finfo(float).eps * float(np.max(reached))
    size = monomials(np.maximum(reached, floor)[None])[0]
    factors = [(scales or {}).get(part, 1.0) for part in residuals.parts]
    scale = np.concatenate(
        [factor * size[:n] for factor, n in zip(factors, residuals.widths, strict=True)]
    )
    parts = np.split(_reduced(triangle, scale), ends[:-1], axis=1)
    found = dict(zip(residuals.parts, parts, strict=True))
    drives = {
        name: DriveResidual(walls=found.get(f"walls/{name}"), force=found.get(f"force/{name}"))
        for name in operators.drives
    }
    return ResidualFactor(
        inertia=found["inertia"],
        viscosity=found["viscosity"],
        walls=found.get("walls"),
        force=found.get("force"),
        drives=drives,
        walls_driven=points.walls_driven,
    )


def tensors_by_part(operators: ReducedOperators) -> dict[str, Tensors]:
    """Return the tensors that operators have, such as `walls`, and `walls/lid` of a parameter."""
    found = {part: getattr(operators, part) for part in ("inertia", "viscosity", "walls", "force")}
    for name, drive in operators.drives.items():
        found |= {f"walls/{name}": drive.walls, f"force/{name}": drive.force}
    return {part: tensors for part, tensors in found.items() if tensors is not None}


def _reduced(triangle: Array, scale: Array) -> Array:
    """Return a factor with as few rows as give the same norms, for monomials of a scale."""
    _, values, directions = np.linalg.svd(triangle * scale, full_matrices=False)
    kept = values > DROPPED * values[0]
    return np.asarray(values[kept, None] * directions[kept] / scale)


class _Residuals:
    """The residual's columns at points, orthogonal to the modes and weighted as the product is."""

    def __init__(
        self,
        points: FixedPoints,
        basis: TrialBasis,
        operators: ReducedOperators,
        splines: ModeSplines | None,
    ) -> None:
        self.points, self.basis = points, basis
        self.fields = mode_fields(basis, points)
        tensors = tensors_by_part(operators)
        self.parts = list(tensors)
        projected = [pack(each) for each in tensors.values()]
        self.widths = [p.shape[1] for p in projected]
        self.n_columns = sum(self.widths)
        self._projected = np.concatenate(projected, axis=1)
        self._slopes = mode_gradients(points, self.fields, splines)
        self._diffusion = points.diffusion(self.fields.scaled_density)
        self._divergence = points.divergence(self.fields.velocity)
        self._drags, self._forces = drags_and_forces(points)
        self._means = self._mean_continuity() if points.fixed_volume else (0.0, 0.0)

    def _mean_continuity(self) -> tuple[Array, Array]:
        """Return the means that are taken out of continuity, of fields and of their products."""
        fields, n_points = self.fields, self.points.n_points
        linear = self._diffusion.sum(axis=0)
        linear -= self.points.sound_speed * self._divergence.sum(axis=0)
        products = -(fields.scaled_density.T @ self._divergence)
        return linear / n_points, products / n_points

    def columns(self, rows: slice) -> Array:
        """Return the columns (3 n, n_columns) at some points."""
        terms = self.points.terms(
            self.fields.scaled_density, self.fields.velocity, rows, self._divergence
        )
        tensors = self._by_part(rows, terms, self._slopes(rows))
        packed = []
        for part in self.parts:
            flat = tuple(tensor.reshape(-1, *tensor.shape[2:]) for tensor in tensors[part])
            packed.append(pack(folded(flat, self.fields.n_modes)))
        rates = np.concatenate(packed, axis=1).reshape(3, -1, self.n_columns)
        rates[0] /= self.fields.density_ratio
        rates[0] -= self.basis.density_modes[:, rows].T @ self._projected
        rates[1:] -= self.basis.velocity_modes[:, rows].transpose(2, 1, 0) @ self._projected
        rates *= np.sqrt(self.basis.weights[rows])[:, None]
        return rates.reshape(-1, self.n_columns)

    def _by_part(self, rows: slice, terms: Terms, slopes: Array) -> dict[str, Tensors]:
        """Return the rates of columns at some points, by part and degree, as (3, n, ...)."""
        points, fields = self.points, self.fields
        nothing = np.zeros((3, *terms.divergence.shape))
        sound, friction = nothing.copy(), nothing.copy()
        sound[0] = self._diffusion[rows] - points.sound_speed * terms.divergence - self._means[0]
        sound[1:] = -points.sound_speed * terms.pressure_gradient
        friction[1:] = terms.laplacian
        inertia, viscosity = self._products(rows, terms, slopes)
        constant = nothing[..., 0]
        found: dict[str, Tensors] = {
            "inertia": (constant, sound, inertia),
            "viscosity": (constant, friction, viscosity),
        }
        for part, drag in self._drags.items():
            found[part] = _driven(*drag_rates(points, fields, drag, rows))
        for part, force in self._forces.items():
            found[part] = _driven(*force_rates(points, fields, force, rows))
        return found

    def _products(self, rows: slice, terms: Terms, slopes: Array) -> tuple[Array, Array]:
        """Return the quadratic rates (3, n, n_fields, n_fields) of inertia and viscosity."""
        n_columns = self.fields.n_fields
        inertia = np.empty((3, *terms.divergence.shape, n_columns))
        viscosity = np.zeros_like(inertia)
        for k in range(n_columns):
            own, light = product_rates(self.points, self.fields, k, rows, terms, slopes)
            inertia[:, :, k] = own[[0, 2, 3]]
            inertia[0, :, k] += own[1]
            viscosity[1:, :, k] = light
        inertia[0] -= self._means[1]
        return inertia, viscosity


def _driven(constant: Array, linear: Array) -> Tensors:
    """Return tensors (3, n, ...) of rates that have no part in continuity."""
    return tuple(np.concatenate((np.zeros_like(t[:1]), t)) for t in (constant, linear))
