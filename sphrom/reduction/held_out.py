"""Held-out snapshots and runs: which share of a change a basis misses, and how many modes to use.

Training errors do not show the part of a change from the training states that the basis cannot
represent, but a basis of fewer snapshots does. With e the root mean square error of a field's best
approximation,

    share^2 = (e^2 of a basis without the held-out snapshots - e^2 of one with them) / |change|^2,

over the held-out snapshots. Their change is the distance, in the norm of the inner product, from
the state that the other snapshots predict. Shares are between zero and about one, by number of
modes, of the velocity, the pressure, and the pressure in modes of its own
(`sphrom.reduction.own_pressure`). There are two kinds of held-out snapshots:

- each training run in turn: its change is from the other runs, interpolated at its parameters;
- the second half of all training runs: its change is from the state at half time.

An output, such as the velocity at a probe, is linear in the state. Its values in the snapshots
determine the part outside of a basis, as the modes are sums of snapshots (`output_shares`).

Everything follows from the products of snapshots with each other, so the points are read once. The
products lose digits below the square root of rounding, far below the error of a basis.

`docs/modes.md` explains the choice of the numbers of modes, by the errors of training runs that are
predicted with their own correction and with one from the other runs. The basis and the calibration
are those of all runs: rates without the predicted run would lead to far worse choices.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, dataset
from sphrom.metrics.quantities import FROM_FIELDS, OF_WALLS, stored
from sphrom.reduction.correction import interpolation_weights, learn_correction
from sphrom.reduction.trial_basis import TrialBasis

OF_FIELDS = ", of velocity and of c0 rho'/rho0 minus its mean"
_UNHELD = (
    "root mean square error of the best approximation of training snapshots that are left out of a "
    "basis of 1, 2, ... modes, divided by the change {}: for the velocity, for c0 rho'/rho0 minus "
    "its mean, and for the latter in as many separate modes"
)

ROUNDING = 1e-13
"""Smallest eigenvalue of the products that counts as a mode, relative to the largest."""
UNTRIED = 3.0
"""Share of a change with the parameters over that with time, if only the latter was measured.

It is an order of magnitude. For training at Re 100 alone, errors at Re 105 to 600 correspond to 0.9
to 1.8 (Taylor-Green) and 2 to 4.3 (lid-driven cavity); at Re 50 to 70, to 0 to 0.2 and 5 to 6.
"""
LEFT_OUT = 0.1
"""Initial share of a run that is ignored, because runs start alike."""


@dataclass(frozen=True)
class SnapshotProducts:
    """Products (n_snapshots, n_snapshots) of snapshots with each other, run by run."""

    fields: tuple[Array, Array]
    """Means over the fluid: of the velocities, and of q minus its mean [m2/s2]."""
    states: Array
    """Products of whole states in the inner product that defines the modes."""
    means: Array
    """(n_snapshots,) mean density fluctuations of snapshots whose states have none, else zeros."""


def snapshot_products(
    basis: TrialBasis,
    n_snapshots: int,
    density_scale: float,
    blocks: Iterable[tuple[slice, Array, Array]],
) -> SnapshotProducts:
    """Sum the products of snapshots over blocks of points.

    A block is its points, the density fluctuations (n_snapshots, n) [kg/m3] and the velocities
    (n_snapshots, n, n_dim) [m/s]. `density_scale` times a density fluctuation is q.
    """
    density = np.zeros((n_snapshots, n_snapshots))
    flow = np.zeros((n_snapshots, n_snapshots))
    sums = np.zeros(n_snapshots)
    for rows, density_fluctuation, velocity in blocks:
        weights = basis.weights[rows]
        flat = velocity.reshape(n_snapshots, -1)
        density += (density_fluctuation * weights) @ density_fluctuation.T
        flow += (flat * np.repeat(weights, velocity.shape[2])) @ flat.T
        sums += density_fluctuation @ weights
    product = basis.inner_product
    total = float(basis.weights.sum())
    without_mean = density - np.outer(sums, sums) / total
    if basis.separate_mean:
        first = product.density_scale**2 * without_mean
    else:
        mixed = product.density_scale * product.density_offset * sums
        first = product.density_scale**2 * density + mixed + mixed[:, None]
        first += product.density_offset**2 * total
    fields = flow / total, density_scale**2 * without_mean / total
    return SnapshotProducts(fields, first + flow, sums / total * basis.separate_mean)


class FieldProducts(Record):
    """Mean products of training snapshots with a basis, by field: velocity, then q."""

    gram: Array = dataset(
        "field column column", "of the modes",
        "mean products of modes and of the constant part of states with each other" + OF_FIELDS,
    )  # fmt: skip
    projections: Array = dataset(
        "training_run compared_snapshot field column", "of the modes",
        "mean products of some training snapshots with these" + OF_FIELDS,
    )  # fmt: skip
    squares: Array = dataset(
        "training_run compared_snapshot field", "m2/s2",
        "mean squares of those snapshots" + OF_FIELDS,
    )  # fmt: skip

    def only(self, modes: Indices, n_modes: int) -> FieldProducts:
        """Return the products of some of the `n_modes` modes and of the constant part of states."""
        kept = np.concatenate((modes, np.arange(n_modes, self.gram.shape[1])))
        return FieldProducts(
            gram=self.gram[:, kept][:, :, kept],
            projections=self.projections[..., kept],
            squares=self.squares,
        )

    def errors(self, run: int, coordinates: Array) -> Array:
        """Return the root mean square errors (n_snapshots, 2) of a run.

        Its coordinates (n_snapshots, n_modes) are at the snapshots of the products.
        """
        factors = self._factors(coordinates)
        products = np.einsum("sfc,sc->sf", self.projections[run], factors)
        return _root(self.squares[run] - 2.0 * products + self._squares_of(factors))

    def sizes(self, coordinates: Array) -> Array:
        """Return the root mean squares (..., n_states, 2) of states (..., n_states, n_modes)."""
        return _root(self._squares_of(self._factors(coordinates)))

    def _factors(self, coordinates: Array) -> Array:
        n_constant = self.gram.shape[1] - coordinates.shape[-1]
        constant = np.ones((*coordinates.shape[:-1], n_constant))
        return np.concatenate((coordinates, constant), axis=-1)

    def _squares_of(self, factors: Array) -> Array:
        each = factors[..., None, :, :]
        return np.sum((each @ self.gram) * each, axis=-1).swapaxes(-1, -2)


def _root(squares: Array) -> Array:
    """Return square roots, with zero for values that rounding made negative."""
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


class UnheldShares(Record):
    """Missed shares of changes [m/s over the norm] by number of modes, for three fields."""

    parameters: Array = dataset(
        "size unheld_field", "m/s over the inner product's",
        _UNHELD.format("from the other training runs"),
    )  # fmt: skip
    time: Array = dataset(
        "run size unheld_field", "m/s over the inner product's", _UNHELD.format("since half time")
    )


class OutputShares(Record):
    """The part of an output that bases of 1, 2, ... modes miss, over that of its field."""

    quantities: Mapping[str, Array] = stored(
        (*FROM_FIELDS, *OF_WALLS), "size", units="{} over m/s",
        meaning="{}: root mean square that a basis of 1, 2, ... modes misses in held-out training "
        "runs, divided by that of the velocity, or of c0 rho'/rho0 for pressures",
    )  # fmt: skip


def unheld_shares(products: SnapshotProducts, places: Array, n_modes: int) -> UnheldShares:
    """Measure the shares by leaving out runs and second halves of runs.

    The share of a change with the parameters is unknown with a single training run, or if each run
    lies between the others. It is then `UNTRIED` times the share of the change with time.

    Parameters
    ----------
    places : (n_runs, n_parameters) of the runs, as `interpolation_weights` measures distances.
    n_modes : largest number of modes.
    """
    n_runs = len(places)
    snapshots = np.arange(len(products.states)).reshape(n_runs, -1)
    per_run = snapshots.shape[1]
    half = (per_run + 1) // 2
    time = np.ones((n_runs, n_modes, 3))
    for run in range(n_runs if half < per_run else 0):
        expected = np.zeros((len(products.states), per_run - half))
        expected[snapshots[run, half - 1]] = 1.0
        early = snapshots[:, :half].ravel()
        time[run] = _shares(products, early, snapshots[run, half:], expected, n_modes)
    parameters = [
        _shares(products, trained, left_out, expected, n_modes)
        for trained, left_out, expected in _runs_left_out(products, places)
    ]
    if not parameters:
        return UnheldShares(parameters=UNTRIED * time.max(axis=0), time=time)
    return UnheldShares(parameters=np.max(parameters, axis=0), time=time)


def output_shares(
    products: SnapshotProducts, outputs: Array, fields: Indices, places: Array, n_modes: int
) -> Array:
    """Return the root mean squares (n_modes, n_outputs) that bases miss of outputs, over a field's.

    As for fields, the error of a basis with the runs that were left out is subtracted. Shares are
    zero with a single training run, or if each run lies between the others.

    Parameters
    ----------
    outputs : (n_snapshots, n_outputs), linear in the states.
    fields : (n_outputs,) zero for the velocity, one for q.
    places : as in `unheld_shares`.
    """
    missed = np.zeros((n_modes, outputs.shape[1]))
    of_fields = np.zeros((n_modes, 3))
    for trained, left_out, _ in _runs_left_out(products, places):
        for known, sign in ((trained, 1.0), (np.arange(len(outputs)), -1.0)):
            modes, coordinates = _approximation(products.states, known, left_out, n_modes)
            own = modes.T @ outputs[known]
            for size in range(1, n_modes + 1):
                errors = outputs[left_out] - coordinates[:size].T @ own[:size]
                missed[size - 1] += sign * np.mean(errors**2, axis=0)
            of_fields += sign * _errors(products, known, left_out, n_modes)
    squares = of_fields[:, fields]
    return np.sqrt(np.maximum(missed, 0.0) / np.where(squares > 0.0, squares, np.inf))


def _runs_left_out(
    products: SnapshotProducts, places: Array
) -> Iterator[tuple[Indices, Indices, Array]]:
    """Yield the other snapshots, those of a run left out, and their predictions by the others.

    Runs between others are not left out. Predictions (n_snapshots, n_left_out) are weights.
    """
    n_runs = len(places)
    snapshots = np.arange(len(products.states)).reshape(n_runs, -1)
    late = int(LEFT_OUT * snapshots.shape[1])
    for run in range(n_runs if n_runs > 1 else 0):
        others = np.delete(np.arange(n_runs), run)
        weights, distance = interpolation_weights(places[others], places[run])
        if distance > 0.0:
            left_out = snapshots[run, late:]
            expected = np.zeros((len(products.states), len(left_out)))
            for other, weight in zip(others, weights, strict=True):
                expected[snapshots[other, late:], np.arange(len(left_out))] = weight
            yield snapshots[others].ravel(), left_out, expected


def _shares(
    products: SnapshotProducts, trained: Indices, left_out: Indices, expected: Array, n_modes: int
) -> Array:
    """Return the shares (n_modes, 3) of a change that a basis without that change misses.

    The change is the difference of the snapshots `left_out` from their predictions. `expected`
    (n_snapshots, n_left_out) has the weights of all snapshots in each prediction.
    """
    changes = -expected
    changes[left_out, np.arange(len(left_out))] += 1.0
    change = float(np.einsum("ik,ij,jk->", changes, products.states, changes))
    size = float(products.states[left_out, left_out].sum())
    if change <= ROUNDING * size:
        return np.zeros((n_modes, 3))
    everything = np.arange(len(products.states))
    without, with_them = (
        _errors(products, known, left_out, n_modes) for known in (trained, everything)
    )
    return np.asarray(np.sqrt(np.maximum(without - with_them, 0.0) * len(left_out) / change))


def _approximation(
    states: Array, trained: Indices, left_out: Indices, n_modes: int
) -> tuple[Array, Array]:
    """Return modes, as weights of the trained snapshots, and the coordinates of those left out.

    `states` are the products of the snapshots that define the modes. Shapes are (n_trained, n) and
    (n, n_left_out), with at most `n_modes` modes.
    """
    values, vectors = np.linalg.eigh(states[np.ix_(trained, trained)])
    kept = np.flatnonzero(values > ROUNDING * values[-1])[::-1][:n_modes]
    modes = vectors[:, kept] / np.sqrt(values[kept])
    return modes, modes.T @ states[np.ix_(trained, left_out)]


def _errors(products: SnapshotProducts, trained: Indices, left_out: Indices, n_modes: int) -> Array:
    """Return the mean square errors (n_modes, 3) of bases of `trained` in snapshots `left_out`."""
    errors = []
    velocity, pressure = products.fields
    for states, fields in ((products.states, (velocity, pressure)), (pressure, (pressure,))):
        modes, coordinates = _approximation(states, trained, left_out, n_modes)
        for field in fields:
            with_modes = modes.T @ field[np.ix_(trained, left_out)]
            of_modes = modes.T @ field[np.ix_(trained, trained)] @ modes
            of_sizes = []
            for size in range(1, n_modes + 1):
                held = coordinates[:size]
                among = of_modes[: len(held), : len(held)] @ held
                more = np.sum(held * (among - 2.0 * with_modes[:size]), axis=0)
                of_sizes.append(np.maximum(field[left_out, left_out] + more, 0.0).mean())
            errors.append(of_sizes)
    return np.array(errors).T


DIVERGED = 1e6
"""Relative error assigned if a run diverged."""
NEARER = 0.5
"""Distance of predictions from training runs, relative to that of held-out runs."""
CLOSE = 1.1
"""Velocity error, relative to the least one, up to which more integrated modes are preferred."""
ALIKE = 1.03
"""Product of errors, relative to the least one, up to which fewer modes are as good."""


def surrounded(places: Array) -> Indices:
    """Return the numbers of places that the others surround; all of them if there is none.

    Places are (n_places, n_parameters).
    """
    every = np.arange(len(places) if len(places) > 1 else 0)
    others = (np.delete(places, k, axis=0) for k in every)
    missed = [interpolation_weights(o, places[k])[1] for k, o in enumerate(others)]
    inside = np.flatnonzero(np.array(missed) == 0.0)
    return inside if len(inside) else np.arange(len(places))


@dataclass(frozen=True)
class TrainedSizes:
    """Training runs in all modes, and the data that determine their errors."""

    places: Array
    """(n_runs, n_parameters), scaled so that distances are comparable."""
    projected: Array
    """(n_runs, n_snapshots, n_all_modes), the coordinates of the full runs."""
    products: FieldProducts
    compared: Indices
    """(n_compared,), the snapshots of the products."""

    @property
    def largest(self) -> int:
        """The largest number of modes."""
        return self.projected.shape[2]

    @cached_property
    def judged(self) -> Indices:
        """The runs that the others surround in the parameters; all runs if there is none."""
        return surrounded(self.places)

    def errors(self, n_modes: int, integrated: Array) -> Array:
        """Return the expected errors (2,) of predictions, relative to the fields' sizes.

        Parameters
        ----------
        n_modes : of the model.
        integrated : (n_runs, n_snapshots, n_integrated), the model's runs in its first modes.
        """
        projected = self.projected[..., np.arange(n_modes)]
        first = np.arange(integrated.shape[2])
        if not np.isfinite(integrated).all():
            return np.full(2, DIVERGED)
        runs = np.zeros_like(projected)
        runs[..., first] = integrated
        groups = (first, np.arange(len(first), n_modes))
        correction = learn_correction(self.places, projected - runs, groups)
        known = unseen = self._squares(runs)
        if correction is not None:
            known = self._squares(runs + [correction.at(place) for place in self.places])
            unseen = self._squares(runs + [correction.held_out(place) for place in self.places])
        squares = known.mean(axis=0), unseen[self.judged].mean(axis=0)
        expected = np.average(squares, axis=0, weights=(1.0 - NEARER**2, NEARER**2))
        return np.minimum(np.sqrt(expected), DIVERGED)

    def _squares(self, runs: Array) -> Array:
        """Return mean square errors (n_runs, 2) of coordinates, relative to those of the fields."""
        products = self.products.only(np.arange(runs.shape[2]), self.largest)
        errors = [products.errors(k, run[self.compared]) for k, run in enumerate(runs)]
        return np.asarray(np.mean(np.square(errors), axis=1) / np.mean(products.squares, axis=1))


def best_size(errors: Array) -> int:
    """Return the smallest size, from 1, whose errors are as good as the best.

    Errors are (n_sizes, n_quantities); sizes are ranked by the product over the quantities.
    """
    products = np.prod(errors, axis=1)
    return int(np.flatnonzero(products <= ALIKE * products.min())[0]) + 1


def choose_integrated(sizes: TrainedSizes, runs: Sequence[Array]) -> tuple[Indices, Array]:
    """Return the best number of integrated modes of models with 1, 2, ... modes (n_sizes,).

    It is the largest with nearly the least error of the velocity: modes that are not integrated may
    not be predicted at all, and their pressure may not be that of the model. Return
    also the expected errors (n_sizes, 2). `runs` (n_runs, n_snapshots, n_integrated) are
    training runs, repeated by models that integrate 1, 2, ... modes. A single training run cannot
    predict coordinates at other parameters, so all modes are then integrated.
    """
    chosen, errors = [], []
    for n_modes in range(1, sizes.largest + 1):
        tried = runs[0 if len(sizes.places) > 1 else n_modes - 1 : n_modes]
        by_integrated = {run.shape[2]: sizes.errors(n_modes, run) for run in tried}
        least = min(error[0] for error in by_integrated.values())
        chosen.append(max(n for n, e in by_integrated.items() if e[0] <= CLOSE * least))
        errors.append(by_integrated[chosen[-1]])
    return np.array(chosen), np.array(errors)
