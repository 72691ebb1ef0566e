"""Reduced models of a study, to run at any parameters or to use as systems of equations."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sphrom.api.function import Function
from sphrom.api.result import Labels, Result, Sensitivities, rows_of
from sphrom.arguments import checked, finite_array
from sphrom.arrays import Array
from sphrom.artifacts.records.reduced_models import ModelFile
from sphrom.case.fields import LARGEST
from sphrom.case.hints import beyond_training, extrapolation
from sphrom.case.loader import parameter_point
from sphrom.case.model_checks import steady_problem
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.plan_times import lengthened, moved_end
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import fit_ranges, percent, require_basis, trained_ranges
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.series import TOO_CLOSE, UNDECIDED
from sphrom.models.contract import Ability, ModelRun, family_of
from sphrom.reduction.polynomial_model import SteadyState, steady_state
from sphrom.setup.context import StageContext
from sphrom.signals import guarded
from sphrom.store.workspace import Workspace
from sphrom.text import nearest, quoted

if TYPE_CHECKING:
    import xarray

    from sphrom.fit.fit import Fit
    from sphrom.fit.forward_model import TrainingDifferences

LEAST_STEP = 1e-3
"""Smallest time step for sensitivities, relative to the automatic one."""


class Model:
    """A reduced model at a parameter point, as returned by `Study.model`.

    A model with `evaluation: operators` is a system of equations da/dt = f(a, t) for its
    generalized coordinates a. Only such a model has a `start`, `rates`, a `jacobian`, `steady`
    states, `measures` of coordinates, `sensitivities` and a `fit`.

    Methods raise CaseError for invalid arguments (unknown parameters, arrays of another shape or
    not finite, times between snapshots), UnstableError when a run became unstable, and
    ArtifactError when necessary artifacts are missing, damaged, or of another case.
    """

    _point: ParameterPoint
    _own: Mapping[str, float] = {}
    _reduced: Any = None
    """The model at the point; its kind is that of the family."""

    def __init__(
        self,
        context: StageContext,
        section: ReducedModelSection,
        stored: ModelFile | None = None,
    ) -> None:
        self._workspace = Workspace(context)
        self._section = section
        self._labels = Labels(context.case)
        self._errors: TrainingDifferences = {}
        self._family = family_of(context.case, section)
        if stored is None and self._family.can(Ability.RUNS_ALONE):
            self._workspace.require(self._workspace.operators())
        self._fast = self._family.part("model")(self._workspace, section, stored)

    def _points(self, rows: Iterable[Mapping[str, float]]) -> list[ParameterPoint]:
        """Return the points with some values and the model's own; warn of one that extrapolates."""
        case = self._workspace.case
        points = [parameter_point(case, {**self._own, **values}) for values in rows]
        for point in points:
            require_basis(case, self._section, point)
        if warning := next(filter(None, map(partial(extrapolation, case), points)), None):
            self._warn(warning)
        return points

    def _warn(self, text: str) -> None:
        self._workspace.context.report.warn(f"{self.name}: {text}")

    def __repr__(self) -> str:
        return f"Model({self.name!r}, {self._point.label})"

    @property
    def name(self) -> str:
        """The name of the model in the case."""
        return self._section.name

    @property
    def parameters(self) -> dict[str, float]:
        """The parameter values, by name."""
        return self._point.as_dict()

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The trained range (lowest, highest) of each parameter that varies in the case."""
        return dict(trained_ranges(self._workspace.case, self._section))

    @property
    def start(self) -> Array:
        """The initial coordinates (n_modes,) of runs."""
        self._require(Ability.RUNS_ALONE, "start")
        return np.array(self._reduced.start)

    @guarded(solves=False)
    def at(self, **parameters: float) -> Model:
        """Return the same model at other parameter values, without reading files again.

        The model keeps the values of all parameters that are not named.
        """
        other = copy(self)
        (other._point,) = self._points([parameters])
        other._own = other._point.as_dict()
        other._reduced = self._fast.at(other._point)
        return other

    @guarded()
    @checked
    def run(self, final_time: float | None = None) -> Result:
        """Run the model, and estimate its error.

        A model on the reference points writes no file. A model on particles writes its trajectory
        into the study's folder, like `sphrom rom`, or reads an existing one.

        Parameters
        ----------
        final_time : [s], for models on the reference points; by default the final time of the case.
            The run ends at the time of a snapshot, and a warning names this time if it is another.
        """
        if final_time is not None:
            self._require(Ability.OTHER_TIMES, "final_time")
        run = self._fast.run(self._point, self._lengthened(final_time))
        if run.failure is not None:
            raise UnstableError(f"{run.name}: {run.failure}")
        if run.regime == UNDECIDED:
            self._warn(TOO_CLOSE)
        for text in run.unlike_training:
            self._warn(f"{self._point.label}: {text}")
        return Result(
            model=self.name,
            parameters=self.parameters,
            time=run.time,
            coordinates=run.coordinates,
            correction=run.correction,
            time_step=run.time_step,
            _labels=self._labels,
            _sample=run.sampled,
            _measured=lambda: run.measured | run.oscillations,
            _regime=run.regime,
            _estimate=lambda: run.estimate,
        )

    @guarded()
    def run_many(self, points: Mapping[str, ArrayLike]) -> xarray.Dataset:
        """Run the model at many points, and return the measurements with estimated errors.

        Parameters
        ----------
        points : values (n_runs,) by parameter, in a dictionary, or a table of pandas or xarray; a
            single number applies to all runs. Other parameters have the values of this model.

        Returns
        -------
        A dataset with the variables of `Result.measures`, with a first axis `run` and the
        parameters as coordinates. If the model estimates errors, it also has those of the
        measurements, such as `error_estimate_drag_force`; `error_estimate_velocity` and
        `error_estimate_pressure` (run), relative to root mean squares of the fields [%]; and
        `error_estimate_extrapolated` (run), one outside of the trained range, else zero. `status`
        (run) is `complete` or `unstable`; values of unstable runs are NaN. A model with
        `calibrated: cycle` has the `regime` (run): `steady`, `shedding` or `undecided`.
        """
        self._require(Ability.RUNS_ALONE, "run_many")
        at = self._points(rows_of(points))
        return self._labels.runs(self._runs(at), [p.as_dict() for p in at], self.name)

    def _runs(self, points: Sequence[ParameterPoint]) -> Iterator[ModelRun]:
        """Run the model at many points, and warn of doubtful runs."""
        doubts = []
        for run in self._fast.runs(points):
            doubts += [f"{run.point.rounded.label}: {text}" for text in run.unlike_training[:1]]
            yield run
        if doubts:
            self._warn(f"{len(doubts)} of {len(points)} runs are doubtful, such as {doubts[0]}")

    @guarded(solves=False)
    @checked
    def function(
        self, inputs: Sequence[str], outputs: Sequence[str], time: float | None = None
    ) -> Function:
        """Return the model as a function of arrays, with bounds and a Jacobian.

        Parameters
        ----------
        inputs : parameters that vary in the case. All others have the values of this model.
        outputs : numbers of a run, named as in tables of a sweep: the value of a history at one
            time, such as `drag_force_x` or `wake_pressure`; its statistics `drag_force_x_last`,
            `_mean`, `_fluctuation`, `_least` and `_greatest`; a figure of an oscillation, such as
            `shedding_frequency`. `error_estimate_drag_force_x` and the like are estimated errors in
            the unit of the history.
        time : time of values without such an ending [s]; by default the final time.
        """
        self._require(Ability.RUNS_ALONE, "function")
        for kind, names in (("inputs", inputs), ("outputs", outputs)):
            if not names or len({*names}) < len(names):
                raise CaseError(f"{kind}: needs at least one name, and each only once")
        self._require_names(inputs)
        ranges = {name: self.ranges[name] for name in inputs}
        return Function(
            self._fast, lambda rows: self._runs(self._points(rows)), ranges, outputs, time
        )

    @guarded()
    @checked
    def sensitivities(
        self, *names: str, final_time: float | None = None, step_factor: float = 1.0
    ) -> Sensitivities:
        """Run the model, and compute derivatives of the run with respect to parameters.

        The derivatives follow from the model's equations, ds/dt = J s + df/dp, with the same
        exponential steps as the run, at the cost of about two runs per parameter. In cases with a
        spin-up, the initial state counts as constant, because spin-ups exist only at the trained
        values; a warning says so.

        Parameters
        ----------
        names : parameters, such as `"reynolds", "lid"`; by default all that vary in the case.
        final_time : as for `run`.
        step_factor : length of the time steps over that of automatic ones.
        """
        case = self._workspace.case
        self._require(Ability.SENSITIVITIES, "sensitivities")
        self._require_names(names)
        if step_factor < LEAST_STEP:
            raise CaseError(f"step_factor: must be {LEAST_STEP:g} or more; got {step_factor:g}")
        if case.time.spin_up > 0.0:
            self._warn("derivatives do not include changes of the spin-up")
        reduced = self._lengthened(final_time)
        wanted = tuple(dict.fromkeys(names)) or case.plan.parameter_names
        slopes = self._fast.tangents(self._point, wanted, reduced, step_factor)
        own: Any = {"model": self.name, "at": self.parameters}
        return Sensitivities(**vars(slopes), **own, _labels=self._labels)

    @guarded()
    @checked
    def fit(
        self,
        measurements: str | os.PathLike[str] | Mapping[str, ArrayLike],
        *names: str,
        noise: float | str | None = None,
    ) -> Fit:
        """Estimate parameters from measured histories, like `sphrom fit`, without writing files.

        Parameters
        ----------
        measurements : a CSV file, or its columns by name in a dictionary or a table of pandas;
            see `sphrom.fit.measurements`.
        names : the free parameters. By default, the section `fit` of the case determines free
            parameters and fixed values. All others have the values of this model.
        noise : standard deviation over each history's range, such as `"1%"` or 1.0, if the
            measurements have none; by default the case's.

        Returns
        -------
        Estimates with 95 % intervals that include the noise and the model's own errors, such as
        `fit["reynolds"].value`, `.low` and `.high`; read the warnings `fit.problems` first.
        """
        from sphrom.fit.fit import fit
        from sphrom.fit.forward_model import box_of
        from sphrom.fit.measurements import read_measurements

        case = self._workspace.case
        section = self._section
        self._require(Ability.RUNS_ALONE, "fit")
        self._require_names(names)
        share = case.fit.noise if noise is None else percent(noise, "noise")
        # A path is a `Path` here, see `checked`.
        data = read_measurements(measurements, case, case.plan.model_steps(section), share)  # type: ignore[arg-type]
        ranges = fit_ranges(case, section)
        values = self.parameters
        if names:
            trained = trained_ranges(case, section)
            ranges = {name: ranges.get(name, trained[name]) for name in dict.fromkeys(names)}
        else:
            values |= {n: v for n, v in case.fit.parameters.items() if isinstance(v, float)}
        values = {n: v for n, v in values.items() if n not in ranges}
        return fit(self._fast, box_of(ranges, values), data, self._errors)

    def _require_names(self, names: Sequence[str]) -> None:
        known = self._workspace.case.plan.parameter_names
        for name in names:
            if name not in known:
                raise CaseError(
                    f"{quoted(name)}: does not vary in the case; {nearest(str(name), known)}"
                )

    @checked
    def rates(self, coordinates: ArrayLike, time: float | None = None) -> Array:
        """Return the rates da/dt (n_modes,) [1/s] of coordinates (n_modes,).

        Parameters
        ----------
        time : [s], for a body force or walls that change with time; by default the final time.
        """
        reduced, state, amplitude, _ = self._at("rates", coordinates, time)
        return reduced.polynomial(state, amplitude)

    @checked
    def jacobian(self, coordinates: ArrayLike, time: float | None = None) -> Array:
        """Return the derivative (n_modes, n_modes) [1/s] of the rates at coordinates (n_modes,).

        Entry (i, j) is the derivative of rate i with respect to coordinate j. Parameters are those
        of `rates`.
        """
        reduced, state, amplitude, _ = self._at("jacobian", coordinates, time)
        return reduced.polynomial.jacobian(state, amplitude)

    def steady(self, coordinates: ArrayLike) -> SteadyState:
        """Search for a steady state by Newton's method, starting from coordinates (n_modes,).

        Returns its `coordinates` (n_modes,), the `residual` (norm of the rates, [1/s]), `n_steps`,
        and whether it has `converged`. The eigenvalues of the Jacobian determine its stability.
        There is none if the body force changes with time.
        """
        reduced, state, amplitude, _ = self._at("steady", coordinates)
        if (problem := steady_problem(self._workspace.case)) is not None:
            raise CaseError(f"steady: {problem}")
        return steady_state(reduced.polynomial, state, amplitude=amplitude)

    @guarded()
    @checked
    def measures(self, coordinates: ArrayLike, time: float | None = None) -> xarray.Dataset:
        """Return the measurements of a state with coordinates (n_modes,), within microseconds.

        `model.measures(model.steady(a).coordinates)` measures a steady state. Variables are those
        of `Result.measures`, at one snapshot.

        Parameters
        ----------
        time : [s], for a body force or walls that change with time; by default the final time.
        """
        reduced, state, _, at = self._at("measures", coordinates, time)
        times = np.array([at])
        measured = self._fast.measures(reduced, times, state[None])
        labels = {"model": self.name, **self.parameters}
        return self._labels.dataset(measured, times, labels)

    def _require(self, ability: Ability, method: str) -> None:
        self._family.require(ability, method, self.name)

    def _lengthened(self, final_time: float | None) -> Any:
        """Return the model with the snapshots of a run with another final time [s]."""
        reduced = self._reduced
        if final_time is None:
            return reduced
        steps = self._workspace.case.plan.steps
        longer = lengthened(steps, final_time)
        if (moved := moved_end(longer, final_time)) is not None:
            self._warn(f"final_time: {moved}")
        if longer.end_time > steps.end_time:
            for key, reason in self._workspace.case.plan.problems_until(longer.end_time):
                raise CaseError(f"final_time: scene.{key}: {reason}")
            self._warn(beyond_training(steps.end_time))
        times = replace(reduced.output_times, n_snapshots=longer.n_snapshots)
        return replace(reduced, output_times=times)

    def _at(
        self, method: str, coordinates: ArrayLike, time: float | None = None
    ) -> tuple[Any, Array, float, float]:
        """Return the model, coordinates as an array, amplitude of the driving, and time [s]."""
        self._require(Ability.EQUATIONS, method)
        reduced = self._reduced
        state = finite_array(coordinates, "coordinates")
        shape = reduced.start.shape
        if state.shape != shape:
            raise CaseError(f"coordinates: must have the shape {shape}; got {state.shape}")
        at = self._workspace.case.plan.steps.end_time if time is None else time
        for name, values in (("coordinates", state), ("time", np.array(at))):
            if np.abs(values).max(initial=0.0) > LARGEST:
                raise CaseError(f"{name}: must be from {-LARGEST:g} to {LARGEST:g}")
        if reduced.amplitude is None:
            return reduced, state, 0.0, at
        return reduced, state, float(reduced.amplitude(np.array([at]))[0]), at
