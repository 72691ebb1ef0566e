"""From the norm of what a model leaves out to the errors of its velocity and pressure.

Errors are fed by the residual r(t) = |R - Phi da/dt| and decay at some rate, so that an estimate of
a field's is

    error(t) = C E(t),    dE/dt = r - lambda E,    E = 0 at the start,

with one constant C for each field and one rate lambda for all. They are fitted on reduced runs at
the trained parameters, whose errors against the snapshots are known: C is the geometric mean of
error over E, and lambda, of some from slower than the run to faster than snapshots follow, the one
with which error over E varies least (sum over the fields of the variance of the logarithm). The
first tenth of every run is left out, as E has no memory of how a run starts.

It is no bound: what a factor of C the training errors stay within is found along with C. What a
basis can't hold is in it, as the training errors have that part too.

Errors are root mean squares over the fluid: of the velocity [m/s], and of q = c0 rho'/rho0 [m/s]
less its mean, which is the pressure over rho0 c0. Those of many runs follow without the points from
products of snapshots with the basis, |x - Phi a|^2 = x.x - 2 a.(Phi^T x) + a.(Phi^T Phi) a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.columns import Columns
from sphrom.reduction.trial_basis import TrialBasis, weighted_mean

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

N_COMPARED = 100
"""Snapshots of a training run, about, that errors are known at."""
N_RATES = 15
"""Rates of decay that are tried."""
SLOWEST = 0.3
"""The slowest of them over one a run."""
LEFT_OUT = 0.1
"""Share of a run from its start that nothing is fitted to."""
WITHIN = 0.95
"""Share of the training errors that stay within the factor."""


@dataclass(frozen=True)
class FieldProducts:
    """Mean products of training snapshots with a basis, by field: velocity, then q."""

    gram: Array
    """(2, n_columns, n_columns) of columns with each other."""
    projections: Array
    """(n_runs, n_snapshots, 2, n_columns) of snapshots with columns."""
    squares: Array
    """(n_runs, n_snapshots, 2) of snapshots with themselves [m2/s2]."""

    def only(self, modes: Indices, n_modes: int) -> FieldProducts:
        """Return those of some of `n_modes` modes, and of what is constant in states."""
        kept = np.concatenate((modes, np.arange(n_modes, self.gram.shape[1])))
        return FieldProducts(
            self.gram[:, kept][:, :, kept], self.projections[..., kept], self.squares
        )

    def errors(self, run: int, coordinates: Array) -> Array:
        """Return a run's root mean square errors (n_snapshots, 2) of coordinates.

        Those are (n_snapshots, n_modes), at the instants of the products.
        """
        factors = self._factors(coordinates)
        products = np.einsum("sfc,sc->sf", self.projections[run], factors)
        return _root(self.squares[run] - 2.0 * products + self._squares_of(factors))

    def sizes(self, coordinates: Array) -> Array:
        """Return the root mean squares (n_states, 2) of the states of coordinates."""
        return _root(self._squares_of(self._factors(coordinates)))

    def _factors(self, coordinates: Array) -> Array:
        constant = np.ones((len(coordinates), self.gram.shape[1] - coordinates.shape[1]))
        return np.concatenate((coordinates, constant), axis=1)

    def _squares_of(self, factors: Array) -> Array:
        return np.einsum("sc,fcd,sd->sf", factors, self.gram, factors, optimize=True)


def _root(squares: Array) -> Array:
    """Return square roots of what rounding may have made negative."""
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


class FieldColumns:
    """The columns of a basis by field, that states are multiplied with."""

    def __init__(self, basis: TrialBasis, fields: Columns) -> None:
        self._share = basis.weights / basis.weights.sum()
        density = fields.scaled_density.T
        density = density - weighted_mean(density, self._share)[:, None]
        velocity = fields.velocity.transpose(2, 0, 1).reshape(fields.n_columns, -1)
        self._columns = velocity, density
        self._weights = np.tile(self._share, 2), self._share

    @property
    def gram(self) -> Array:
        """(2, n_columns, n_columns) of columns with each other."""
        pairs = zip(self._columns, self._weights, strict=True)
        return np.stack([(columns * weights) @ columns.T for columns, weights in pairs])

    def products(self, scaled_density: Array, velocity: Array) -> tuple[Array, Array]:
        """Return projections (n_states, 2, n_columns) and squares (n_states, 2) of states.

        `scaled_density` is q (n_states, n_points) and `velocity` (n_states, n_points, 2), in [m/s].
        """
        density = scaled_density - weighted_mean(scaled_density, self._share)[:, None]
        states = velocity.transpose(0, 2, 1).reshape(len(velocity), -1), density
        weighted = [state * w for state, w in zip(states, self._weights, strict=True)]
        projections = [w @ columns.T for w, columns in zip(weighted, self._columns, strict=True)]
        squares = [np.sum(w * state, axis=1) for w, state in zip(weighted, states, strict=True)]
        return np.stack(projections, axis=1), np.stack(squares, axis=1)


@dataclass(frozen=True)
class Calibration:
    """What turns residuals into errors of the velocity and of q."""

    decay_rate: float
    """lambda [1/s]."""
    constants: Array
    """C (2,)."""
    factors: Array
    """(2,) within which, either way, 95 % of the training errors are of their estimates."""

    def errors(self, time: Array, residual: Array) -> Array:
        """Return the estimates (n_snapshots, 2) of root mean square errors [m/s] along a run."""
        return accumulated(time, residual, self.decay_rate)[:, None] * self.constants


def compared_snapshots(n_snapshots: int) -> Indices:
    """Return the snapshots of a training run that errors are known at."""
    return np.arange(0, n_snapshots, max(1, (n_snapshots - 1) // N_COMPARED))


def accumulated(time: Array, residual: Array, decay_rate: float | Array) -> Array:
    """Return E (..., n_snapshots), the residual's integral that decays.

    Residuals (..., n_snapshots) vary linearly between snapshots; rates (...) may be many.
    """
    rate, steps = np.asarray(decay_rate)[..., None], np.diff(time)
    remains = np.exp(-rate * steps)
    mean = (1.0 - remains) / (rate * steps)
    older, newer = (mean - remains) / rate, (1.0 - mean) / rate
    passed = older * residual[..., :-1] + newer * residual[..., 1:]
    out = np.zeros((*passed.shape[:-1], len(time)))
    for k in range(len(steps)):
        out[..., k + 1] = remains[..., k] * out[..., k] + passed[..., k]
    return out


def calibrate(
    time: Array, residuals: Sequence[Array], errors: Sequence[Array], compared: Indices
) -> Calibration | None:
    """Fit constants and rate to training runs.

    Parameters
    ----------
    time : (n_snapshots,) of the runs [s], at equal intervals.
    residuals : (n_snapshots,) of each run; NaN from where it diverged.
    errors : (n_compared, 2) of each run, those of the snapshots `compared` (n_compared,).

    Returns
    -------
    None where nothing can be fitted: residuals or errors are zero, or no run went far enough.
    """
    if len(time) < 2:
        return None
    length = time[-1] - time[0]
    late = time[compared] - time[0] >= LEFT_OUT * length
    rates = np.geomspace(SLOWEST / length, (len(time) - 1) / length, N_RATES)
    best = None
    integrals = accumulated(time, np.stack(residuals), rates[:, None])[..., compared][..., late]
    known = np.concatenate([each[late] for each in errors])
    for rate, of_runs in zip(rates, integrals, strict=True):
        ratios = _ratios(of_runs.ravel(), known)
        if not len(ratios):
            return None
        spread = float(ratios.var(axis=0).sum())
        if best is None or spread < best[0]:
            best = spread, rate, ratios
    if best is None:
        return None
    _, rate, ratios = best
    middle = ratios.mean(axis=0)
    factors = np.exp(np.quantile(np.abs(ratios - middle), WITHIN, axis=0))
    return Calibration(float(rate), np.exp(middle), factors)


def _ratios(integrals: Array, errors: Array) -> Array:
    """Return the logarithms (n, 2) of error over E, where both are there."""
    some = (integrals > 0.0) & (errors > 0.0).all(axis=1)
    return np.asarray(np.log(errors[some] / integrals[some, None]))
