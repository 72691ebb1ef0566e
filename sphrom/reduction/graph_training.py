"""Training of reduced models below an elevation: their size, gravity and a linear closure.

Sums over particles shift the frequency of waves by some thousandths, which adds up to a phase. A
factor of gravity compensates for most of it. A closure, a matrix on the coordinates that is added
to the rates, compensates for more, and for what the modes leave out. It is a ridge fit

    sum |<x' - f(x)> - C <x>|^2 + lambda n s^2 |C|^2

of the residuals of projected snapshots x, averaged over a window that moves along each run, since
sound between particles is too fast for the snapshots. C has no entries from the elevation to its
own rates: those follow from the velocity. The penalty lambda is the one whose runs are nearest to
the training runs, of those that leave the fluid at rest stable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset
from sphrom.metrics.series import hat, moving_average
from sphrom.reduction.graph_model import GraphModel, GraphRun, SurfaceBasis, run_many
from sphrom.reduction.stream_functions import cosine_coordinates

GRAVITY_FACTORS, GRAVITY_TOLERANCE = (0.97, 1.04), 2e-4
PENALTIES = 10.0 ** np.arange(-5, 1)
WINDOW = 2
"""Half-width of the averages of residuals, in intervals of snapshots."""
MOST_GROWTH = 1e-6
"""Of small waves about the fluid at rest, over the fastest frequency."""


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


class TrainedGraph(Record):
    """What training runs teach a model with one number of modes; errors are relative, in L2."""

    n_surface: int = attribute("1", "modes of the elevation")
    gravity_factor: float = attribute("1", "of gravity in the calibrated model")
    closure: Array = dataset("rate coordinate", "1/s", "linear closure of the calibrated model")
    elevation_error: float = attribute("1", "of the elevation, calibrated")
    velocity_error: float = attribute("1", "of the velocity, calibrated")
    uncalibrated_elevation_error: float = attribute("1", "of the elevation, not calibrated")
    uncalibrated_velocity_error: float = attribute("1", "of the velocity, not calibrated")
    best_elevation_error: float = attribute("1", "of the elevation's projection")
    best_velocity_error: float = attribute("1", "of the velocity's projection")

    @property
    def n_modes(self) -> int:
        """Modes of the velocity: those asked for, as far as they are above the noise."""
        return len(self.closure) - self.n_surface

    def model(
        self,
        basis: SurfaceBasis,
        depth: float,
        gravity: float,
        viscosity: float,
        force: Callable[[Array], Array],
        calibrated: bool,
    ) -> GraphModel:
        """Return the model of this size from the basis that it was trained with."""
        own = basis.reduced(self.n_modes, self.n_surface)
        plain = GraphModel(own, depth, gravity, viscosity, force)
        if not calibrated:
            return plain
        return replace(plain, gravity_factor=self.gravity_factor, closure=self.closure)


def train(
    basis: SurfaceBasis,
    runs: Sequence[TrainingRun],
    sizes: Sequence[int],
    advance: Callable[[int], None],
) -> dict[int, TrainedGraph]:
    """Return models by the number of modes, each with its best number of elevation modes.

    Modes below the noise are left out, so that several sizes may have the same model.

    Parameters
    ----------
    advance : called with one for each size that is done.
    """
    products = [basis.products(run.coefficients, run.elevation) for run in runs]
    found: dict[int, TrainedGraph] = {}
    for size in sizes:
        n_modes = min(size, basis.modes_above_noise)
        candidates = [
            _train(basis.reduced(n_modes, n_surface), runs, products)
            for n_surface in range(1, min(n_modes, len(basis.surface_modes)) + 1)
        ]
        found[size] = min(candidates, key=_error)
        advance(1)
    return found


def chosen_size(trained: dict[int, TrainedGraph]) -> int:
    """Return the number of modes whose calibrated runs are nearest to the training runs."""
    return min(trained, key=lambda size: _error(trained[size]))


def _error(trained: TrainedGraph) -> float:
    return float(np.hypot(trained.elevation_error, trained.velocity_error))


@dataclass(frozen=True)
class _Projected:
    """A training run in a model's coordinates."""

    run: TrainingRun
    model: GraphModel
    """Not calibrated."""
    coordinates: Array
    """(n_snapshots, n_modes + n_surface)."""
    products: tuple[Array, Array, Array]
    """Of velocities, for the model's modes."""
    cosines: Array
    """(n_snapshots, n_cosines) amplitudes of the elevation [m]."""

    @classmethod
    def of(
        cls, basis: SurfaceBasis, run: TrainingRun, products: tuple[Array, Array, Array]
    ) -> _Projected:
        n_modes = len(basis.stream_modes)
        matrices, sides, squares = products
        own = matrices[:, :n_modes, :n_modes], sides[:, :n_modes], squares
        velocities = np.linalg.solve(own[0], own[1][..., None])[..., 0]
        cosines = cosine_coordinates(run.elevation, basis.surface_modes.shape[1])
        coordinates = np.concatenate([velocities, cosines @ basis.surface_modes.T], axis=1)
        model = GraphModel(basis, run.depth, run.gravity, run.viscosity, run.force)
        return cls(run, model, coordinates, own, cosines)

    def runs(self, changes: Sequence[dict[str, Any]]) -> list[GraphRun]:
        """Return runs of changed models from the first snapshot."""
        models = [replace(self.model, **change) for change in changes]
        return run_many(models, self.run.times, [self.coordinates[0]] * len(models))

    def errors(self, coordinates: Array) -> Array:
        """Return the relative errors (2,) of elevation and velocity.

        Where a run ended early, the error of the rest is that of fluid at rest twice.
        """
        matrices, sides, squares = self.products
        n_done, n_modes = len(coordinates), sides.shape[1]
        a, b = coordinates[:, :n_modes], coordinates[:, n_modes:]
        surface = np.sum(self.cosines**2, axis=-1)
        elevation, velocity = 4 * surface, 4 * squares
        difference = b @ self.model.basis.surface_modes - self.cosines[:n_done]
        elevation[:n_done] = np.sum(difference**2, axis=-1)
        velocity[:n_done] += np.einsum("ti,tij,tj->t", a, matrices[:n_done], a) - (
            2 * np.sum(a * sides[:n_done], axis=-1) + 3 * squares[:n_done]
        )
        sums = np.array([elevation.sum() / surface.sum(), velocity.sum() / squares.sum()])
        return np.asarray(np.sqrt(np.clip(sums, 0.0, None)))


def _train(
    basis: SurfaceBasis, runs: Sequence[TrainingRun], products: Sequence[tuple[Array, Array, Array]]
) -> TrainedGraph:
    """Return the calibrated model with all modes of a basis."""
    projected = [_Projected.of(basis, run, own) for run, own in zip(runs, products, strict=True)]
    gravity_factor = _gravity_factor(projected)
    closures = [np.zeros((len(projected[0].coordinates[0]),) * 2)]
    closures += _closures(projected, gravity_factor)
    changes = [{"gravity_factor": gravity_factor, "closure": closure} for closure in closures]
    errors = _errors(projected, [{}, *changes])
    best = 1 + int(np.argmin(np.linalg.norm(errors[1:], axis=1)))
    names = "elevation_error", "velocity_error"
    best_errors = np.mean([one.errors(one.coordinates) ** 2 for one in projected], axis=0) ** 0.5
    return TrainedGraph(
        n_surface=len(basis.surface_modes),
        gravity_factor=gravity_factor,
        closure=closures[best - 1],
        **dict(zip(names, map(float, errors[best]), strict=True)),
        **{f"uncalibrated_{name}": float(errors[0, k]) for k, name in enumerate(names)},
        **{f"best_{name}": float(best_errors[k]) for k, name in enumerate(names)},
    )


def _errors(projected: Sequence[_Projected], changes: Sequence[dict[str, Any]]) -> Array:
    """Return errors (n_changes, 2) of models, root mean squares over training runs."""
    squares = [[one.errors(run.coordinates) ** 2 for run in one.runs(changes)] for one in projected]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def _gravity_factor(projected: Sequence[_Projected]) -> float:
    def cost(factor: float) -> float:
        return float(np.sum(_errors(projected, [{"gravity_factor": factor}]) ** 2))

    options = {"xatol": GRAVITY_TOLERANCE}
    found = minimize_scalar(cost, bounds=GRAVITY_FACTORS, method="bounded", options=options)
    return float(found.x)


def _closures(projected: Sequence[_Projected], gravity_factor: float) -> list[Array]:
    """Return a closure for each penalty, of those that leave fluid at rest stable."""
    n_modes = len(projected[0].model.basis.stream_modes)
    states, residuals = [], []
    for one in projected:
        model = replace(one.model, gravity_factor=gravity_factor)
        slopes = CubicSpline(one.run.times, one.coordinates)(one.run.times, 1)
        residual = slopes - model.rates(one.run.times, one.coordinates)
        states.append(moving_average(one.coordinates, hat(WINDOW)))
        residuals.append(moving_average(residual, hat(WINDOW)))
    x, r = np.concatenate(states), np.concatenate(residuals)
    sizes = np.ones(x.shape[1])
    for part in (slice(n_modes), slice(n_modes, None)):
        sizes[part] = np.sqrt(np.mean(x[:, part] ** 2))
    x = x / sizes
    closures = []
    for penalty in PENALTIES:
        closure = np.zeros((x.shape[1],) * 2)
        for rows, columns in (
            (slice(n_modes), slice(None)),
            (slice(n_modes, None), slice(n_modes)),
        ):
            own = x[:, columns]
            matrix = own.T @ own + penalty * len(own) * np.eye(own.shape[1])
            closure[rows, columns] = np.linalg.solve(matrix, own.T @ r[:, rows]).T / sizes[columns]
        if _is_stable(projected[0].model, gravity_factor, closure):
            closures.append(closure)
    return closures


def _is_stable(plain: GraphModel, gravity_factor: float, closure: Array) -> bool:
    """Whether small waves about fluid at rest don't grow."""
    model = replace(
        plain,
        gravity_factor=gravity_factor,
        closure=closure,
        force=lambda times: np.zeros((2, len(times))),
    )
    small = 1e-6 * np.eye(len(closure))
    jacobian = model.rates(np.zeros(len(small)), small) / 1e-6
    values = np.linalg.eigvals(jacobian)
    return bool(values.real.max() <= MOST_GROWTH * np.abs(values).max())
