"""Estimates of the errors in velocity and pressure from the norm of a model's residual.

`docs/estimates.md` explains the estimate, and measures its accuracy. With E the integral of the
residual r = |R - Phi da/dt| with decay, dE/dt = r - lambda E, the errors are

    error(t)^2 = (C E(t))^2 + (s_p |a(t') - sum_k w_k a_k(t')|)^2 + (s_t g^2 |a(t) - a(t')|)^2,
    log C = sum_k w_k log C_k,    s_t = sum_k w_k s_tk,    t' = min(t, end of the training runs).

One constant C_k per training run and field, and one rate lambda, are fitted to reduced runs at the
training points, where the errors against the snapshots are known. C_k is the geometric mean of
error over E. The candidates for lambda range from slower than the run to faster than the snapshots
resolve; the chosen one has the least variation of error over E within runs (sum over the fields of
the variance of the logarithm). The first tenth of every run is left out, as E has no memory of the
start. The shares s_p and s_t are measured by `sphrom.reduction.held_out`.

The weights w interpolate in the parameters (`sphrom.reduction.correction`). Outside the hull of the
training points C is multiplied by the ratio of its largest to its smallest training value, raised
to the distance over the largest distance between training points (at most one).

Errors are root mean squares over the fluid: of the velocity [m/s], and of q = c0 rho'/rho0 [m/s]
minus its mean, which is the pressure over rho0 c0. For many runs they follow from products of
snapshots with the basis, without reading the points again:
|x - Phi a|^2 = x.x - 2 a.(Phi^T x) + a.(Phi^T Phi) a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Indices, Mask
from sphrom.declaration import Record, attribute, dataset, labelled, part
from sphrom.metrics.quantities import MEASURABLE
from sphrom.metrics.series import hat, smoothed
from sphrom.reduction.correction import PLACES, interpolation_weights
from sphrom.reduction.held_out import UnheldShares

N_COMPARED = 100
"""Approximate number of snapshots of a training run at which errors are known."""
N_RATES = 15
"""Number of candidate decay rates."""
SLOWEST = 0.3
"""The slowest candidate, in decays per run."""
LEFT_OUT = 0.1
"""Initial share of a run that the fit leaves out."""
N_PARTS = 10
"""Number of parts of a run over which errors of outputs are averaged."""
WITHIN = 0.95
"""Share of the training errors that are within the factor of their estimates."""


class ChangeShares(Record):
    """The shares of changes that a basis misses, of velocity and q: see `UnheldShares`."""

    parameters: Array = dataset(
        "field",
        "m/s over the inner product's",
        "missed share of changes with the parameters",
        "s_p",
    )
    time: Array = dataset(
        "estimated_run field",
        "m/s over the inner product's",
        "missed share of changes over time",
        "s_t",
    )


class ErrorCalibration(Record):
    """The fitted relation between residuals, changes, and the errors of the velocity and of q."""

    decay_rate: float = attribute("1/s", "decay rate of errors")
    constants: Array = dataset(
        "estimated_run field",
        "m/s over the inner product's",
        "error divided by the residual's integral with decay",
        "C_k",
    )
    factors: Array = dataset(
        "field", "1", "ratio of error to estimate, either way, of 95 % of the training errors"
    )
    places: Array = labelled("estimated_run parameter", PLACES)
    coordinates: Array = dataset(
        "estimated_run snapshot mode", "of the inner product", "coordinates of the training runs"
    )
    shares: ChangeShares = part()

    def at(self, place: Array) -> LocalErrorCalibration:
        """Return the calibration at a parameter point (..., n_parameters)."""
        rows = place.reshape(-1, place.shape[-1])
        found = [interpolation_weights(self.places, row) for row in rows]
        weights = np.reshape([w for w, _ in found], (*place.shape[:-1], -1))
        distance = np.reshape([d for _, d in found], place.shape[:-1])
        logarithms = np.log(self.constants)
        largest = np.linalg.norm(self.places[:, None] - self.places, axis=2).max()
        # Beyond the hull of the training points the constants may keep changing.
        share = np.minimum(1.0, distance / (largest or np.inf))[..., None]
        return LocalErrorCalibration(
            decay_rate=self.decay_rate,
            constants=np.exp(_weighted(weights, logarithms) + share * np.ptp(logarithms, axis=0)),
            factors=None if (distance > 0.0).all() else self.factors,
            outside=distance > 0.0,
            expected=_weighted(weights, self.coordinates),
            of_parameters=self.shares.parameters,
            of_time=_weighted(weights, self.shares.time),
        )


@dataclass(frozen=True)
class LocalErrorCalibration:
    """A calibration at one parameter point, or at those of runs along the first axes (...)."""

    decay_rate: float
    constants: Array
    """C (..., 2)."""
    factors: Array | None
    """None outside the training points, where they are unknown."""
    outside: Mask
    """(...) whether a point is outside the training points."""
    expected: Array
    """(..., n_snapshots, n_modes) coordinates interpolated from the training runs."""
    of_parameters: Array
    """(2,) share of changes with the parameters."""
    of_time: Array
    """(..., 2) share of changes with time."""

    def extrapolates(self, n_snapshots: int) -> Mask:
        """Return whether runs are outside the training points or longer than the training runs."""
        return self.outside | (n_snapshots > self.expected.shape[-2])

    def changes(self, coordinates: Array) -> Array:
        """Return distances (..., n_snapshots, 2) from training states: with parameters and time."""
        n_snapshots = coordinates.shape[-2]
        last = min(n_snapshots, self.expected.shape[-2]) - 1
        reached = np.minimum(np.arange(n_snapshots), last)
        by_parameters = coordinates[..., reached, :] - self.expected[..., reached, :]
        by_time = coordinates - coordinates[..., reached, :]
        sizes = [np.linalg.norm(part, axis=-1) for part in (by_parameters, by_time)]
        return np.stack(sizes, axis=-1)

    def errors(self, time: Array, residual: Array, coordinates: Array) -> Array:
        """Return the estimated root mean square errors (..., n_snapshots, 2) [m/s] along runs.

        Their snapshots have the interval of the training runs; the runs may be longer.
        """
        integral = accumulated(time, residual, self.decay_rate)[..., None]
        known = integral * self.constants[..., None, :]
        sizes = np.linalg.norm(coordinates, axis=-1)
        largest = np.linalg.norm(self.expected, axis=-1).max(axis=-1, keepdims=True)
        growth = np.maximum(1.0, sizes / np.where(largest > 0.0, largest, 1.0))
        time_shares = growth[..., None] ** 2 * self.of_time[..., None, :]
        return self._combined(known, self.changes(coordinates), time_shares)

    def steady_errors(self, residual: float, change: Array, steady_change: float) -> Array:
        """Return the estimated errors (2,) [m/s] of a steady state.

        `change` (2,) is the change up to the end of the run. `steady_change` is the norm of the
        change from there to the steady state. All of its velocity counts as an error, because the
        share that the basis misses is unknown.
        """
        known = residual / self.decay_rate * self.constants
        later = change + np.array([0.0, steady_change])
        of_velocity = float(self.of_time[0])
        shares = self.of_time / of_velocity if of_velocity > 0.0 else np.ones(2)
        return self._combined(known[None], later[None], shares)[0]

    def _combined(self, known: Array, changes: Array, time_shares: Array) -> Array:
        by_parameters = changes[..., :1] * self.of_parameters
        by_time = changes[..., 1:] * time_shares
        return np.asarray(np.sqrt(known**2 + by_parameters**2 + by_time**2))


def _weighted(weights: Array, values: Array) -> Array:
    """Return sums (..., *shape) of values (n_runs, *shape) with weights (..., n_runs)."""
    sums = weights[..., None, :] @ values.reshape(len(values), -1)
    return np.asarray(sums.reshape(*weights.shape[:-1], *values.shape[1:]))


def compared_snapshots(n_snapshots: int) -> Indices:
    """Return the snapshots of a training run at which its errors are known."""
    return np.arange(0, n_snapshots, max(1, (n_snapshots - 1) // N_COMPARED))


def accumulated(time: Array, residual: Array, decay_rate: float | Array) -> Array:
    """Return E (..., n_snapshots), the residual's integral with decay.

    Residuals (..., n_snapshots) vary linearly between snapshots; decay rates have shape (...).
    """
    rate = np.asarray(decay_rate)[..., None]
    steps = np.diff(time)
    remains = np.exp(-rate * steps)
    mean = (1.0 - remains) / (rate * steps)
    older, newer = (mean - remains) / rate, (1.0 - mean) / rate
    passed = older * residual[..., :-1] + newer * residual[..., 1:]
    out = np.zeros((*passed.shape[:-1], len(time)))
    if out.ndim == 1:
        # The same sums in plain Python: quicker for a single run.
        sums = [0.0]
        for share, more in zip(remains.tolist(), passed.tolist(), strict=True):
            sums.append(share * sums[-1] + more)
        return np.array(sums)
    for k in range(len(steps)):
        out[..., k + 1] = remains[..., k] * out[..., k] + passed[..., k]
    return out


def field_of(quantity: str) -> int:
    """Return 1 for outputs of the pressure field, 0 for others, which depend on the velocity.

    Forces on walls follow from the velocity in the whole fluid.
    """
    return int(MEASURABLE[quantity].of_field == "pressure")


@dataclass(frozen=True)
class OutputErrors:
    """The expected errors of an output, such as the velocity at a probe."""

    noise: Array
    """(n_snapshots, *shape) mean square of the error's part that varies faster than sound."""
    share: Array
    """(*shape) mean square of the rest, relative to that of the field's error."""

    def at(self, field: Array) -> Array:
        """Return the expected errors (..., n_instants, *shape) of the output in some runs.

        `field` (..., n_instants) are the estimated errors of the field.
        """
        noise = self.noise[np.minimum(np.arange(field.shape[-1]), len(self.noise) - 1)]
        return np.asarray(np.sqrt(noise + np.multiply.outer(field**2, self.share)))


def output_errors(
    differences: Array, fields: Array, missed: Array, averages: Array
) -> OutputErrors:
    """Return the errors of an output from those of held-out training runs.

    Its error has a part within the basis and one that the basis misses. Over the error of the
    field, the first is that of held-out training runs, and the second is `missed`. Both count in
    full, as if all of the field's error were of either kind. Squares are averaged over the runs; of
    noise, over a tenth of the time before and after.

    Parameters
    ----------
    differences : (n_runs, n_snapshots, *shape), full training runs minus predicted ones. Diverged
        runs have values that are not finite, and are left out.
    fields : (n_runs, n_snapshots), the errors of the field in these runs.
    missed : (*shape) of `sphrom.reduction.held_out.output_shares`.
    averages : weights of a moving average over snapshots that removes sound.
    """
    finite = np.isfinite(differences).all(axis=tuple(range(1, differences.ndim)))
    known = differences[finite]
    slow = np.stack([smoothed(run, averages) for run in known])
    late = int(LEFT_OUT * known.shape[1])
    # The sound that a start emits is the same in all runs.
    slow[:, :late] = known[:, :late]
    around = hat(1 + known.shape[1] // N_PARTS)
    noise = smoothed(np.mean((known - slow) ** 2, axis=0), around)
    of_field = float(np.mean(fields[finite][:, late:] ** 2))
    within = np.mean(slow[:, late:] ** 2, axis=(0, 1)) / (of_field if of_field > 0.0 else np.inf)
    return OutputErrors(noise, within + missed**2)


def calibrate_errors(
    time: Array,
    coordinates: Array,
    residuals: Array,
    errors: Array,
    compared: Indices,
    places: Array,
    shares: UnheldShares,
) -> ErrorCalibration | None:
    """Fit the constants and the decay rate to training runs.

    Return None if nothing can be fitted: residuals or errors are zero, or every run diverged.

    Parameters
    ----------
    time : (n_snapshots,) at equal intervals [s].
    coordinates : (n_runs, n_snapshots, n_modes), NaN from a divergence on; such runs are left out.
    residuals : (n_runs, n_snapshots).
    errors : (n_runs, n_compared, 2), at the snapshots `compared` (n_compared,).
    places : (n_runs, n_parameters), as `interpolation_weights` measures distances.
    """
    length = time[-1] - time[0]
    late = time[compared] - time[0] >= LEFT_OUT * length
    usable = np.flatnonzero(
        np.isfinite(coordinates).all(axis=(1, 2))
        & (residuals > 0.0).any(axis=1)
        & np.any(np.all(errors[:, late] > 0.0, axis=2), axis=1)
    )
    if len(time) < 2 or not len(usable):
        return None
    tried = []
    for rate in np.geomspace(SLOWEST / length, (len(time) - 1) / length, N_RATES):
        integrals = accumulated(time, residuals[usable], np.full(len(usable), rate))
        of_runs = []
        for integral, error in zip(
            integrals[:, compared[late]], errors[usable][:, late], strict=True
        ):
            some = (integral > 0.0) & (error > 0.0).all(axis=1)
            of_runs.append(np.log(error[some] / integral[some, None]))
        spread = sum(float(ratios.var(axis=0).sum()) * len(ratios) for ratios in of_runs)
        tried.append((spread, rate, of_runs))
    _, rate, ratios = min(tried, key=lambda trial: trial[0])
    if not all(map(len, ratios)):
        return None
    middle = np.stack([of_run.mean(axis=0) for of_run in ratios])
    places = places[usable]
    return ErrorCalibration(
        decay_rate=float(rate),
        constants=np.exp(middle),
        factors=_factors(ratios, middle, places),
        places=places,
        coordinates=coordinates[usable],
        shares=ChangeShares(parameters=shares.parameters, time=shares.time[usable]),
    )


def _factors(ratios: Sequence[Array], middle: Array, places: Array) -> Array:
    """Return the factors (2,) between the runs' constants and their predictions by other runs."""
    misses = []
    for run, of_run in enumerate(ratios):
        others = np.arange(len(ratios)) != run
        expected = middle[run]
        if others.any():
            expected = interpolation_weights(places[others], places[run])[0] @ middle[others]
        misses.append(np.abs(of_run - expected))
    return np.asarray(np.exp(np.quantile(np.concatenate(misses), WITHIN, axis=0)))
