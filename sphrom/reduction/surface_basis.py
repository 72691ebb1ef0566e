"""Bases of flows below a free surface, and the results of training; both are stored.

They load no kernels, as reading an artifact needs none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset, part
from sphrom.reduction.stream_functions import StreamSpace, cosine_coordinates
from sphrom.reduction.surface_errors import SurfaceErrors

N_COLUMNS, N_HEIGHTS = 24, 6
"""Numbers of columns of integration points, and of points in each."""
SURFACE_VARIANCE = 1e-6
"""Share of the elevation's variance that its modes leave out."""
SLOPE_BEYOND_TRAINING = 1.5
"""The largest slope of a run relative to the largest trained, beyond which the run is doubtful."""


class SurfaceBasis(Record):
    """Modes of a velocity below a surface, and of the surface."""

    space: StreamSpace = part()
    stream_modes: Array = dataset("mode coefficient", "m2/s", "stream functions of unit energy")
    surface_modes: Array = dataset("surface_mode cosine", "1", "orthonormal amplitudes of cosines")
    energies: Array = dataset("mode", "1", "coordinates' mean squares in training")
    noise: float = attribute(
        "1",
        "mean square of the coordinate of one direction, due to noise alone",
        at="noise_of_a_direction",
        default=0.0,
    )
    largest_slope: float = attribute("1", "of the surface in training")

    @property
    def modes_above_noise(self) -> int:
        """Number of modes with more energy than noise has in one direction."""
        return int((self.energies > self.noise).sum())

    def reduced(self, n_modes: int, n_surface: int) -> SurfaceBasis:
        """Return the basis of the leading modes."""
        changed = {
            "stream_modes": self.stream_modes[:n_modes],
            "surface_modes": self.surface_modes[:n_surface],
            "energies": self.energies[:n_modes],
        }
        return SurfaceBasis(**vars(self) | changed)

    def project(self, coefficients: Array, elevation: Array) -> Array:
        """Return the coordinates (n_snapshots, n_modes + n_surface) of snapshots.

        Velocities are projected in the energy of the fluid below each snapshot's surface.

        Parameters
        ----------
        coefficients : (n_snapshots, n_coefficients) [m2/s].
        elevation : (n_snapshots, n_columns) [m] at the midpoints of equal columns.
        """
        cosines = cosine_coordinates(elevation, self.surface_modes.shape[1])
        matrices, right_sides, _ = self.products(coefficients, elevation)
        velocities = np.linalg.solve(matrices, right_sides[..., None])[..., 0]
        return np.concatenate([velocities, cosines @ self.surface_modes.T], axis=1)

    def products(self, coefficients: Array, elevation: Array) -> tuple[Array, Array, Array]:
        """Return scalar products of velocities below each snapshot's surface [m4/s2].

        Returns
        -------
        (n_snapshots, n_modes, n_modes) of modes, (n_snapshots, n_modes) of modes and the snapshot's
        velocity, (n_snapshots,) of that with itself.
        """
        n_snapshots = len(coefficients)
        n_modes = len(self.stream_modes)
        matrices = np.empty((n_snapshots, n_modes, n_modes))
        sides = np.empty((n_snapshots, n_modes))
        squares = np.empty(n_snapshots)
        for number, (snapshot, heights) in enumerate(zip(coefficients, elevation, strict=True)):
            matrix, weights = _weighted_curl(self.space, heights)
            modes, velocity = (
                weights[:, None] * (matrix @ self.stream_modes.T),
                weights * (matrix @ snapshot),
            )
            matrices[number], sides[number] = modes.T @ modes, velocity @ modes
            squares[number] = velocity @ velocity
        return matrices, sides, squares


def make_basis(
    space: StreamSpace, coefficients: Array, elevation: Array, noise: float, n_modes: int
) -> SurfaceBasis:
    """Return the modes of training runs; the elevation has as many as its variance requires.

    White noise has the same energy in all directions of the stream functions. The noise of one of
    them is that of the fits over their number, however many modes are kept.

    Parameters
    ----------
    coefficients : (n_runs, n_snapshots, n_coefficients) [m2/s].
    elevation : (n_runs, n_snapshots, n_columns) [m] at the midpoints of equal columns.
    noise : root of the residuals' share in the energy of all snapshots.
    """
    snapshots = coefficients.reshape(-1, coefficients.shape[-1])
    heights = elevation.reshape(-1, elevation.shape[-1])
    product = np.zeros((snapshots.shape[1],) * 2)
    for elevations in heights:
        matrix, weights = _weighted_curl(space, elevations)
        product += (matrix.T * weights**2) @ matrix / len(heights)
    energies, vectors = np.linalg.eigh(snapshots @ product @ snapshots.T / len(snapshots))
    floor = noise**2 * float(energies.sum()) / snapshots.shape[1]
    energies, vectors = energies[::-1][:n_modes], vectors[:, ::-1][:, :n_modes]
    modes = vectors.T @ snapshots / np.sqrt(len(snapshots) * energies)[:, None]
    cosines = cosine_coordinates(heights, elevation.shape[-1] // 2)
    _, sizes, directions = np.linalg.svd(cosines, full_matrices=False)
    left = 1 - np.cumsum(sizes**2) / np.sum(sizes**2)
    n_surface = int((left > SURFACE_VARIANCE).sum()) + 1
    basis = SurfaceBasis(
        space=space,
        stream_modes=modes,
        surface_modes=directions[:n_surface],
        energies=energies,
        noise=floor,
        largest_slope=0.0,
    )
    slopes = (
        cosines
        @ directions[:n_surface].T
        @ surface_modes_at(basis, integration_columns(space)[0], 1).T
    )
    return SurfaceBasis(**vars(basis) | {"largest_slope": float(np.abs(slopes).max())})


class TrainedGraph(Record):
    """Results of training for one number of modes; errors are relative, in L2."""

    n_surface: int = attribute("1", "modes of the elevation")
    rise: float = attribute("m", "of the mean level above the depth, in training runs")
    gravity_factor: float = attribute("1", "of gravity in the calibrated model")
    gravity_growth: float = attribute("1/m2", "of gravity with the square of the waves' amplitude")
    largest_square: float = attribute(
        "m2", "of the waves' amplitude in training runs", default=math.inf
    )
    closure: Array = dataset("rate coordinate", "1/s", "linear closure of the calibrated model")
    elevation_error: float = attribute("1", "of the elevation, calibrated")
    velocity_error: float = attribute("1", "of the velocity, calibrated")
    uncalibrated_elevation_error: float = attribute("1", "of the elevation, not calibrated")
    uncalibrated_velocity_error: float = attribute("1", "of the velocity, not calibrated")
    best_elevation_error: float = attribute("1", "of the elevation's projection")
    best_velocity_error: float = attribute("1", "of the velocity's projection")
    errors: SurfaceErrors | None = part(default=None)

    @property
    def n_modes(self) -> int:
        """Number of velocity modes: the requested ones that are above the noise."""
        return len(self.closure) - self.n_surface

    @property
    def error(self) -> float:
        """Error of elevation and velocity together, with calibration."""
        return float(np.hypot(self.elevation_error, self.velocity_error))


def chosen_size(trained: Mapping[int, TrainedGraph]) -> int:
    """Return the number of modes whose calibrated runs are nearest to the training runs."""
    return min(trained, key=lambda size: trained[size].error)


def gauss_points(count: int) -> tuple[Array, Array]:
    """Return points between 0 and 1, and their weights."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (1 + nodes) / 2, weights / 2


def integration_columns(space: StreamSpace) -> tuple[Array, Array]:
    """Return the midpoints of equal columns [m], and their widths."""
    width = space.width / N_COLUMNS
    columns: Array = space.left + width * (np.arange(N_COLUMNS, dtype=np.float64) + 0.5)
    return columns, np.full(N_COLUMNS, width, dtype=np.float64)


def surface_modes_at(basis: SurfaceBasis, x: Array, order: int) -> Array:
    """Return the elevation's modes, or their slopes, (n_places, n_surface) at places."""
    wave_numbers = np.arange(1, basis.surface_modes.shape[1] + 1) * math.pi / basis.space.width
    phase = np.outer(x - basis.space.left, wave_numbers)
    waves = np.cos(phase) if order == 0 else -wave_numbers * np.sin(phase)
    return np.asarray(waves @ basis.surface_modes.T)


def _weighted_curl(space: StreamSpace, elevation: Array) -> tuple[Array, Array]:
    """Return both velocities of all splines below a surface, and roots of areas of the points."""
    columns, widths = integration_columns(space)
    midpoints = space.left + space.width * (np.arange(len(elevation)) + 0.5) / len(elevation)
    heights = np.interp(columns, midpoints, elevation) - space.bottom
    nodes, weights = gauss_points(N_HEIGHTS)
    y = space.bottom + np.outer(heights, nodes).ravel()
    points = np.stack([np.repeat(columns, N_HEIGHTS), y], axis=-1)
    d_x, d_y = space.derivatives(points, (1, 0), (0, 1))
    areas = np.outer(widths * heights, weights).ravel()
    return np.concatenate([d_y, -d_x]), np.sqrt(np.tile(areas, 2))
