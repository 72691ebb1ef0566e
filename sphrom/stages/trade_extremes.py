"""`trade --extremes`: where Galerkin models on the reference points are stable, and accurate.

Mach number, memory length and smoothing length need artifacts of their own: they are not varied.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.trade_checks import coarser_resolution
from sphrom.errors import CaseError
from sphrom.reduction.polynomial_model import PolynomialModel, Schedule
from sphrom.stages import trade_full
from sphrom.stages.figures_of_merit import compare
from sphrom.stages.reference_runs import ReferenceModel
from sphrom.stages.sampling import Probes, Samples, probes_of
from sphrom.stages.trade_candidates import basis_name, default_sizes
from sphrom.stages.trade_full import Variant
from sphrom.stages.trade_runs import ReducedRuns
from sphrom.stages.trade_stability import ExtremeRow, publish, state_of
from sphrom.stages.trade_table import Measure, errors_of
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]

SIZES = (2, 3, 5, 8, 12, 20, 30, 50)
"""Modes that are tried where a case doesn't say, as far as the basis goes."""
ROUNDING = 1e-9
"""Slack for what is equal but for rounding."""


@dataclass(frozen=True)
class _Truth:
    """What runs at one parameter value are held against."""

    name: str
    samples: Samples | None


def run(workspace: Workspace) -> None:
    """Run models over their extremes, and write a table and a picture of how they fared."""
    case = workspace.case
    if not case.reference_bases:
        raise CaseError(
            "trade.frames: stability is mapped of models on the reference points; list reference"
        )
    probes = probes_of(case)
    runs = ReducedRuns(workspace, probes)
    sizes = case.trade.extremes.n_modes or default_sizes(case, SIZES)
    points = extreme_points(case)
    truths = _truths(workspace, points, probes)
    rows: list[ExtremeRow] = []
    total = len(points) * len(sizes)
    with workspace.context.report.progress("extremes", total) as advance:
        for point in points:
            for n_modes in sizes:
                rows += _Sweep(workspace, runs, probes, truths[point]).rows(point, n_modes)
                advance(1)
    publish(workspace, rows)


def extreme_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which stability is mapped, from the least on."""
    trained = [point.reynolds for point in case.bases[basis_name(case)]]
    low, high = min(trained), max(trained)
    factors = case.trade.extremes.reynolds_factors
    values = {factor * (low if factor < 1.0 else high) for factor in factors}
    return tuple(map(ParameterPoint, sorted(values)))


def _truths(
    workspace: Workspace, points: Sequence[ParameterPoint], probes: Probes
) -> dict[ParameterPoint, _Truth]:
    """Return what to hold runs against: the case's full runs, coarser ones, or nothing."""
    case = workspace.case
    missing = [point for point in points if point not in case.points]
    truths = {
        point: _Truth("full run", trade_full.sampled(workspace, point, probes))
        for point in points
        if point in case.points
    }
    if not missing or case.time.spin_up > 0.0 or not case.trade.extremes.full_runs:
        return truths | {point: _Truth("", None) for point in missing}
    resolution = coarser_resolution(case) or case.discretization.resolution
    for point in missing:
        truths[point] = _coarse_truth(workspace, point, resolution, probes)
    return truths


def _coarse_truth(
    workspace: Workspace, point: ParameterPoint, resolution: int, probes: Probes
) -> _Truth:
    """Make a full run at a value that the case doesn't have."""
    case = workspace.case
    # Its own step: viscosity may allow less than at the case's values.
    train = case.parameters.train.model_copy(update={"reynolds": (point.reynolds,)})
    test = case.parameters.test.model_copy(update={"reynolds": ()})
    alone = case.parameters.model_copy(update={"train": train, "test": test})
    basis = case.basis.model_copy(update={"subsets": {}})
    other = case.model_copy(update={"parameters": alone, "basis": basis})
    variant = trade_full.with_steps(other, resolution, case.time.courant_number, step_plan(case))
    variant = Variant(f"extreme-{resolution}-{point.file_label}", variant.case)
    made = trade_full.workspace_of(workspace, variant)
    problem = trade_full.make(made, [point])[point]
    if problem is not None:
        workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        return _Truth("", None)
    return _Truth(f"full run, {resolution} across", trade_full.sampled(made, point, probes))


@dataclass(frozen=True)
class _Sweep:
    """Runs of one model at one parameter value, at all steps."""

    workspace: Workspace
    runs: ReducedRuns
    probes: Probes
    truth: _Truth

    def rows(self, point: ParameterPoint, n_modes: int) -> list[ExtremeRow]:
        """Return a row for each step."""
        case = self.workspace.case
        model = ReducedModelSection(
            name=f"extreme-{n_modes}", frame="reference", n_modes=n_modes, basis=basis_name(case)
        )
        reduced = self.runs.reference_model(model, point)
        return [
            self._row(point, model, reduced, factor)
            for factor in sorted(set(case.trade.extremes.step_factors))
        ]

    def _row(
        self,
        point: ParameterPoint,
        model: ReducedModelSection,
        reduced: ReferenceModel,
        factor: float,
    ) -> ExtremeRow:
        plan = step_plan(self.workspace.case)
        times = Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time).time
        time_step = min(factor * reduced.step_limit, plan.end_time - plan.start_time)
        coordinates = _at_snapshots(reduced, time_step, times)
        error, growth = None, None
        if coordinates is not None:
            largest = float(np.linalg.norm(coordinates, axis=1).max())
            growth = largest / self.runs.training_norm(model.n_modes)
            error = self._error(model, reduced, times, coordinates)
        return ExtremeRow(
            parameters=point.label,
            n_modes=model.n_modes,
            step_factor=factor,
            time_step=time_step,
            state=state_of(error, growth, self.workspace.case.trade.extremes.inaccurate),
            velocity_error=error,
            growth=growth,
            compared_with=self.truth.name,
        )

    def _error(
        self,
        model: ReducedModelSection,
        reduced: ReferenceModel,
        times: Array,
        coordinates: Array,
    ) -> float | None:
        if self.truth.samples is None:
            return None
        case = self.workspace.case
        samples = self.runs.expanded(reduced, model, times, coordinates)
        history = compare(samples, self.truth.samples, self.probes, case.compare.from_time)
        measure = Measure(case.trade.probes, case.trade.statistic)
        return measure.of(errors_of(history), "velocity") if len(history.time) else None


def _at_snapshots(reduced: ReferenceModel, time_step: float, times: Array) -> Array | None:
    """Run with a time step [s] that need not divide snapshots; return coordinates at their times.

    Between steps by the cubic of the states and rates at both ends. None when the run diverged.
    """
    start_time, duration = float(times[0]), float(times[-1] - times[0])
    n_steps = max(1, math.ceil(duration / time_step * (1.0 - ROUNDING)))
    schedule = Schedule(time_step, n_steps + 1, start_time, reduced.largest_norm)
    system = PolynomialModel([reduced.polynomial])
    runs = system.run(reduced.start[None], schedule, [1], reduced.amplitude)
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
