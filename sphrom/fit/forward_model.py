"""A fitted model: its histories at the measured times, and samples of its errors in them.

The samples come from the training runs. The model repeats each of them without the correction from
that run, so its histories differ from those of the full run like a prediction, with the same
correlations over time and between places. The differences are scaled by the model's estimated error
at the fitted parameters over that of the training run, both root mean squares over the fluid and
the run: that of the velocity for flow rates too, and for forces the larger of both. Those of a
model without equations are scaled by the estimated error of each measurement.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Box, Ranges
from sphrom.errors import CaseError, UnstableError
from sphrom.fit.measurements import UNNAMED, History
from sphrom.metrics.measures import FieldMeasure, Quantities, combined, items
from sphrom.metrics.quantities import MEASURABLE, PLACED
from sphrom.metrics.series import at_instants
from sphrom.models.contract import Ability, Model
from sphrom.models.points.fast_model import FastModel
from sphrom.models.points.quantities import quantities_of
from sphrom.reduction import reference_model
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.exponential_steps import ExponentialModel
from sphrom.reduction.reduced_measures import ReducedMeasure, project_measures
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps
from sphrom.setup.particles import MeasuredFields
from sphrom.store.trajectory import snapshot_fields
from sphrom.text import exact

TrainingDifferences = dict[Hashable, tuple[Array, Array]]
"""Differences in training runs with the sizes of errors, by basis and histories, for all fits."""

DIFFERENCE = 1e-3
"""Difference of places from which derivatives of models without sensitivities follow."""
FINER = 2
"""Number of steps relative to that of the finest run; all parameters use the same number."""


def box_of(ranges: Ranges, values: Mapping[str, float]) -> Box:
    """Return the box of free parameters, with the values of the others.

    Raises CaseError when no parameter is free, or a free one has no range.
    """
    flat = [name for name, (low, high) in ranges.items() if low == high]
    if flat:
        raise CaseError(
            f"fit.parameters: {flat[0]} has only one trained value, {exact(ranges[flat[0]][0])}, "
            "so it has no range; give its value, or a range"
        )
    if not ranges:
        raise CaseError("fit.parameters: fixes all parameters; give at least one a range")
    return Box(ranges, values)


class FittedModel:
    """A model's values at the measured times and places, over the unit box of free parameters."""

    def __init__(self, fast: Model[Any], box: Box, histories: Sequence[History]) -> None:
        self.fast = fast
        self.box = box
        self.histories = tuple(histories)
        self._case = fast.workspace.case
        unnamed = dict.fromkeys(h.place for h in histories if h.place is not None)
        times = [h.time for h in histories]
        self._instants, self._at = np.unique(np.concatenate(times), return_inverse=True)
        self._which = np.repeat(np.arange(len(times)), [len(time) for time in times])
        self._places = {place: k for k, place in enumerate(unnamed)}

    def point(self, place: Array) -> ParameterPoint:
        """Return the parameter point at a place in the unit box."""
        return self._case.plan.point(self.box.values(place))

    def prepare(self, starts: Sequence[Array]) -> None:
        """Prepare runs at all places, starting from some."""

    def times(self, place: Array) -> Array:
        """Return the times (n_snapshots,) [s] of the run at a place."""
        return np.asarray(self.fast.at(self.point(place)).output_times.time)

    def error_samples(self, place: Array, known: TrainingDifferences) -> Array | None:
        """Return samples of errors of histories (n_samples, n_snapshots, n_histories) at a place.

        Returns None without error estimates, or if necessary full training runs were removed.

        Parameters
        ----------
        known : a cache of the differences in training runs, to which new ones are added.
        """
        run = self.fast.run(self.point(place))
        if any(history.measure not in run.measured_errors for history in self.histories):
            return None
        expected = np.sqrt(np.mean(self.stacked(run.measured_errors) ** 2, axis=0))
        steps = self._case.plan.steps
        samples = []
        for each in self.fast.trained_differences([run.point]):
            differences = self.stacked(each.measured)
            sizes = np.sqrt(np.mean(differences**2, axis=0))
            factors = expected / np.where(sizes > 0.0, sizes, 1.0)
            time = steps.start_time + steps.snapshot_interval * np.arange(len(differences))
            histories = (differences * factors).T
            samples.append([np.interp(run.time, time, history) for history in histories])
        return np.array(samples).transpose(0, 2, 1)

    def __call__(self, place: Array) -> tuple[Array, Array] | None:
        """Return values (n_values,) and derivatives (n_values, n_free) at a place."""
        if (histories := self.over_time(place)) is None:
            return None
        time, values, slopes = histories
        return self.at_instants(time, values), self.at_instants(time, slopes)

    def over_time(self, place: Array) -> tuple[Array, Array, Array] | None:
        """Return the histories at all snapshots, and their derivatives with respect to the place.

        Times are (n_snapshots,), histories (n_snapshots, n_histories) and derivatives
        (n_snapshots, n_histories, n_free). Returns None if the run is unstable or has no frequency.
        """
        found = self._histories_at(place)
        slopes = []
        for k in range(len(place)):
            ends = np.clip(place[k] + DIFFERENCE * np.array([-1.0, 1.0]), 0.0, 1.0)
            moved = (np.where(np.arange(len(place)) == k, end, place) for end in ends)
            low, high = map(self._histories_at, moved)
            if low is None or high is None:
                return None
            slopes.append((high[1] - low[1]) / np.ptp(ends))
        return None if found is None else (*found, np.stack(slopes, axis=-1))

    def _histories_at(self, place: Array) -> tuple[Array, Array] | None:
        run = self.fast.run(self.point(place))
        if run.failure is not None:
            return None
        measured = run.measured | run.oscillations
        if self._places:
            samples = run.sampled(np.array(list(self._places)))
            measured[UNNAMED] = {"velocity": samples.velocity, "pressure": samples.pressure}
        found = self.stacked(measured)
        return (run.time, found) if np.isfinite(found).all() else None

    def stacked(self, measured: Mapping[str, Quantities]) -> Array:
        """Return the fitted histories (n_snapshots, n_histories) among all measurements."""
        return np.stack([self._history(measured, h) for h in self.histories], axis=-1)

    def _history(self, measured: Mapping[str, Quantities], history: History) -> Array:
        values = measured[history.measure][history.quantity]
        if history.quantity in PLACED:
            values = values[:, 0 if history.place is None else self._places[history.place]]
        return values if history.component is None else values[:, history.component]

    def at_instants(self, time: Array, histories: Array) -> Array:
        """Return histories (n_snapshots, n_histories, ...) at measured times, by cubic splines."""
        histories = at_instants(time, histories, self._instants)
        return histories[self._at, self._which]


class FittedEquations(FittedModel):
    """The fitted values of a model whose derivatives follow from its equations."""

    fast: FastModel

    def __init__(self, fast: Model[Any], box: Box, histories: Sequence[History]) -> None:
        super().__init__(fast, box, histories)
        self.unnamed: MeasuredFields | None = None
        """Samples fields at measured places that the case does not name, if there are any."""
        if self._places:
            places = np.array(list(self._places))
            self.unnamed = MeasuredFields(self._case, {UNNAMED: FieldMeasure(places)})
        self._measures: dict[str, Mapping[str, ReducedMeasure]] = {}
        self._stepped: dict[str, ReferenceModel] = {}
        self._n_steps = 1

    def prepare(self, starts: Sequence[Array]) -> None:
        """Choose a number of steps for all runs that is fine enough for those at the starts."""
        most = 1
        for point in map(self.point, starts):
            reduced = self.fast.at(point)
            self._stepped.setdefault(self.fast.basis_at(point), reduced)
            with suppress(UnstableError):
                most = max(most, reference_model.automatic(reduced).steps.n_steps)
        self._n_steps = FINER * most

    def reduced(self, point: ParameterPoint, basis: str | None = None) -> ReferenceModel:
        """Return the model at a point, with measures at the places that the case does not name.

        Parameters
        ----------
        basis : name of a basis, by default that of the point.
        """
        basis = self.fast.basis_at(point) if basis is None else basis
        model = self.fast.on_basis(basis)
        reduced = model.at(point)
        if basis not in self._stepped:
            self._stepped[basis] = model.projected(model.points[0], in_training=True)
        if basis not in self._measures:
            self._measures[basis] = {}
            if (fields := self.unnamed) is not None:
                self._measures[basis] = project_measures(
                    reduced.basis, model.values, fields.position, fields.of_fields
                )
        measures = {**reduced.measures, **self._measures[basis]}
        return replace(reduced.with_steps_of(self._stepped[basis]), measures=measures)

    def integrator(self, reduced: ReferenceModel) -> Integrator:
        """Return an integrator of a model with the same number of steps at all parameters."""

        def steps(reduced: ReferenceModel) -> Steps:
            assert reduced.linear is not None
            system = ExponentialModel(reduced.polynomial, reduced.linear)
            return Steps(reduced, system, self._n_steps)

        return reference_model.choose(reduced, steps)

    def over_time(self, place: Array) -> tuple[Array, Array, Array] | None:
        """Return the histories at all snapshots, with derivatives from the model's equations."""
        point = self.point(place)
        reduced = self.reduced(point)
        try:
            steps = self.integrator(reduced)
            run = self.fast.tangents(point, self.box.names, reduced, integrator=steps)
        except UnstableError:
            return None
        measured = quantities_of(self._case, reduced, reduced.output_times.time, run.run)
        oscillations = self._case.plan.oscillations
        slopes = []
        regime = self.fast.regime(point)
        histories = self.stacked(measured | oscillations.of(run.time, measured, regime))
        for k, name in enumerate(run.parameters):
            changes = items(run.measured, k)
            step = self._case.plan.small_step(point, name)
            sides = (combined(measured, changes, part * step) for part in (-0.5, 0.5))
            low, high = (oscillations.of(run.time, side) for side in sides)
            rates = combined(high, low, -1.0)
            changes |= {n: {q: v / step for q, v in rate.items()} for n, rate in rates.items()}
            slopes.append(self.stacked(changes))
        if not np.isfinite(histories).all():
            return None
        return run.time, histories, np.stack(slopes, axis=-1) * self.box.slopes(place)

    def error_samples(self, place: Array, known: TrainingDifferences) -> Array | None:
        """Return samples of errors (n_samples, n_snapshots, n_histories), scaled to a place."""
        fast = self.fast
        case = fast.workspace.case
        point = self.point(place)
        name = fast.basis_at(point)
        # Places that the case does not name are sampled in the full runs.
        needed = map(fast.workspace.full_run, case.plan.bases[name] if self.unnamed else ())
        if not case.plan.has_error_estimate(name) or not all(t.path.exists() for t in needed):
            return None
        reduced = self.reduced(point)
        run = fast.run(point, reduced, self.integrator(reduced))
        if (estimate := run.estimate) is None:
            return None
        key = (name, tuple((h.measure, h.place, h.quantity, h.component) for h in self.histories))
        if key not in known:
            known[key] = self._differences(name)
        differences, sizes = known[key]
        if not len(differences):
            return None
        ratios = np.sqrt(np.mean(estimate.errors**2, axis=0) / np.mean(sizes**2, axis=1))
        of_fields = {"velocity": ratios[:, 0], "pressure": ratios[:, 1]}
        found = (MEASURABLE.get(h.quantity) for h in self.histories)
        factors = [of_fields.get(q.of_field if q else "", ratios.max(axis=1)) for q in found]
        scaled = differences * np.stack(factors, axis=1)[:, None]
        steps = case.plan.steps
        time = steps.start_time + steps.snapshot_interval * compared_snapshots(steps.n_snapshots)
        samples = [[np.interp(run.time, time, h) for h in sample.T] for sample in scaled]
        return np.array(samples).transpose(0, 2, 1)

    def _differences(self, name: str) -> tuple[Array, Array]:
        """Return the differences of histories in training runs, and the sizes of errors.

        They are (n_runs, n_compared, n_histories) and (n_runs, n_compared, 2) [m/s], over the
        fluid, of complete runs.
        """
        workspace = self.fast.workspace
        trained = self.fast.on_basis(name)
        points = trained.points
        compared = compared_snapshots(workspace.case.plan.steps.n_snapshots)
        differences = []
        sizes = []
        oscillations = workspace.case.plan.oscillations
        if (errors := trained.errors) is None or (known := errors.held_out) is None:
            return np.zeros(0), np.zeros(0)
        for row, (k, reduced, coordinates) in enumerate(trained.held_out()):
            change = items(trained.differences, row)
            time = reduced.output_times.time
            predicted = quantities_of(workspace.case, reduced, time, coordinates)
            full = oscillations.of(time, combined(predicted, change, 1.0))
            change |= combined(full, oscillations.of(time, predicted), -1.0)
            change = items(change, compared)
            if (fields := self.unnamed) is not None:
                measure = self.reduced(points[k], name).measures[UNNAMED]
                states = reduced.with_pressure(time, coordinates)[compared]
                model_fields = measure.at(states, reduced.mean_density_fluctuation)
                with workspace.open(workspace.full_run(points[k])) as run:
                    full_fields = [fields(*snapshot_fields(run, s))[UNNAMED] for s in compared]
                change[UNNAMED] = {
                    q: np.stack([f[q] for f in full_fields]) - model_fields[q] for q in PLACED
                }
            histories = self.stacked(change)
            if np.isfinite(histories).all():  # otherwise the run does not oscillate
                differences.append(histories)
                sizes.append(known.errors[row])
        return np.array(differences), np.array(sizes)


def fitted_model(fast: Model[Any], box: Box, histories: Sequence[History]) -> FittedModel:
    """Return a model to fit."""
    has_tangents = fast.family.can(Ability.SENSITIVITIES)
    return (FittedEquations if has_tangents else FittedModel)(fast, box, histories)
