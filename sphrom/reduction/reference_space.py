"""The map of particle fields onto the fixed points of a reference space (Eq. 3.13-3.15).

The paper's Shepard interpolation smooths: with h = 4 dx it loses several per cent of a vortex that
is a few tens of particles wide. Moving least squares of second order lose a few hundredths of one.

Next to walls the support is one-sided, so odd terms do not cancel, and moving least squares are of
third order. On 100x100 jittered particles, a layer of a tenth of the box has an error of 2e-4
within the support of the wall and 3e-5 elsewhere. Noise is damped to 0.6 in the outermost points
and amplified by 1.2 in corners. Shepard interpolation is of first order there: the same layer has
an error of 6e-2 at h = 2 dx, and of 0.12 at h = 4 dx.

In full runs, the pressures of rows beside walls are high and low in turn, in the worst case by a
quarter of the variation of the flow's own pressure. On the wall, a quadratic fit amplifies this to
3.4 times its size and a linear one to 1.4 times; the linear fit also halves noise. The density is
therefore a mixture of both fits: linear on the wall, and quadratic where the wall is beyond the
support or the flow has a surface. The error of a linear fit is up to 1.1 dx^2 times half the second
derivative.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from sphrom.arrays import Array
from sphrom.kernels import SUPPORT_RATIO, interpolation, space_fits
from sphrom.kernels.space_lists import SpaceGrid, SpaceSearch, sort_by_space_cell
from sphrom.metrics.elevation import HALF, Filled
from sphrom.sph.domain import Domain
from sphrom.sph.neighbourhood import periodic_images, sort_sources
from sphrom.text import place_text

FULL, N_NEAR = 0.95, 6
"""Where less than this share is filled, within 1.7 spacings of a free surface, values are limited
to the range of so many nearest particles and zero: polynomials overshoot between it and walls."""


class TooFewParticlesError(ValueError):
    """The particles around a point do not determine an interpolation."""

    def __init__(self, number: int, place: Array, reach: float) -> None:
        super().__init__(
            f"too few particles, or all on one curve, within {reach:.3g} m of the point "
            f"{place_text(place, '.4g')} to interpolate there"
        )
        self.number = number
        """Index of the point."""


class ReferenceMap:
    """Interpolation of particle fields onto fixed points.

    Parameters
    ----------
    points : (n_points, n_dim), the points to interpolate to [m].
    smoothing_length : of the kernel that weights particles [m].
    method : "shepard" or "mls" (moving least squares of second order).
    filled : the share of space that fluid with a free surface fills at the points; fields are zero
        where it is below one half, and limited to the values of particles where it is below `FULL`.
    """

    def __init__(
        self,
        points: Array,
        domain: Domain,
        *,
        particle_spacing: float,
        smoothing_length: float,
        method: Literal["shepard", "mls"] = "mls",
        filled: Filled | None = None,
    ) -> None:
        self.domain = domain
        self.particle_spacing = particle_spacing
        self.smoothing_length = smoothing_length
        self.method, self._filled = method, filled
        self._points = np.ascontiguousarray(domain.wrap(points).T)
        self._reach = SUPPORT_RATIO * smoothing_length
        self._linear = np.zeros(self._points.shape[1])
        if filled is None:
            away = domain.wall_distance(self._points.T) / self._reach
            self._linear = np.maximum(0.0, 1.0 - away)
        self._n_dim = points.shape[1]
        rows = (90,) if self._n_dim == 2 else (space_fits.N_ROWS, space_fits.WIDTH)
        self._scratch = np.zeros((interpolation.N_CHUNKS, *rows))

    def __call__(
        self, position: Array, density_fluctuation: Array, velocity: Array
    ) -> tuple[Array, Array]:
        """Map one snapshot: densities (n_points,) and velocities (n_points, n_dim).

        Raises TooFewParticlesError if those near a point are too few or determine no polynomial.
        """
        reach = self._reach
        n_dim = self._n_dim
        fields = np.stack((density_fluctuation, *velocity.T))
        out = np.empty((n_dim + 1, self._points.shape[1]))
        if n_dim == 3:
            particle, image = periodic_images(position.T, self.domain, reach)
            place = position.T[:, particle] + image
            size = np.full(n_dim, 0.5 * self.smoothing_length)
            grid = SpaceGrid.around(place, size)
            order, start = sort_by_space_cell(place, grid)
            source = np.concatenate((place[:, order], fields[:, particle[order]]))
            near = SpaceSearch(
                grid.origin, grid.size, grid.shape, start, reach, 1.0 / self.smoothing_length
            )
            space_fits.moving_least_squares(
                self._points, self._linear, source, near, self._scratch, out
            )
            return self._checked(out)
        sources = sort_sources(position.T, self.domain, reach, self.particle_spacing)
        place = position.T[:, sources.particle] + sources.image
        source = np.concatenate((place, fields[:, sources.particle]))
        search = sources.search(reach, self.smoothing_length)
        if self.method == "mls":
            interpolation.moving_least_squares(
                self._points, self._linear, source, search, self._scratch, out
            )
        else:
            interpolation.shepard(self._points, source, search, out)
        if self._filled is not None:
            share = self._filled(position, density_fluctuation)
            edge = np.flatnonzero((share >= HALF) & (share < FULL))
            n_near = min(N_NEAR, len(position))
            nearest = cKDTree(position).query(self._points.T[edge], np.arange(1, n_near + 1))[1]
            around = np.stack((density_fluctuation, *velocity.T))[:, nearest]
            low = around.min(axis=2)
            high = around.max(axis=2)
            low[0] = np.minimum(low[0], 0.0)
            high[0] = np.maximum(high[0], 0.0)
            out[:, edge] = np.clip(out[:, edge], low, high)
            out[:, (share < HALF) | ~np.isfinite(out).all(axis=0)] = 0.0
        return self._checked(out)

    def _checked(self, out: Array) -> tuple[Array, Array]:
        """Return mapped fields (1 + n_dim, n_points) as density and velocity, if all are finite."""
        if not np.isfinite(out).all():
            number = int(np.flatnonzero(~np.isfinite(out).all(axis=0))[0])
            raise TooFewParticlesError(number, self._points[:, number], self._reach)
        return out[0], np.ascontiguousarray(out[1:].T)
