"""Training of reduced models of fluid with a free surface: their size, gravity, a linear closure.

The fluid is below the graph y = eta(x, t) (`sphrom.reduction.graph_model`).

Sums over particles shift the frequency of waves by some thousandths, and of small waves by more
than of large ones. The phase that adds up is the largest error of a model. A factor of gravity that
changes with the square of the waves' amplitude compensates for it:

    g (1 + alpha + beta A^2),    A^2 = |b|^2 + 2 |a|^2/(g L)

Beyond the largest A^2 in training the factor is constant, as it would grow without a bound.

The particles' mean level rises a little above the depth at the start; so does the calibrated
model's depth.

A closure, a matrix on the coordinates that is added to the rates, compensates for the modes that
are left out. It has no entries from the elevation to the elevation's own rates. A closure does not
carry over to other depths: training runs of several depths have none. Both the closure and the
change of gravity minimise the relative differences between the model's runs and the projected
training runs,

    sum |x_model - x|^2 / sum |x|^2 + lambda (beta^2 + |C|^2)

by Gauss-Newton steps. Residuals of rates would be faster to fit, but small errors of a residual
may add up to a large phase. Both beta and the closure are relative to the size of the coordinates.
The number of elevation modes is the one with the smallest errors of training runs: with few modes
for the velocity, too many elevation modes have no restoring force and drift.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.reduction.graph_model import GraphModel, GraphRun, run_many
from sphrom.reduction.stream_functions import cosine_coordinates
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph

PENALTY = 1e-3
"""lambda."""
GRAVITY_STEPS, CLOSURE_STEPS = 3, 2
"""Gauss-Newton steps with alpha and beta alone, and with all numbers."""
N_CLOSED = 2
"""Numbers of elevation modes with which a closure is tried."""
DIFFERENCE = 1e-4
"""Step of the numbers, for derivatives of runs."""
MOST_GROWTH = 1e-6
"""Largest growth rate of small waves about fluid at rest, over the fastest frequency."""


@dataclass(frozen=True)
class TrainingRun:
    """The snapshots of a full run, as maps of them give, and its parameters."""

    times: Array
    """(n_snapshots,) [s], equally spaced."""
    coefficients: Array
    """(n_snapshots, n_coefficients) of the stream function [m2/s]."""
    elevation: Array
    """(n_snapshots, n_columns) [m] at the midpoints of equal columns."""
    depth: float
    """[m]"""
    gravity: float
    """[m/s2]"""
    viscosity: float
    """Kinematic [m2/s]."""
    force: Callable[[Array], Array]
    """The body force (2, n_times) [m/s2] at times [s]."""
    longest_step: float = math.inf
    """The longest step that resolves the force [s]."""


def train(
    basis: SurfaceBasis,
    runs: Sequence[TrainingRun],
    sizes: Sequence[int],
    advance: Callable[[int], None] = lambda done: None,
    n_surface: Mapping[int, int] = MappingProxyType({}),
) -> dict[int, TrainedGraph]:
    """Return models by the number of modes, each with its best number of elevation modes.

    Modes below the noise are left out, so that several sizes may have the same model.

    Parameters
    ----------
    advance : called with one for each size that is done.
    n_surface : the number of elevation modes of a size, if it is known.
    """
    products = [basis.products(run.coefficients, run.elevation) for run in runs]
    found: dict[int, TrainedGraph] = {}
    for size in sizes:
        n_modes = min(size, basis.modes_above_noise)
        same = (one for one in found.values() if one.n_modes == n_modes)
        found[size] = next(same, None) or _train(
            basis, n_modes, runs, products, n_surface.get(size)
        )
        advance(1)
    return found


@dataclass(frozen=True)
class _Projected:
    """A training run in a model's coordinates."""

    run: TrainingRun
    model: GraphModel
    """Not calibrated."""
    coordinates: Array
    """(n_snapshots, n_modes + n_surface)."""
    products: tuple[Array, Array, Array]
    """Products of velocities, for the model's modes."""
    cosines: Array
    """(n_snapshots, n_cosines) amplitudes of the elevation [m]."""
    level: Array
    """(n_snapshots,) mean of the elevation above the model's depth [m]."""

    @classmethod
    def of(
        cls,
        basis: SurfaceBasis,
        run: TrainingRun,
        products: tuple[Array, Array, Array],
        rise: float,
    ) -> _Projected:
        n_modes = len(basis.stream_modes)
        matrices, sides, squares = products
        own = matrices[:, :n_modes, :n_modes], sides[:, :n_modes], squares
        velocities = np.linalg.solve(own[0], own[1][..., None])[..., 0]
        cosines = cosine_coordinates(run.elevation, basis.surface_modes.shape[1])
        coordinates = np.concatenate([velocities, cosines @ basis.surface_modes.T], axis=1)
        model = GraphModel(basis, run.depth + rise, run.gravity, run.viscosity, run.force)
        model = replace(model, longest_step=run.longest_step)
        level = run.elevation.mean(axis=1) - basis.space.bottom - model.depth
        return cls(run, model, coordinates, own, cosines, level)

    def runs(self, changes: Sequence[dict[str, Any]]) -> list[GraphRun]:
        """Return runs of changed models from the first snapshot."""
        models = [replace(self.model, **change) for change in changes]
        return run_many(models, self.run.times, [self.coordinates[0]] * len(models))

    def errors(self, coordinates: Array) -> Array:
        """Return the relative errors (2,) of elevation and velocity.

        If a run ended early, the error of the missing part counts as twice its size.
        """
        matrices, sides, squares = self.products
        n_done = len(coordinates)
        n_modes = sides.shape[1]
        a, b = coordinates[:, :n_modes], coordinates[:, n_modes:]
        surface = np.sum(self.cosines**2, axis=-1) + 2 * self.level**2
        elevation, velocity = 4 * surface, 4 * squares
        difference = b @ self.model.basis.surface_modes - self.cosines[:n_done]
        elevation[:n_done] = np.sum(difference**2, axis=-1) + 2 * self.level[:n_done] ** 2
        velocity[:n_done] += np.einsum("ti,tij,tj->t", a, matrices[:n_done], a) - (
            2 * np.sum(a * sides[:n_done], axis=-1) + 3 * squares[:n_done]
        )
        sums = np.array([elevation.sum() / surface.sum(), velocity.sum() / squares.sum()])
        return np.asarray(np.sqrt(np.clip(sums, 0.0, None)))


def _train(
    basis: SurfaceBasis,
    n_modes: int,
    runs: Sequence[TrainingRun],
    products: Sequence[tuple[Array, Array, Array]],
    n_surface: int | None,
) -> TrainedGraph:
    """Return the calibrated model with a number of elevation modes, by default the best."""
    bottom = basis.space.bottom
    rise = float(np.mean([run.elevation.mean() - bottom - run.depth for run in runs]))

    def fit_of(n_surface: int, rise: float) -> _Fit:
        reduced = basis.reduced(n_modes, n_surface)
        pairs = zip(runs, products, strict=True)
        return _Fit([_Projected.of(reduced, run, product, rise) for run, product in pairs])

    n_most = min(n_modes, len(basis.surface_modes))
    counts = range(1, n_most + 1) if n_surface is None else [min(n_surface, n_most)]
    fits = [fit_of(count, rise).improved(GRAVITY_STEPS, 2) for count in counts]
    fits.sort(key=_Fit.error)
    if len({run.depth for run in runs}) == 1:
        closed = [fit.improved(CLOSURE_STEPS, len(fit.numbers)) for fit in fits[:N_CLOSED]]
        fits = sorted(closed, key=_Fit.error)
    fit = fits[0]
    n_surface = len(fit.scale) - n_modes
    plain = fit_of(n_surface, 0.0)
    projections = [one.errors(one.coordinates) ** 2 for one in fit.projected]
    calibrated = fit.errors(fit.numbers)
    uncalibrated = plain.errors(plain.numbers)
    projected = np.sqrt(np.mean(projections, axis=0))
    return TrainedGraph(
        n_surface=n_surface,
        rise=rise,
        elevation_error=float(calibrated[0]),
        velocity_error=float(calibrated[1]),
        uncalibrated_elevation_error=float(uncalibrated[0]),
        uncalibrated_velocity_error=float(uncalibrated[1]),
        best_elevation_error=float(projected[0]),
        best_velocity_error=float(projected[1]),
        largest_square=fit.largest_square,
        **fit.change(fit.numbers),
    )


class _Fit:
    """A fit of alpha, beta and the closure to training runs."""

    def __init__(self, projected: Sequence[_Projected], numbers: Array | None = None) -> None:
        self.projected = projected
        coordinates = np.concatenate([one.coordinates for one in projected])
        self.n_modes = projected[0].products[1].shape[1]
        a, b = coordinates[:, : self.n_modes], coordinates[:, self.n_modes :]
        parts = np.sqrt([np.mean(a**2), np.mean(b**2)])
        parts[parts == 0.0] = 1.0  # at rest
        self.scale = np.repeat(parts, [a.shape[1], b.shape[1]])
        norm = projected[0].run.gravity * projected[0].model.basis.space.width / 2
        squares = np.sum(b**2, axis=1) + np.sum(a**2, axis=1) / norm
        self.amplitude = float(np.mean(squares)) or 1.0
        self.largest_square = float(np.max(squares))
        free = np.ones((len(self.scale),) * 2, dtype=bool)
        free[self.n_modes :, self.n_modes :] = False
        self.entries = np.nonzero(free)
        self.numbers = np.zeros(2 + free.sum()) if numbers is None else numbers
        """alpha, beta and the closure's entries, relative to the coordinates' sizes."""

    def change(self, numbers: Array) -> dict[str, Any]:
        """Return the parameters of a model that numbers stand for."""
        closure = np.zeros((len(self.scale),) * 2)
        closure[self.entries] = numbers[2:]
        return {
            "gravity_factor": 1.0 + float(numbers[0]),
            "gravity_growth": float(numbers[1] / (self.amplitude * (1.0 + numbers[0]))),
            "closure": closure * self.scale[:, None] / self.scale,
        }

    def error(self) -> float:
        """Return the error of elevation and velocity together."""
        return float(np.linalg.norm(self.errors(self.numbers)))

    def errors(self, numbers: Array) -> Array:
        """Return errors (2,) of elevation and velocity, root mean squares over training runs."""
        change = self.change(numbers)
        squares = [one.errors(one.runs([change])[0].coordinates) ** 2 for one in self.projected]
        return np.asarray(np.sqrt(np.mean(squares, axis=0)))

    def improved(self, n_steps: int, n_free: int) -> _Fit:
        """Return the fit after steps with the leading numbers free, as long as they help."""
        numbers = self.numbers
        penalty = PENALTY
        steps = np.concatenate([np.zeros((1, len(numbers))), DIFFERENCE * np.eye(len(numbers))])
        for _ in range(n_steps):
            given = numbers + steps[: 1 + n_free]
            differences = self._differences(given)
            slopes = (differences[1:] - differences[0]) / DIFFERENCE
            cost = float(np.sum(differences[0] ** 2))
            weights = np.full(n_free, penalty)
            weights[0] = 0.0
            right_side = slopes @ differences[0] + weights * numbers[:n_free]
            try:
                step = np.linalg.solve(slopes @ slopes.T + np.diag(weights), right_side)
            except np.linalg.LinAlgError:  # runs at rest, which no number changes
                break
            trial = numbers.copy()
            trial[:n_free] -= step
            if np.sum(self._differences(trial[None]) ** 2) < cost and self._is_stable(trial):
                numbers = trial
            else:
                penalty *= 10
        return _Fit(self.projected, numbers)

    def _differences(self, given: Array) -> Array:
        """Return the relative differences (n_given, n) from training runs, for runs with given
        numbers."""
        changes, out = [self.change(numbers) for numbers in given], []
        for one in self.projected:
            sizes = np.ones(len(self.scale))
            for part in (slice(self.n_modes), slice(self.n_modes, None)):
                sizes[part] = np.linalg.norm(one.coordinates[:, part]) or 1.0
            missing = np.zeros((len(given), *one.coordinates.shape))
            for own, run in zip(missing, one.runs(changes), strict=True):
                own[: len(run.coordinates)] = run.coordinates
            out.append(((missing - one.coordinates) / sizes).reshape(len(given), -1))
        return np.concatenate(out, axis=1) / np.sqrt(len(self.projected))

    def _is_stable(self, numbers: Array) -> bool:
        """Whether small waves about fluid at rest don't grow."""
        model = replace(
            self.projected[0].model,
            force=lambda times: np.zeros((2, len(times))),
            **self.change(numbers),
        )
        small = DIFFERENCE * np.diag(self.scale)
        jacobian = model.rates(np.zeros(len(small)), small).T / (DIFFERENCE * self.scale)
        values = np.linalg.eigvals(jacobian)
        return bool(values.real.max() <= MOST_GROWTH * np.abs(values).max())
