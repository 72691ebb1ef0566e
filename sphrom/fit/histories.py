"""Histories of a model at the instants of measured ones, and their derivatives by parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.errors import UnstableError
from sphrom.fit.measurements import UNNAMED, History
from sphrom.metrics.measures import PLACED, FieldMeasure, Quantities
from sphrom.online.basis_model import fields_of, quantities_of
from sphrom.online.fast_model import FastModel
from sphrom.online.sensitivities import Tangents, tangents
from sphrom.reduction import reference_model
from sphrom.reduction.exponential import ExponentialModel
from sphrom.reduction.reduced_measures import ReducedMeasure, project_measures
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps
from sphrom.setup.measured_fields import MeasuredFields, sampler
from sphrom.store.bases import read_points

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FINER = 2
"""Steps over those that runs take: they are the same for all parameters, and have room for all."""


@dataclass(frozen=True)
class Box:
    """The ranges of the free parameters, and the values of the others."""

    lower: Mapping[str, float]
    upper: Mapping[str, float]
    fixed: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return tuple(self.lower)

    def values(self, place: Array) -> dict[str, float]:
        """Return the values by name of all parameters at a place (n_free,) in the unit box.

        Reynolds numbers are spread by their logarithm, like viscosities.
        """
        free = {n: self._value(n, x) for n, x in zip(self.names, place.tolist(), strict=True)}
        return {**self.fixed, **free}

    def _value(self, name: str, share: float) -> float:
        low, high = self.lower[name], self.upper[name]
        if name == REYNOLDS:
            return low * (high / low) ** share
        return low + (high - low) * share

    def slopes(self, place: Array) -> Array:
        """Return the derivatives (n_free,) of the free values by their places."""
        values = self.values(place)
        return np.array(
            [
                values[n] * math.log(self.upper[n] / self.lower[n])
                if n == REYNOLDS
                else self.upper[n] - self.lower[n]
                for n in self.names
            ]
        )

    def interval(self, name: str, share: float, half_width: float) -> tuple[float, float]:
        """Return the values about one, within the range."""
        ends = (max(0.0, share - half_width), min(1.0, share + half_width))
        low, high = (self._value(name, end) for end in ends)
        return low, high


class FittedModel:
    """A model's values where histories were measured, over the unit box of free parameters."""

    def __init__(self, fast: FastModel, box: Box, histories: Sequence[History]) -> None:
        self.fast, self.box = fast, box
        self.histories = tuple(histories)
        self._case = fast.workspace.case
        unnamed = dict.fromkeys(h.place for h in histories if h.place is not None)
        self._places = {place: k for k, place in enumerate(unnamed)}
        self._measures: dict[str, Mapping[str, ReducedMeasure]] = {}
        self._linear: dict[str, Sequence[Array | None]] = {}
        self._n_steps = 1

    def point(self, place: Array) -> ParameterPoint:
        """Return the parameter point at a place in the unit box."""
        return self._case.point(self.box.values(place))

    def time(self, place: Array) -> Array:
        """Return the instants (n_snapshots,) of runs [s]."""
        return self.reduced(self.point(place)).output_times.time

    def prepare(self, starts: Sequence[Array]) -> None:
        """Choose the steps of all runs, such that those from starts are fine enough."""
        taken = [self._automatic_steps(start) for start in starts]
        self._n_steps = FINER * max(taken, default=1)

    def _automatic_steps(self, place: Array) -> int:
        point = self.point(place)
        reduced = self.fast.at(point)
        self._linear.setdefault(self.fast.basis_at(point), reduced.linear_parts)
        try:
            return reference_model.automatic(reduced).n_steps
        except UnstableError:
            return 1

    def reduced(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a point, with what is measured at places of one's own."""
        return self.reduced_in(point, self.fast.basis_at(point))

    def reduced_in(self, point: ParameterPoint, basis: str) -> ReferenceModel:
        """Return the model at a point in a basis, with what is measured at places of one's own."""
        found = self.fast.on_basis(basis).equations(point)
        if basis not in self._linear:
            model = self.fast.on_basis(basis)
            (trained,) = model.projected(model.points[:1], in_training=True)
            self._linear[basis] = trained.linear_parts
        if basis not in self._measures:
            self._measures[basis] = self._projected(found)
        measures = {**found.measures, **self._measures[basis]}
        return replace(found.with_linear_parts(self._linear[basis]), measures=measures)

    def _projected(self, reduced: ReferenceModel) -> Mapping[str, ReducedMeasure]:
        """Project the fields at the places that the case doesn't name."""
        fields = self.fields_at_places()
        if fields is None:
            return {}
        position = read_points(self.fast.workspace)
        return project_measures(reduced.basis, lambda *state: fields(position, *state))

    def fields_at_places(self) -> MeasuredFields | None:
        """Return what samples fields at the places that the case doesn't name, if there are any."""
        if not self._places:
            return None
        places = np.array(list(self._places))
        sample = sampler(self._case, places)
        return MeasuredFields({UNNAMED: FieldMeasure(places)}, sample, self._case.sound_speed)

    def integrator(self, reduced: ReferenceModel) -> Integrator:
        """Return the steps of a model, as many at all parameters."""
        return reference_model.choose(reduced, self._steps)

    def _steps(self, reduced: ReferenceModel) -> Steps:
        assert reduced.linear is not None
        system = ExponentialModel([reduced.polynomial], reduced.linear)
        return Steps(reduced, system, self._n_steps)

    def tangents(self, place: Array) -> tuple[ReferenceModel, Tangents] | None:
        """Return the model and a run with derivatives at a place; None where it is unstable."""
        point = self.point(place)
        reduced = self.reduced(point)
        try:
            steps = self.integrator(reduced)
            run = tangents(self.fast, point, self.box.names, reduced, integrator=steps)
        except UnstableError:
            return None
        return reduced, run

    def __call__(self, place: Array) -> tuple[Array, Array] | None:
        """Return values (n_values,) and derivatives (n_values, n_free) at a place."""
        found = self.whole(place)
        if found is None:
            return None
        time, values, slopes = found
        return self.at_instants(time, values), self.at_instants(time, slopes)

    def whole(self, place: Array) -> tuple[Array, Array, Array] | None:
        """Return the histories at all snapshots, and their derivatives by the place.

        Times are (n_snapshots,), histories (n_snapshots, n_histories), derivatives
        (n_snapshots, n_histories, n_free); None where the run is unstable.
        """
        found = self.tangents(place)
        if found is None:
            return None
        reduced, run = found
        values = self.stacked(self.quantities(self.point(place), reduced, run.coordinates))
        by_parameter = [self.stacked(self._changes(run, k)) for k in range(len(run.names))]
        slopes = np.stack(by_parameter, axis=-1) * self.box.slopes(place)
        return run.time, values, slopes

    def quantities(
        self, point: ParameterPoint, reduced: ReferenceModel, coordinates: Array
    ) -> dict[str, Quantities]:
        """Return what is measured in coordinates (n_snapshots, n_modes) of a run."""
        time = reduced.output_times.time
        own = replace(reduced, measures={n: reduced.measures[n] for n in self._named(reduced)})
        return {
            **quantities_of(self._case, point, own, time, coordinates),
            **fields_of(reduced.measures, reduced.mean_density_fluctuation, coordinates),
        }

    def _named(self, reduced: ReferenceModel) -> list[str]:
        return [name for name in reduced.measures if name in self._case.scene.measure]

    def _changes(self, run: Tangents, k: int) -> dict[str, Quantities]:
        loads = {name: each[k].sum(axis=1) for name, each in run.forces.items()}
        forces = {n: {"force": each[:, :2], "torque": each[:, 2]} for n, each in loads.items()}
        return {**forces, **{n: {q: v[k] for q, v in m.items()} for n, m in run.measured.items()}}

    def stacked(self, measured: Mapping[str, Quantities]) -> Array:
        """Return the histories (n_snapshots, n_histories) among what is measured."""
        return np.stack([self._history(measured, h) for h in self.histories], axis=-1)

    def _history(self, measured: Mapping[str, Quantities], history: History) -> Array:
        values = measured[history.measure][history.quantity]
        if history.quantity in PLACED:
            values = values[:, 0 if history.place is None else self._places[history.place]]
        return values if history.component is None else values[:, history.component]

    @cached_property
    def _instants(self) -> tuple[Array, Indices, Indices]:
        """The instants of all values, and of each value the instant and the history."""
        times = np.concatenate([h.time for h in self.histories])
        which = np.repeat(np.arange(len(self.histories)), [len(h.time) for h in self.histories])
        unique, at = np.unique(times, return_inverse=True)
        return unique, at, which

    def at_instants(self, time: Array, histories: Array) -> Array:
        """Return histories (n_snapshots, n_histories, ...) at the instants of values."""
        instants, at, which = self._instants
        return interpolated(time, histories, instants)[at, which]


def interpolated(time: Array, histories: Array, instants: Array) -> Array:
    """Return histories (n_snapshots, ...) at instants, by cubic splines over time."""
    if len(time) == len(instants) and np.allclose(time, instants, rtol=0.0, atol=1e-12):
        return histories
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time, histories, k=min(3, len(time) - 1))
    return np.asarray(spline(np.clip(instants, time[0], time[-1])))
