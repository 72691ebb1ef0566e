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
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legint, legvander

from sphrom.arrays import Array
from sphrom.kernels import graph_model as kernels
from sphrom.reduction.stream_functions import DEGREE
from sphrom.reduction.surface_basis import (
    N_COLUMNS,
    N_HEIGHTS,
    SLOPE_BEYOND_TRAINING,
    SurfaceBasis,
    TrainedGraph,
    gauss_points,
    integration_columns,
    surface_modes_at,
)

STEPS_A_PERIOD = 24
"""Steps in a period of the fastest elevation mode."""
STEEPEST, LEAST_DEPTH = 1.0, 0.05
"""The largest slope of a run, unless training is near it, and the least depth over the mean depth.
The highest standing wave has a crest of 90 degrees (Penney and Price, Phil. Trans. A 244, 1952)."""
N_BELOW = 16
"""Number of integration points for the pressure's slope, from the bottom to the surface."""
BLOCK = 8192
"""Number of pressures that are computed at a time, to limit memory."""
REASONS = {
    kernels.STEEP: "the surface is so steep that it would break",
    kernels.ABOVE: "a wave is more than {height:.3g} m above the floor, where the modes end",
    kernels.DRY: "the bottom falls dry",
    kernels.DIVERGED: "the run has diverged",
}


@dataclass(frozen=True)
class GraphRun:
    """A run of a model; if it ended early, up to its last snapshot."""

    times: Array
    coordinates: Array
    ended: str | None = None
    """Why the run ended early, None where it did not."""
    end_time: float = math.nan
    """[s]"""
    end_place: float = math.nan
    """Place x at which the run ended [m]."""


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
    gravity_factor: float = 1.0
    """Calibrated; it multiplies gravity in the rates, but neither in pressure nor in energies."""
    gravity_growth: float = 0.0
    """Relative growth of that factor with the square of the waves' amplitude [1/m2]."""
    largest_square: float = math.inf
    """Square of the waves' amplitude [m2] beyond which that factor is constant."""
    longest_step: float = math.inf
    """The longest step that resolves the force [s]."""

    @property
    def time_step(self) -> float:
        """The largest time step [s]: a share of the period of the shortest elevation mode.

        It also resolves the force.
        """
        amplitudes = self.basis.surface_modes**2
        wave_numbers = np.arange(1, amplitudes.shape[1] + 1) * math.pi / self.basis.space.width
        squares = self.gravity * wave_numbers * np.tanh(wave_numbers * self.depth)
        period = 2 * math.pi / math.sqrt(float((amplitudes @ squares).max()))
        return min(period / STEPS_A_PERIOD, self.longest_step)

    @property
    def given(self) -> tuple[float, float, float, float, float]:
        """Depth, gravity, viscosity, growth of gravity and its end, as the kernels take them."""
        gravity = self.gravity_factor * self.gravity
        return self.depth, gravity, self.viscosity, self.gravity_growth, self.largest_square

    @property
    def closure_matrix(self) -> Array:
        """The closure, zero where there is none."""
        size = len(self.basis.stream_modes) + len(self.basis.surface_modes)
        return np.zeros((size, size)) if self.closure is None else self.closure

    def run(self, times: Array, start: Array) -> GraphRun:
        """Return the run from coordinates (n_modes + n_surface,) at equally spaced times [s]."""
        return run_many([self], times, [start])[0]

    def rates(self, times: Array, coordinates: Array) -> Array:
        """Return the rates [1/s] of coordinates (n_times, n_modes + n_surface) at times [s]."""
        n_modes = len(self.basis.stream_modes)
        tables = _tables(self.basis)
        out = np.empty(coordinates.shape)
        closure = self.closure_matrix
        mass = np.empty((n_modes, n_modes))
        work = np.empty((5, n_modes))
        for rate, state, (f_x, f_y) in zip(out, coordinates, self.force(times).T, strict=True):
            kernels.rates(tables, state, *self.given, f_x, f_y, closure, mass, work, rate)
        return out

    def velocity(self, coordinates: Array, points: Array) -> Array:
        """Return velocities (..., n_points, 2) [m/s] at points [m], which may differ by time."""
        stream = coordinates[..., : len(self.basis.stream_modes)] @ self.basis.stream_modes
        if points.ndim == 2:
            return self.basis.space.velocity(stream, points)
        pairs = zip(stream, points, strict=True)
        return np.stack([self.basis.space.velocity(own, places) for own, places in pairs])

    def elevation(self, coordinates: Array, x: Array) -> Array:
        """Return heights (..., n_places) [m] of the surface."""
        fluctuation = (
            coordinates[..., len(self.basis.stream_modes) :] @ surface_modes_at(self.basis, x, 0).T
        )
        return np.asarray(self.basis.space.bottom + self.depth + fluctuation)

    def amplitude(self, coordinates: Array) -> Array:
        """Return the amplitude (n_times,) [m] of waves, by their energy."""
        n_modes = len(self.basis.stream_modes)
        kinetic = np.sum(coordinates[:, :n_modes] ** 2, axis=1)
        potential = np.sum(coordinates[:, n_modes:] ** 2, axis=1)
        return np.sqrt(potential + 2.0 * kinetic / (self.gravity * self.basis.space.width))

    def steepness(self, coordinates: Array) -> Array:
        """Return the largest slope (...,) of the surface at the columns of integration."""
        slopes = surface_modes_at(self.basis, integration_columns(self.basis.space)[0], 1)
        surface = coordinates[..., len(self.basis.stream_modes) :]
        return np.asarray(np.abs(surface @ slopes.T).max(axis=-1))

    def pressure(self, times: Array, coordinates: Array, points: Array) -> Array:
        """Return pressures (n_times, n_points) over the density [m2/s2], zero above the surface.

        The pressure is the integral up to the surface of weight, acceleration and viscosity.
        """
        rates = self.rates(times, coordinates)
        nodes, weights = gauss_points(N_BELOW)
        degrees = np.arange(N_BELOW)
        to_series = legvander(2.0 * nodes - 1.0, N_BELOW - 1) * weights[:, None] * (2 * degrees + 1)
        out = np.empty((len(times), len(points)))
        bottom = self.basis.space.bottom
        for here in np.array_split(np.argsort(points[:, 0]), 1 + out.size // BLOCK):
            x, which = np.unique(points[here, 0], return_inverse=True)
            height = self.elevation(coordinates, x) - bottom
            y = bottom + height[..., None] * nodes
            # The slope is a Legendre series over the fluid's height, and its integral another one.
            integral = legint(self._slope(times, coordinates, rates, x, y) @ to_series, axis=-1)
            height = height[:, which]
            places = np.minimum(2.0 * (points[here, 1] - bottom) / height - 1.0, 1.0)
            below = np.einsum("tpk,tpk->tp", legvander(places, N_BELOW), integral[:, which])
            out[:, here] = 0.5 * height * (integral.sum(axis=-1)[:, which] - below)
        return out

    def wall_force(
        self, times: Array, coordinates: Array, wall: str, centre: Array
    ) -> tuple[Array, Array]:
        """Return the pressure's force and torque on the left, right or bottom wall.

        Parameters
        ----------
        centre : (2,) [m], about which the torque is.

        Returns
        -------
        forces : (n_times, 2) over the density [m3/s2].
        torques : (n_times,) over the density [m4/s2].
        """
        space = self.basis.space
        forces = np.zeros((len(times), 2))
        if wall == "bottom":
            columns, widths = integration_columns(space)
            points = np.stack([columns, np.full(N_COLUMNS, space.bottom)], axis=-1)
            pressure = self.pressure(times, coordinates, points)
            forces[:, 1] = -pressure @ widths
            return forces, -pressure @ (widths * (columns - centre[0]))
        x, sign = (space.left, -1.0) if wall == "left" else (space.right, 1.0)
        nodes, weights = gauss_points(N_BELOW)
        columns = np.array([x])
        rates = self.rates(times, coordinates)
        height = self.elevation(coordinates, columns) - space.bottom
        y = height * nodes
        slope = self._slope(times, coordinates, rates, columns, space.bottom + y[:, None])[:, 0]
        # Integrals over the pressure are integrals over its slope, by parts.
        slope = height * weights * slope
        forces[:, 0] = sign * np.sum(slope * y, axis=-1)
        arm = y / 2 + space.bottom - centre[1]
        return forces, -sign * np.sum(slope * y * arm, axis=-1)

    def _slope(self, times: Array, coordinates: Array, rates: Array, x: Array, y: Array) -> Array:
        """Return -p_y (n_times, n_places, n_heights) [m/s2] at heights y over x, both [m]."""
        n_modes = len(self.basis.stream_modes)
        modes = self.basis.stream_modes
        along = self.basis.space.along
        orders = (0, 1), (1, 0), (2, 0), (1, 1), (3, 0), (1, 2)
        p_y, p_x, p_xx, p_xy, p_xxx, p_xyy = along(modes, coordinates[:, :n_modes], x, y, *orders)
        (rate,) = along(modes, rates[:, :n_modes], x, y, (1, 0))
        weight = (self.gravity - self.force(times)[1])[:, None, None]
        viscous = self.viscosity * (p_xxx + p_xyy)
        return np.asarray(weight - rate - p_y * p_xx + p_x * p_xy + viscous)

    def kinetic_energy(self, coordinates: Array) -> Array:
        """Return the kinetic energy (n_times,) over the density [m4/s2]."""
        space = self.basis.space
        nodes, weights = gauss_points(N_HEIGHTS)
        columns, widths = integration_columns(space)
        modes = self.basis.stream_modes
        heights = self.elevation(coordinates, columns) - space.bottom
        y = space.bottom + heights[..., None] * nodes
        p_x, p_y = space.along(modes, coordinates[:, : len(modes)], columns, y, (1, 0), (0, 1))
        return np.asarray(0.5 * ((p_x**2 + p_y**2) @ weights * heights) @ widths)

    def potential_energy(self, coordinates: Array) -> Array:
        """Return the potential energy (n_times,) over the density [m4/s2]; zero at rest."""
        surface = coordinates[:, len(self.basis.stream_modes) :]
        return np.asarray(self.gravity * self.basis.space.width / 4 * np.sum(surface**2, axis=-1))

    def centre_of_mass(self, coordinates: Array) -> Array:
        """Return the centre of mass (n_times, 2) [m]."""
        space = self.basis.space
        cosines = coordinates[:, len(self.basis.stream_modes) :] @ self.basis.surface_modes
        number = np.arange(1, cosines.shape[1] + 1)
        moments = ((-1.0) ** number - 1) * space.width / (math.pi * number) ** 2
        x = space.left + space.width / 2 + cosines @ moments / self.depth
        y = space.bottom + self.depth / 2 + np.sum(cosines**2, axis=-1) / (4 * self.depth)
        return np.stack([x, y], axis=-1)


def calibrated_model(plain: GraphModel, trained: TrainedGraph) -> GraphModel:
    """Return a model with the depth, gravity and closure that training runs determined."""
    return replace(
        plain,
        depth=plain.depth + trained.rise,
        gravity_factor=trained.gravity_factor,
        gravity_growth=trained.gravity_growth,
        largest_square=trained.largest_square,
        closure=trained.closure,
    )


def run_many(models: Sequence[GraphModel], times: Array, starts: Sequence[Array]) -> list[GraphRun]:
    """Return runs of models with one basis, at equally spaced times [s], in parallel.

    Parameters
    ----------
    times : (n_times,) [s], of all runs; they share the smallest time step of the models.
    starts : coordinates (n_modes + n_surface,) of each model.

    Raises
    ------
    ValueError
        If the models have several bases.
    """
    basis = models[0].basis
    if any(model.basis is not basis for model in models):
        raise ValueError("runs in parallel have one basis")
    interval = float(times[1] - times[0])
    n_substeps = max(1, math.ceil(interval / min(model.time_step for model in models)))
    instants = np.linspace(times[0], times[-1], 2 * n_substeps * (len(times) - 1) + 1)
    states = np.empty((len(models), len(times), len(starts[0])))
    states[:, 0] = starts
    endings = np.zeros((len(models), 3), dtype=np.int64)
    kernels.run_all(
        _tables(basis),
        kernels.Limits(
            max(STEEPEST, SLOPE_BEYOND_TRAINING * basis.largest_slope),
            basis.space.top - basis.space.bottom,
            LEAST_DEPTH,
        ),
        np.array([m.given for m in models]),
        np.stack([model.force(instants).T for model in models]),
        np.stack([model.closure_matrix for model in models]),
        n_substeps,
        interval / n_substeps,
        states,
        endings,
    )
    runs = []
    for own, (code, step, column) in zip(states, endings, strict=True):
        if code == kernels.FINISHED:
            runs.append(GraphRun(times, own))
            continue
        kept = 1 + (step - 1) // n_substeps
        place = float(integration_columns(basis.space)[0][column])
        end_time = float(instants[2 * step])
        reason = REASONS[code].format(height=basis.space.top - basis.space.bottom)
        runs.append(GraphRun(times[:kept], own[:kept], reason, end_time, place))
    return runs


@lru_cache(maxsize=8)
def _tables(basis: SurfaceBasis) -> kernels.Tables:
    """Return the modes at the points of integration."""
    space = basis.space
    columns, weights = integration_columns(space)
    nodes, node_weights = gauss_points(N_HEIGHTS)
    row_height = (space.top - space.bottom) / space.n_rows
    stream = np.empty((len(columns), space.n_rows, 3, DEGREE + 1, len(basis.stream_modes)))
    for row in range(space.n_rows):
        lower = np.full(len(columns), space.bottom + row * row_height)
        middle = np.stack([columns, lower + row_height / 2], axis=-1)
        for along_x in range(3):
            orders = [(along_x, power) for power in range(DEGREE + 1)]
            taylor = space.derivatives(middle, *orders)
            for power in range(DEGREE + 1):
                stream[:, row, along_x, power] = sum(
                    taylor[k]
                    @ basis.stream_modes.T
                    * ((-row_height / 2) ** (k - power) / math.factorial(k - power))
                    / math.factorial(power)
                    for k in range(power, DEGREE + 1)
                )
    return kernels.Tables(
        stream,
        surface_modes_at(basis, columns, 0),
        surface_modes_at(basis, columns, 1),
        weights,
        nodes,
        node_weights,
        space.bottom,
        row_height,
        space.width / 2,
    )
