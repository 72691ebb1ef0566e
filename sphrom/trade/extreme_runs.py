"""Reduced runs of `trade --extremes` at one parameter value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.trade import TradeSection
from sphrom.metrics.histories import compare, errors_of
from sphrom.metrics.samples import Probes, Samples
from sphrom.online.fast_model import FastModel
from sphrom.reduction.integrators import automatic_steps
from sphrom.reduction.polynomial_model import SAFETY, OutputTimes, PolynomialModel
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.store.workspace import Workspace
from sphrom.trade.extreme_rows import REFUSED, ExtremeRow, state_of
from sphrom.trade.runs import ReducedRuns
from sphrom.trade.table import Measure

Array = NDArray[np.float64]

MOST_STEPS = 1_000_000
"""Steps of a reduced run beyond which it isn't made: a closure may need ever smaller ones."""
ROUNDING = 1e-9
"""Slack for values that are equal but for rounding."""


@dataclass(frozen=True)
class ExtremeRuns:
    """Runs of models at one parameter value."""

    workspace: Workspace
    runs: ReducedRuns
    probes: Probes
    full_run: str
    """The name of the full run that they are compared with; empty without one."""
    full_samples: Samples | None
    point: ParameterPoint
    asked: TradeSection
    """Of the case whose extremes are mapped; a variant's own says nothing of them."""

    def time_steps(self, model: ReducedModelSection) -> list[ExtremeRow]:
        """Return a row for each time step over the model's limit."""
        reduced = self._at_point(model)
        factors = sorted(set(self.asked.extremes.step_factors))
        return [self._row(model, reduced, "time step", each, each) for each in factors]

    def memory_lengths(self, model: ReducedModelSection) -> list[ExtremeRow]:
        """Return a row for each memory length of a model with the closure, in automatic steps."""
        automatic = self._at_point(model).memory_length
        if automatic is None:
            raise ValueError("a model without the closure has no memory length")
        return [
            self.variant(
                model.model_copy(update={"memory_length": factor * automatic}),
                "memory length",
                factor,
            )
            for factor in sorted(set(self.asked.extremes.memory_factors))
        ]

    def variant(self, model: ReducedModelSection, varied: str, value: float) -> ExtremeRow:
        """Return the row of a model in automatic steps, where `varied` has a value."""
        return self._row(model, self._at_point(model), varied, value)

    def _at_point(self, model: ReducedModelSection) -> ReferenceModel:
        return FastModel(self.workspace, model).at(self.point)

    def _row(
        self,
        model: ReducedModelSection,
        reduced: ReferenceModel,
        varied: str,
        value: float,
        factor: float | None = None,
    ) -> ExtremeRow:
        """Run a model in steps over its limit, or automatic ones, and return its row."""
        time_step = self._time_step(reduced, factor)
        error, growth, detail = None, None, ""
        if time_step is None:
            state, detail = REFUSED, f"steps within {reduced.step_limit:.3g} s are too many"
        else:
            error, growth = self._error_and_growth(model, reduced, time_step)
            state = state_of(error, growth, self.asked.extremes.inaccurate)
            if factor is None and math.isfinite(reduced.step_limit):
                factor = time_step / reduced.step_limit
        return ExtremeRow.of(
            model,
            self.point,
            varied,
            value,
            step_factor=factor,
            time_step=time_step,
            memory_length=reduced.memory_length,
            state=state,
            velocity_error=error,
            growth=growth,
            compared_with=self.full_run,
            detail=detail,
        )

    def _time_step(self, reduced: ReferenceModel, factor: float | None) -> float | None:
        """Return the step of a run [s], None where it would take too many."""
        plan = step_plan(self.workspace.case)
        duration = plan.end_time - plan.start_time
        if duration > MOST_STEPS * (factor or SAFETY) * reduced.step_limit:
            return None
        if factor is not None:
            return min(factor * reduced.step_limit, duration)
        return duration / max(1, automatic_steps(reduced))

    def _error_and_growth(
        self, model: ReducedModelSection, reduced: ReferenceModel, time_step: float
    ) -> tuple[float | None, float | None]:
        """Return the velocity error [%] of a run, and how coordinates grew over training's."""
        case = self.workspace.case
        times = reduced.output_times.time
        coordinates = at_snapshots(reduced, time_step, times)
        if coordinates is None:
            return None, None
        largest = float(np.linalg.norm(coordinates, axis=1).max())
        growth = largest / self.runs.training_norm(model.basis, model.size)
        if self.full_samples is None:
            return None, growth
        samples = FastModel(self.workspace, model).sampled(
            self.point,
            reduced,
            self.probes,
            times,
            coordinates,
            reduced.mean_density_fluctuation,
            self.runs.splines(reduced, model.basis),
        )
        history = compare(samples, self.full_samples, self.probes, case.compare.from_time)
        measure = Measure(self.asked.probes)
        known = len(history.time) > 0
        return measure.of(errors_of(history), "velocity") if known else None, growth


def at_snapshots(reduced: ReferenceModel, time_step: float, times: Array) -> Array | None:
    """Run with a time step [s] that need not divide snapshots; return coordinates at their times.

    Between steps by the cubic of the states and rates at both ends. None when the run diverged.
    """
    start_time, duration = float(times[0]), float(times[-1] - times[0])
    n_steps = max(1, math.ceil(duration / time_step * (1.0 - ROUNDING)))
    output_times = OutputTimes(
        time_step, n_steps + 1, start_time, reduced.output_times.largest_norm
    )
    system = PolynomialModel([reduced.polynomial])
    runs = system.run(reduced.start[None], output_times, [1], reduced.amplitude)
    if not np.isnan(runs.diverged_at[0]):
        return None
    states = runs.coordinates[0]
    before = np.clip(np.searchsorted(runs.time, times, side="right") - 1, 0, n_steps - 1)
    share = ((times - runs.time[before]) / time_step)[:, None]
    ends = (before, before + 1)
    slopes = [time_step * _rates(reduced, runs.time[end], states[end]) for end in ends]
    left = share**2 * (2.0 * share - 3.0) + 1.0
    return np.asarray(
        left * states[ends[0]]
        + (1.0 - left) * states[ends[1]]
        + share * (1.0 - share) ** 2 * slopes[0]
        + share**2 * (share - 1.0) * slopes[1]
    )


def _rates(reduced: ReferenceModel, times: Array, states: Array) -> Array:
    """Return the rates (n_times, n_modes) [1/s] of states at times [s]."""
    amplitudes = np.zeros(len(times)) if reduced.amplitude is None else reduced.amplitude(times)
    return np.array(
        [reduced.polynomial(state, float(a)) for state, a in zip(states, amplitudes, strict=True)]
    )
