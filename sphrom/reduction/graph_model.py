"""Reduced models of fluid in a tank below y = eta(x, t), the graph of an elevation.

The velocity has modes of stream functions, and the elevation has modes of its own:

    M(eta) a' = -convection - 2 nu int D(phi):D(u) + int ((f_x - (g - f_y) eta_x) psi)(x, eta) dx
    b' = (2/L) int psi(x, eta) e' dx

with f the body force and e the elevation's modes. The pressure drops out, as the modes are free of
divergence, tangential to the walls, and the pressure is zero at the surface. Without viscosity and
force, energy is constant; volume always is. A run ends with a reason where its elevation leaves the
range of the model.

Coordinates are (n_times, n_modes + n_surface): those of the velocity, then the elevation's [m].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset, part
from sphrom.kernels import graph_model as kernels
from sphrom.reduction.stream_functions import DEGREE, StreamSpace, cosine_coordinates

STEPS_A_PERIOD = 40
"""Of the fastest mode of the elevation."""
SLOPE_BEYOND_TRAINING, LEAST_DEPTH = 1.5, 0.05
"""The largest slope of a run over the largest trained, and the least depth over the mean depth."""
N_COLUMNS, N_HEIGHTS = 24, 6
"""Of the points of integration."""
SURFACE_VARIANCE = 1e-6
"""Share of the elevation's variance that its modes leave out."""
REASONS = {
    kernels.STEEP: "the surface is steeper than in training",
    kernels.ABOVE: "a crest is above the splines' box",
    kernels.DRY: "the bottom falls dry",
    kernels.DIVERGED: "the run has diverged",
}


class SurfaceBasis(Record):
    """Modes of a velocity below a surface, and of the surface."""

    space: StreamSpace = part()
    stream_modes: Array = dataset("mode coefficient", "m2/s", "stream functions of unit energy")
    surface_modes: Array = dataset("surface_mode cosine", "1", "orthonormal amplitudes of cosines")
    energies: Array = dataset("mode", "1", "coordinates' mean squares in training")
    noise: float = attribute("1", "share of the energy that the fit of snapshots leaves out")
    largest_slope: float = attribute("1", "of the surface in training")

    @property
    def modes_above_noise(self) -> int:
        """How many modes have more energy than the noise of one direction."""
        share = self.energies / self.energies.sum()
        return int((share > self.noise / share.size).sum())

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
        velocities = np.empty((len(coefficients), len(self.stream_modes)))
        for number, (own, heights) in enumerate(zip(coefficients, elevation, strict=True)):
            matrix, weights = _weighted_curl(self.space, heights)
            modes = matrix @ self.stream_modes.T * weights[:, None]
            velocities[number] = np.linalg.lstsq(modes, weights * (matrix @ own))[0]
        return np.concatenate([velocities, cosines @ self.surface_modes.T], axis=1)


def make_basis(
    space: StreamSpace, coefficients: Array, elevation: Array, noise: float, n_modes: int
) -> SurfaceBasis:
    """Return the modes of training runs, and as many of the elevation as its variance asks for.

    Parameters
    ----------
    coefficients : (n_runs, n_snapshots, n_coefficients) [m2/s].
    elevation : (n_runs, n_snapshots, n_columns) [m] at the midpoints of equal columns.
    noise : root mean square of the fits' relative residuals.
    """
    snapshots = coefficients.reshape(-1, coefficients.shape[-1])
    heights = elevation.reshape(-1, elevation.shape[-1])
    product = np.zeros((snapshots.shape[1],) * 2)
    for own in heights:
        matrix, weights = _weighted_curl(space, own)
        product += (matrix.T * weights**2) @ matrix / len(heights)
    energies, vectors = np.linalg.eigh(snapshots @ product @ snapshots.T / len(snapshots))
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
        noise=noise**2,
        largest_slope=0.0,
    )
    slopes = cosines @ directions[:n_surface].T @ _surface(basis, _columns(space)[0], 1).T
    return SurfaceBasis(**vars(basis) | {"largest_slope": float(np.abs(slopes).max())})


@dataclass(frozen=True)
class GraphRun:
    """A run of a model; where it ended early, up to its last snapshot before."""

    times: Array
    coordinates: Array
    ended: str | None = None
    """Why the run ended early, None where it did not."""
    end_time: float = math.nan
    """[s]"""
    end_place: float = math.nan
    """Along x [m]."""


@dataclass(frozen=True)
class GraphModel:
    """A reduced model at one depth [m], gravity [m/s2] and kinematic viscosity [m2/s]."""

    basis: SurfaceBasis
    depth: float
    gravity: float
    viscosity: float
    force: Callable[[Array], Array]
    """The body force (2, n_times) [m/s2] at times [s]."""
    closure: Array | None = None
    """(n_modes + n_surface, n_modes + n_surface) [1/s], added to the rates."""

    @cached_property
    def tables(self) -> kernels.Tables:
        """The modes at the points of integration."""
        space = self.basis.space
        columns, weights = _columns(space)
        nodes, node_weights = np.polynomial.legendre.leggauss(N_HEIGHTS)
        row_height = (space.top - space.bottom) / space.n_rows
        stream = np.empty((len(columns), space.n_rows, 3, DEGREE + 1, len(self.basis.stream_modes)))
        for row in range(space.n_rows):
            lower = np.full(len(columns), space.bottom + row * row_height)
            middle = np.stack([columns, lower + row_height / 2], axis=-1)
            for along_x in range(3):
                orders = [(along_x, power) for power in range(DEGREE + 1)]
                taylor = space.derivatives(middle, *orders)
                for power in range(DEGREE + 1):
                    stream[:, row, along_x, power] = sum(
                        taylor[k]
                        @ self.basis.stream_modes.T
                        * ((-row_height / 2) ** (k - power) / math.factorial(k - power))
                        / math.factorial(power)
                        for k in range(power, DEGREE + 1)
                    )
        return kernels.Tables(
            stream,
            _surface(self.basis, columns, 0),
            _surface(self.basis, columns, 1),
            weights,
            (1 + nodes) / 2,
            node_weights / 2,
            space.bottom,
            row_height,
            space.width / 2,
        )

    @property
    def time_step(self) -> float:
        """The largest time step [s]: a share of the period of the shortest elevation mode."""
        amplitudes = self.basis.surface_modes**2
        wave_numbers = np.arange(1, amplitudes.shape[1] + 1) * math.pi / self.basis.space.width
        squares = self.gravity * wave_numbers * np.tanh(wave_numbers * self.depth)
        return 2 * math.pi / math.sqrt(float((amplitudes @ squares).max())) / STEPS_A_PERIOD

    def run(self, times: Array, start: Array) -> GraphRun:
        """Return the run from coordinates (n_modes + n_surface,) at equally spaced times [s]."""
        interval = float(times[1] - times[0])
        n_substeps = max(1, math.ceil(interval / self.time_step))
        instants = np.linspace(times[0], times[-1], 2 * n_substeps * (len(times) - 1) + 1)
        states = np.empty((1, len(times), len(start)))
        states[0, 0] = start
        endings = np.zeros((1, 3), dtype=np.int64)
        basis = self.basis
        kernels.run_all(
            self.tables,
            kernels.Limits(
                SLOPE_BEYOND_TRAINING * basis.largest_slope,
                basis.space.top - basis.space.bottom,
                LEAST_DEPTH * self.depth,
            ),
            np.array([[self.depth, self.gravity, self.viscosity]]),
            np.ascontiguousarray(self.force(instants).T)[None],
            np.zeros((len(start),) * 2) if self.closure is None else self.closure,
            n_substeps,
            np.array([interval / n_substeps]),
            states,
            endings,
        )
        code, step, column = endings[0]
        if code == kernels.FINISHED:
            return GraphRun(times, states[0])
        kept = 1 + (step - 1) // n_substeps
        place = float(_columns(basis.space)[0][column])
        end_time = float(instants[2 * step])
        return GraphRun(times[:kept], states[0, :kept], REASONS[code], end_time, place)

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates [1/s] of coordinates (n_modes + n_surface,) at a time [s]."""
        n_modes = len(self.basis.stream_modes)
        f_x, f_y = self.force(np.array([time]))[:, 0]
        out = np.empty(len(state))
        closure = np.zeros((len(state),) * 2) if self.closure is None else self.closure
        work = np.empty((n_modes, n_modes)), np.empty((5, n_modes))
        given = self.depth, self.gravity - f_y, self.viscosity, f_x
        kernels.rates(self.tables, state, *given, closure, *work, out)
        return out

    def velocity(self, coordinates: Array, points: Array) -> Array:
        """Return velocities (..., n_points, 2) [m/s] at points [m], the same or own ones a time."""
        stream = coordinates[..., : len(self.basis.stream_modes)] @ self.basis.stream_modes
        if points.ndim == 2:
            return self.basis.space.velocity(stream, points)
        pairs = zip(stream, points, strict=True)
        return np.stack([self.basis.space.velocity(own, places) for own, places in pairs])

    def elevation(self, coordinates: Array, x: Array) -> Array:
        """Return heights (..., n_places) [m] of the surface."""
        fluctuation = (
            coordinates[..., len(self.basis.stream_modes) :] @ _surface(self.basis, x, 0).T
        )
        return np.asarray(self.basis.space.bottom + self.depth + fluctuation)

    def kinetic_energy(self, coordinates: Array) -> Array:
        """Return the kinetic energy (n_times,) over the density [m4/s2]."""
        columns, weights = _columns(self.basis.space)
        heights = self.elevation(coordinates, columns) - self.basis.space.bottom
        out = np.empty(len(coordinates))
        for number, own in enumerate(heights):
            points = np.stack(
                [
                    np.repeat(columns, N_HEIGHTS),
                    self.basis.space.bottom + np.outer(own, self.tables.heights).ravel(),
                ],
                axis=-1,
            )
            velocity = self.velocity(coordinates[number], points)
            area = np.outer(weights * own, self.tables.height_weights).ravel()
            out[number] = 0.5 * np.sum(area * np.sum(velocity**2, axis=-1))
        return out

    def potential_energy(self, coordinates: Array) -> Array:
        """Return the potential energy (n_times,) over the density [m4/s2]; zero at rest."""
        surface = coordinates[:, len(self.basis.stream_modes) :]
        return np.asarray(self.gravity * self.basis.space.width / 4 * np.sum(surface**2, axis=-1))


def calibrate_gravity(models: Sequence[GraphModel], trained: Sequence[GraphRun]) -> Array:
    """Return factors of gravity (n_factors,), and errors of repeated training runs with each.

    Sums over particles shift the frequency of waves by as much as a different gravity would. A run
    that ends early has an infinite error. One of the factors is one: no calibration.

    Returns
    -------
    (2, n_factors) factors, and the runs' largest relative errors of the elevation.
    """
    factors = np.arange(-20, 31) / 1000 + 1.0
    errors = np.zeros(len(factors))
    for number, factor in enumerate(factors):
        for model, expected in zip(models, trained, strict=True):
            own = replace(model, gravity=factor * model.gravity)
            run = own.run(expected.times, expected.coordinates[0])
            surface = expected.coordinates[:, len(model.basis.stream_modes) :]
            error = math.inf
            if run.ended is None:
                difference = run.coordinates[:, -surface.shape[1] :] - surface
                error = float(np.linalg.norm(difference) / np.linalg.norm(surface))
            errors[number] = max(errors[number], error)
    return np.stack([factors, errors])


def _columns(space: StreamSpace) -> tuple[Array, Array]:
    """Return the midpoints of equal columns [m], and their widths."""
    width = space.width / N_COLUMNS
    columns: Array = space.left + width * (np.arange(N_COLUMNS, dtype=np.float64) + 0.5)
    return columns, np.full(N_COLUMNS, width, dtype=np.float64)


def _surface(basis: SurfaceBasis, x: Array, order: int) -> Array:
    """Return the elevation's modes, or their slopes, (n_places, n_surface) at places."""
    wave_numbers = np.arange(1, basis.surface_modes.shape[1] + 1) * math.pi / basis.space.width
    phase = np.outer(x - basis.space.left, wave_numbers)
    waves = np.cos(phase) if order == 0 else -wave_numbers * np.sin(phase)
    return np.asarray(waves @ basis.surface_modes.T)


def _weighted_curl(space: StreamSpace, elevation: Array) -> tuple[Array, Array]:
    """Return both velocities of all splines below a surface, and roots of areas of the points."""
    columns, widths = _columns(space)
    midpoints = space.left + space.width * (np.arange(len(elevation)) + 0.5) / len(elevation)
    heights = np.interp(columns, midpoints, elevation) - space.bottom
    nodes, weights = np.polynomial.legendre.leggauss(N_HEIGHTS)
    y = space.bottom + np.outer(heights, (1 + nodes) / 2).ravel()
    points = np.stack([np.repeat(columns, N_HEIGHTS), y], axis=-1)
    d_x, d_y = space.derivatives(points, (1, 0), (0, 1))
    areas = np.outer(widths * heights, weights / 2).ravel()
    points = np.stack([np.repeat(columns, N_HEIGHTS), y], axis=-1)
    d_x, d_y = space.derivatives(points, (1, 0), (0, 1))
    return np.concatenate([d_y, -d_x]), np.sqrt(np.tile(areas, 2))
