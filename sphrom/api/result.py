"""Results of runs of reduced models, as arrays and labelled datasets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arguments import finite_array
from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.measures import Measured, Samples, since, why_missing
from sphrom.metrics.quantities import AXES, MEASURABLE, PLACED, is_vector, unit_of
from sphrom.models.contract import ModelRun
from sphrom.models.estimates import ErrorEstimate
from sphrom.models.points.sensitivities import Tangents
from sphrom.setup.assembly import field_measures
from sphrom.signals import guarded
from sphrom.text import place_text

if TYPE_CHECKING:
    import xarray

Variable = tuple[Any, ...]
"""Axes, values and attributes of a variable of xarray."""


def labelled(dims: str, values: Array, units: str, meaning: str) -> Variable:
    """Return a variable for xarray; `dims` has the names of axes, separated by spaces."""
    return dims.split(), values, {"units": units, "long_name": meaning}


ERROR = "error_estimate_"
"""Prefix of the names of estimated errors."""


class Labels:
    """The names, axes and coordinates of variables for a case's measurements."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.n_dim = case.scene.domain.n_dim
        fields = case.scene.measured_fields.items()
        self._lines = {name: f" {name}_place" for name, m in fields if not m.quantities}
        self._known: dict[bytes, xarray.Coordinates] = {}

    def dataset(
        self,
        measured: Measured,
        time: Array,
        about: Mapping[str, Any],
        axes: str = "snapshot",
        regimes: Sequence[str | None] = (None,),
    ) -> xarray.Dataset:
        """Return a dataset of measurements at times (n_snapshots,) [s], with leading `axes`.

        `regimes` are those of all runs.
        """
        import xarray

        variables = {}
        for name, quantities in measured.items():
            own = name.removeprefix(ERROR)
            line = self._lines.get(own, "")
            of = f"{own}{', estimated error' * (own != name)}"
            for quantity, values in quantities.items():
                vector = is_vector(quantity)
                if quantity in PLACED and not line:  # a probe has one place
                    values = np.squeeze(values, axis=-1 - vector)
                dims, meaning = f"{axes}{line}{' component' * vector}", f"{quantity} of {of}"
                if quantity in MEASURABLE:
                    unit = unit_of(quantity, self.n_dim)
                else:  # an oscillation has one figure per run
                    dims = axes.removesuffix("snapshot")
                    values = values[..., 0]
                    unit = self.case.plan.oscillations[own].units_of(quantity)
                variables[f"{name}_{quantity}"] = labelled(dims, values, unit, meaning)
                variables[f"{name}_{quantity}"][2].update(
                    self._notes(own, quantity, values, regimes)
                )
        if (key := time.tobytes()) not in self._known:
            coordinates = axes_of(time, self.n_dim)
            for name, measure in field_measures(self.case).items():
                if not measure.is_integral:
                    dims = f"{self._lines.get(name, '')} component"
                    where = measure.position if name in self._lines else measure.position[0]
                    where = labelled(dims, where, "m", f"position of {name}")
                    coordinates[f"{name}_position"] = where
            self._known = {key: xarray.Dataset(coords=coordinates).set_xindex("time").coords}
        return xarray.Dataset(variables, self._known[key], dict(about))

    def _notes(
        self, name: str, quantity: str, values: Array, regimes: Sequence[str | None]
    ) -> dict[str, Any]:
        """Return attributes: `from_time` [s], and the reason why an oscillation is NaN."""
        plan = self.case.plan
        missing = dict[str, None]()
        if quantity not in MEASURABLE:  # one value per run
            runs = zip(regimes, np.isnan(values.reshape(-1)).tolist(), strict=True)
            missing = dict.fromkeys(why_missing(regime) for regime, is_lost in runs if is_lost)
        of = plan.oscillations.get(name)
        begin = plan.means_from.get(name, plan.settled_from) if of is None else of.from_time
        return {"from_time": begin} | ({"missing": "; ".join(missing)} if missing else {})

    def fields(
        self,
        points: ArrayLike,
        sampled: Callable[[Array], Samples],
        time: Array,
        about: Mapping[str, Any],
        axes: str = "snapshot",
    ) -> xarray.Dataset:
        """Return fields at points (n_points, n_dim) [m]; raise CaseError outside of the fluid."""
        import xarray

        position = finite_array(points, "points")
        domain = self.case.scene.domain
        if position.ndim != 2 or position.shape[1] != self.n_dim or not len(position):
            shape = f"(n_points, {self.n_dim})"
            raise CaseError(f"points: must have the shape {shape}; got {position.shape}")
        for place in position[~domain.contains(position)][:1]:
            raise CaseError(f"points: {place_text(place)} m is not in the fluid")
        samples = sampled(domain.wrap(position))
        dims = f"{axes} point"
        where = labelled("point component", position, "m", "position of each point")
        variables = {
            "velocity": labelled(f"{dims} component", samples.velocity, "m/s", "velocity"),
            "pressure": labelled(dims, samples.pressure, "Pa", "pressure"),
        }
        coordinates = axes_of(time, self.n_dim) | {"position": where}
        return xarray.Dataset(variables, coordinates, dict(about)).set_xindex("time")

    def runs(
        self,
        runs: Iterable[ModelRun],
        points: Sequence[Mapping[str, float]],
        model: str,
    ) -> xarray.Dataset:
        """Return the measurements of runs with estimated errors; NaN for unstable runs."""
        n_runs = len(points)
        measured = dict[str, dict[str, Array]]()
        time = np.zeros(0)
        status = np.full(n_runs, "unstable")
        regimes: list[str | None] = [None] * n_runs
        errors = np.full((3, n_runs), np.nan)
        for k, run in enumerate(runs):
            time = run.time
            if run.failure is not None:
                continue
            status[k] = "complete"
            regimes[k] = run.regime
            if (own := run.estimate) is not None:
                errors[:, k] = own.velocity_percent, own.pressure_percent, own.extrapolated
            estimates = {f"{ERROR}{name}": each for name, each in run.measured_errors.items()}
            estimates |= {
                f"{ERROR}{name}": {f: np.full(len(time), error) for f, error in each.items()}
                for name, each in run.oscillation_errors.items()
            }
            own_values = run.measured | run.oscillations
            for name, quantities in (own_values | estimates).items():
                stacked = measured.setdefault(name, {})
                for quantity, values in quantities.items():
                    if quantity not in stacked:
                        stacked[quantity] = np.full((n_runs, *values.shape), np.nan)
                    stacked[quantity][k] = values
        names = ("velocity", "%"), ("pressure", "%"), ("extrapolated", "1")
        figures = {
            f"{ERROR}{name}": labelled("run", each, unit, f"estimated error: {name}")
            for (name, unit), each in zip(names, errors, strict=True)
        }
        if any(regimes):
            figures["regime"] = ("run", [regime or "" for regime in regimes])
        whole = self.dataset(measured, time, {"model": model}, "run snapshot", regimes)
        along = {name: ("run", [point[name] for point in points]) for name in points[0]}
        return whole.assign(figures | {"status": ("run", status)}).assign_coords(along)


def rows_of(points: Mapping[str, ArrayLike]) -> list[dict[str, float]]:
    """Return the points of a table with a column (n_runs,) or a number per parameter."""
    try:
        columns = {str(name): finite_array(each, str(name)) for name, each in dict(points).items()}
        rows = np.stack(np.broadcast_arrays(*map(np.atleast_1d, columns.values())), axis=-1)
        if rows.ndim != 2:
            raise ValueError("got several axes")
    except (TypeError, ValueError) as error:
        raise CaseError("points: must be values by parameter, of equal lengths") from error
    if not len(rows):
        raise CaseError("points: are empty")
    return [dict(zip(columns, row, strict=True)) for row in rows.tolist()]


def axes_of(time: Array, n_dim: int) -> dict[str, Variable]:
    """Return the coordinates of snapshots and components."""
    times = labelled("snapshot", time, "s", "time of each snapshot")
    return {"time": times, "component": ("component", list(AXES[:n_dim]))}


@dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """A run of a reduced model, as returned by `Model.run`."""

    model: str
    """Name of the model."""
    parameters: dict[str, float]
    """Parameter values of the run."""
    time: Array
    """(n_snapshots,) times of snapshots [s]."""
    coordinates: Array
    """(n_snapshots, n_modes) generalized coordinates, in units of the basis's inner product."""
    correction: Array | None = None
    """(n_snapshots, n_modes) part of the coordinates that corrects errors of the model at training
    runs; None for a model without correction. The rest is the integral of its rates."""
    time_step: float
    """Time step [s]."""
    _labels: Labels
    _sample: Callable[[Array], Samples]
    _measured: Callable[[], Measured]
    _estimate: Callable[[], ErrorEstimate | None] = lambda: None
    _regime: str | None = None

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.parameters.items())
        return f"Result({self.model!r}, {values}, {len(self.time)} snapshots)"

    @property
    @guarded()
    def error_estimate(self) -> ErrorEstimate | None:
        """The estimated errors of the run; None on particles or without estimates in the case."""
        return self._estimate()

    @property
    @guarded()
    def measures(self) -> xarray.Dataset:
        """The measurements of the case, over time.

        The name of a variable is the measurement with the quantity: `drag_force` (snapshot,
        component) [N/m], `drag_torque` (snapshot) [N], `flux_flow_rate` (snapshot) [m2/s], for a
        probe `wake_velocity` (snapshot, component) [m/s] and `wake_pressure` (snapshot) [Pa], and
        for a line the same with an axis `profile_place`. The coordinate `wake_position` [m] is the
        place. In three dimensions forces are in [N], without torque, and flow rates in [m3/s].
        Oscillations have one value per run, such as `shedding_frequency` [Hz], NaN without
        an oscillation.
        """
        attributes = {"model": self.model, **self.parameters}
        labels = self._labels
        return labels.dataset(self._measured(), self.time, attributes, regimes=[self._regime])

    @property
    @guarded()
    def means(self) -> xarray.Dataset:
        """The means of `measures` over the times from each one's attribute `from_time` [s] on.

        They are NaN if the run ends before.
        """
        import xarray

        measures = self.measures
        means = {}
        for name, each in measures.items():
            if "snapshot" in each.dims:
                late = xarray.DataArray(since(self.time, each.from_time), dims="snapshot")
                means[name] = each.where(late).mean("snapshot", keep_attrs=True)
        return measures.drop_dims("snapshot").assign(means)

    @guarded()
    def fields(self, points: ArrayLike) -> xarray.Dataset:
        """Return velocity and pressure over time at points of the fluid.

        Parameters
        ----------
        points : positions (n_points, n_dim) [m]; along periodic axes also outside of the box.

        Returns
        -------
        A dataset of `velocity` (snapshot, point, component) [m/s] and `pressure` (snapshot, point)
        [Pa], with the coordinates `time` (snapshot) [s] and `position` (point, component) [m].

        Raises CaseError when points have another shape, or one is not in the fluid; ArtifactError
        when artifacts that the run depends on have changed since.
        """
        attributes = {"model": self.model, **self.parameters}
        return self._labels.fields(points, self._sample, self.time, attributes)


@dataclass(frozen=True, repr=False, kw_only=True)
class Sensitivities(Tangents):
    """The derivatives of a run per unit of a parameter, as returned by `Model.sensitivities`."""

    model: str
    """Name of the model."""
    at: dict[str, float]
    """Parameter values of the run."""
    _labels: Labels

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.at.items())
        names = ", ".join(self.parameters)
        return f"Sensitivities({self.model!r}, {values}, by {names}, {len(self.time)} snapshots)"

    @property
    def measures(self) -> xarray.Dataset:
        """The derivatives of `Result.measures`, with a first axis `parameter`."""
        attributes = {"model": self.model, **self.at}
        measures = self._labels.dataset(self.measured, self.time, attributes, "parameter snapshot")
        return self._by_parameter(measures)

    @guarded()
    def fields(self, points: ArrayLike) -> xarray.Dataset:
        """Return the derivatives of velocity and pressure over time at points of the fluid.

        Parameters, errors and result are those of `Result.fields`, with a first axis `parameter`.
        """
        attributes, axes = {"model": self.model, **self.at}, "parameter snapshot"
        fields = self._labels.fields(points, self._sample, self.time, attributes, axes)
        return self._by_parameter(fields)

    def _by_parameter(self, dataset: xarray.Dataset) -> xarray.Dataset:
        for values in dataset.values():
            values.attrs["units"] += " per unit"
        return dataset.assign_coords(parameter=list(self.parameters))
