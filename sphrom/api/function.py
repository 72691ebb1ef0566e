"""A reduced model as a function of arrays, for programs that optimise, sample or calibrate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sphrom.api.result import ERROR
from sphrom.arguments import finite_array
from sphrom.arrays import Array, Mask
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.measures import STATISTICS, Measured, combined, items
from sphrom.metrics.series import OSCILLATION, at_instants
from sphrom.models.contract import Ability, ModelRun
from sphrom.models.contract import Model as AnyModel
from sphrom.signals import guarded
from sphrom.text import nearest, quoted

DIFFERENCE = 1e-3
"""Step over a trained range, for derivatives of models without sensitivities."""

Runs = Callable[[Sequence[Mapping[str, float]]], Iterator[ModelRun]]
"""Runs a model at rows of parameters by name."""


@dataclass(frozen=True)
class Output:
    """A number of a run: a value or a statistic of a history, or a property of an oscillation."""

    measure: str
    """The measurement, or its estimated error if it begins with ERROR."""
    quantity: str
    component: int
    ending: str
    """One of STATISTICS; empty for the value at one time."""
    units: str

    @property
    def is_statistic(self) -> bool:
        """Whether it is a statistic over times since `from_time`, not a value at one time."""
        return self.ending not in ("", "last")

    def counted(self, case: Case, time: Array) -> Mask:
        """Return a mask of the times (n_snapshots,) [s] from which the output is computed."""
        return case.plan.counted(self.measure.removeprefix(ERROR), time)

    def of(self, case: Case, time: Array, measured: Measured, instant: float | None) -> float:
        """Return the number from measurements (n_snapshots, ...) at times [s].

        A value without an ending is that at an instant [s], by default the last time.
        """
        values = measured.get(self.measure, {}).get(self.quantity)
        if values is None and self.measure.startswith(ERROR):
            raise CaseError(f"{self.measure}: the model does not estimate this error")
        if values is None:  # a history without an oscillation
            return np.nan
        history = values.reshape(len(time), -1)[:, self.component]
        if not self.ending and instant is not None:
            return float(at_instants(time, history, np.array([instant]))[0])
        if not self.is_statistic:
            return float(history[-1])
        return float(STATISTICS[self.ending](history[self.counted(case, time)], axis=0))


def outputs_of(case: Case) -> dict[str, Output]:
    """Return the outputs of runs of a case, by name."""
    found = {}
    for name, column in case.scene.columns.items():
        component = column.component or 0
        for ending in ("", *STATISTICS):
            own = f"{name}_{ending}" if ending else name
            for prefix in ("", ERROR):
                measure = f"{prefix}{column.measure}"
                found[prefix + own] = Output(
                    measure, column.quantity, component, ending, column.units
                )
    for name, oscillating in case.plan.oscillations.items():
        for figure in OSCILLATION:
            units = oscillating.units_of(figure)
            found[f"{name}_{figure}"] = Output(name, figure, 0, "last", units)
    return found


class Function:
    """A reduced model as a function of arrays, as returned by `Model.function`.

    Calls raise CaseError for values of another shape, not finite, or not allowed in the case.

    Attributes
    ----------
    inputs : names of the parameters, in the order of the values.
    outputs : names of the numbers that the function returns, in their order.
    units : units of the outputs.
    bounds : (n_inputs, 2) trained ranges of the inputs. The function warns of values outside.
    """

    def __init__(
        self,
        model: AnyModel[Any],
        runs: Runs,
        ranges: Mapping[str, tuple[float, float]],
        outputs: Sequence[str],
        instant: float | None,
    ) -> None:
        self._model = model
        self._runs = runs
        self.inputs = tuple(ranges)
        self.outputs = tuple(outputs)
        self.bounds = np.array([*ranges.values()])
        case = model.workspace.case
        known = outputs_of(case)
        for name in outputs:
            if name not in known:
                words = nearest(name, [*case.scene.columns, *case.plan.oscillations])
                endings = ", ".join(f"_{ending}" for ending in STATISTICS)
                raise CaseError(
                    f"{quoted(name)}: is not an output; {words}; the endings of histories "
                    f"are {endings}"
                )
        self._outputs = [known[name] for name in outputs]
        self.units = tuple(output.units for output in self._outputs)
        steps = case.plan.model_steps(model.section)
        time = np.linspace(steps.start_time, steps.end_time, steps.n_snapshots)
        for name, output in zip(outputs, self._outputs, strict=True):
            if output.is_statistic and not output.counted(case, time).any():
                raise CaseError(f"{quoted(name)}: its from_time is after all times of the runs")
        self._instant = instant
        if instant is not None and not steps.start_time <= instant <= steps.end_time:
            span = f"{steps.start_time:g} to {steps.end_time:g} s"
            raise CaseError(f"time: must be in the runs, from {span}; got {instant:g}")

    def __repr__(self) -> str:
        names = ", ".join(self.inputs), ", ".join(self.outputs)
        return f"Function({self._model.section.name!r}, {' -> '.join(names)})"

    @guarded()
    def __call__(self, x: ArrayLike) -> Array:
        """Return the outputs (n_outputs,) at values (n_inputs,).

        At values (n, n_inputs) they are (n, n_outputs). Outputs of unstable runs are NaN, and
        so are figures of histories without an oscillation.
        """
        rows = self._rows(x)
        values = np.full((len(rows), len(self.outputs)), np.nan)
        for row, run in zip(values, self._runs(self._named(rows)), strict=True):
            if run.failure is None:
                row[:] = self._figures(run.time, self._measured(run))
        return values if np.ndim(x) > 1 else values[0]

    @guarded()
    def jacobian(self, x: ArrayLike) -> Array:
        """Return the derivatives (n_outputs, n_inputs) at values (n_inputs,).

        At values (n, n_inputs) they are (n, n_outputs, n_inputs). They follow from the model's
        equations (`Model.sensitivities`); for models of a free surface, from differences of runs.
        Estimated errors have no derivatives.

        Raises UnstableError when a run becomes unstable.
        """
        for name in self.outputs:
            if name.startswith(ERROR):
                raise CaseError(f"{quoted(name)}: has no derivatives; leave it out")
        has_slopes = self._model.family.can(Ability.SENSITIVITIES)
        slopes = self._slopes if has_slopes else self._differences
        found = np.stack([slopes(row) for row in self._rows(x)])
        return found if np.ndim(x) > 1 else found[0]

    def _rows(self, x: ArrayLike) -> Array:
        rows = finite_array(x, "x")
        n_inputs = len(self.inputs)
        if rows.ndim not in (1, 2) or rows.shape[-1] != n_inputs or not rows.size:
            shapes = f"({n_inputs},) or (n, {n_inputs})"
            raise CaseError(f"x: must have the shape {shapes}; got {rows.shape}")
        return np.atleast_2d(rows)

    def _named(self, rows: Array) -> list[dict[str, float]]:
        return [dict(zip(self.inputs, row, strict=True)) for row in rows.tolist()]

    def _measured(self, run: ModelRun) -> Measured:
        measured = {**run.measured, **run.oscillations}
        if any(output.measure.startswith(ERROR) for output in self._outputs):
            measured |= {f"{ERROR}{name}": each for name, each in run.measured_errors.items()}
        return measured

    def _figures(self, time: Array, measured: Measured) -> Array:
        case = self._model.workspace.case
        return np.array([o.of(case, time, measured, self._instant) for o in self._outputs])

    def _run_figures(self, run: ModelRun) -> Array:
        """Return the figures (n_outputs,) of a run; raise UnstableError if it is unstable."""
        if run.failure is not None:
            raise run.failure
        return self._figures(run.time, self._measured(run))

    def _slopes(self, row: Array) -> Array:
        """Return the derivatives (n_outputs, n_inputs) from the model's equations."""
        (run,) = self._runs(self._named(row[None]))
        if run.failure is not None:
            raise run.failure
        slopes = self._model.tangents(run.point, self.inputs, run.reduced)
        plan = self._model.workspace.case.plan
        oscillations = plan.oscillations
        columns = []
        for k, name in enumerate(self.inputs):
            step = plan.small_step(run.point, name)
            along = partial(combined, run.measured, items(slopes.measured, k))
            low, high = (
                self._figures(run.time, {**side, **oscillations.of(run.time, side, run.regime)})
                for side in map(along, (-0.5 * step, 0.5 * step))
            )
            columns.append((high - low) / step)
        return np.stack(columns, axis=1)

    def _differences(self, row: Array) -> Array:
        """Return the derivatives from runs at slightly different values in the trained ranges."""
        columns = []
        for k, (low, high) in enumerate(self.bounds):
            ends = np.tile(row, (2, 1))
            step = DIFFERENCE * ((high - low) or abs(row[k]) or 1.0)
            ends[:, k] = row[k] - step, row[k] + step
            if low <= row[k] <= high and low < high:
                ends[:, k] = np.clip(ends[:, k], low, high)
            below, above = map(self._run_figures, self._runs(self._named(ends)))
            columns.append((above - below) / np.ptp(ends[:, k]))
        return np.stack(columns, axis=1)
