"""The result of a case in a few sentences: the error, the speed and the break-even of its model.

It comes from the tables of a comparison, and from the costs that artifacts record. The model is the
one that `trade` recommends for a tolerance of (1 + ALIKE) times the least error: the fastest within
this tolerance. The error is the larger one of velocity and pressure, each a mean over the points
between the training values; without such points, over those outside, else over training points.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TypeVar

import numpy as np

from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.compare.comparison_tables import (
    SLOW_PRESSURE,
    SOUND,
    ErrorRow,
    EstimateRow,
    Tables,
)
from sphrom.compare.costs import N_REPEATS, RunTiming, break_even, offline_seconds
from sphrom.compare.measured import MeasureRow, OscillationRow
from sphrom.metrics.measures import ONLY_NOISE
from sphrom.models.contract import SURFACE, Ability, basis_used, best_name, family_of
from sphrom.models.stable_ranges import against
from sphrom.plots.tables import format_figure
from sphrom.store.stored_run import inflow_of
from sphrom.store.workspace import Workspace
from sphrom.text import counted, duration

ALIKE = 0.1
"""Relative difference below which errors of models are equal."""
DIGITS = 2
"""Significant digits of the figures in a sentence."""
LOUD = 0.5
"""Share of sound in a pressure, over a model's error, from which the answer mentions it."""
UNDERESTIMATED = 3.0
"""Least error over its estimate that the answer mentions: twice the estimate is to be expected."""
ROLES = {
    "predicted": "which was not simulated for training",
    "extrapolated": "which was not simulated for training and lies outside of the trained values",
    "trained": "where it was trained",
}
"""Phrases for the roles of parameter points."""
FIELDS = ("velocity", "pressure")
Pair = tuple[float, float]
"""Errors of velocity and pressure [%]."""
Row = TypeVar("Row", ErrorRow, EstimateRow, MeasureRow, OscillationRow)
LOADS = "force_x", "force_y", "force_z", "torque"
"""Components of a measured force, with its torque in a plane."""


@dataclass(frozen=True)
class Answer:
    """Error and cost of a reduced model at a point, preferably one between the training values.

    Of several such points, it is the one with the largest error of velocity.
    """

    row: ErrorRow
    """The comparison of the model with the full run."""
    n_points: int
    """Number of points of the same role at which the model ran."""
    error: Pair
    best: Pair | None
    """Errors of the nearest state in the basis."""
    estimate: Pair | None
    """The model's own estimate, which needs no full run."""
    timing: RunTiming | None
    offline_seconds: float | None
    training_seconds: float | None
    n_training: int
    loads: tuple[MeasureRow, ...] = ()
    """Measured forces and torques, by component."""
    nearest_loads: tuple[MeasureRow, ...] = ()
    """Measured forces and torques of the nearest state, by component."""
    oscillations: tuple[OscillationRow, ...] = ()
    surface: tuple[float, float | None] | None = None
    """Errors of the free surface's elevation and of the nearest state's [%], if there is one."""
    since: str = ""
    """A phrase for the time from which errors are computed, unless it is the first."""
    times: str = ""
    """The `from_time` of measurements, in words."""
    doubts: tuple[str, ...] = ()
    """Sentences with reasons to doubt that imported runs belong to the case."""
    outside: tuple[int, str, Pair] | None = None
    """Number of points outside of the trained values, the worst one and its errors, if the answer
    is about others."""
    unphysical: tuple[str, ...] = ()
    """Sentences about unphysical full runs."""

    @property
    def pays_from(self) -> int | None:
        """The number of runs that make the model cheaper; None if never or unknown."""
        timing = self.timing
        if timing is None or timing.speed_up is None or timing.reduced_seconds is None:
            return None
        return break_even(self.offline_seconds, timing.full_seconds, timing.reduced_seconds)

    def sentences(self) -> Iterator[str]:
        """Yield the sentences of the answer."""
        yield from self.unphysical
        one_of = "" if self.n_points == 1 else f", the worst of {self.n_points} such values"
        yield (
            f"At {self.row.parameters}, {ROLES[self.row.role]}{one_of}, {self.row.compared} "
            f"({counted(self.row.n_modes or 0, 'mode')}) differs from the full run by "
            f"{percent(self.error[0])} in velocity and {percent(self.error[1])} in pressure: "
            f"the root mean square of the difference over the whole field and all times"
            f"{self.since}, relative to the full run, with pressures less their mean"
            f"{'' if self.surface is None else ' and their part at rest'}."
        )
        yield from self._sound()
        yield from self._compared()
        if self.outside is not None:
            number, where, errors = self.outside
            worst = "" if number == 1 else f", the worst of {number} such values"
            yield (
                f"At {where}, which lies outside of the trained values{worst}, it differs by "
                f"{percent(errors[0])} in velocity and {percent(errors[1])} in pressure."
            )
        yield from self._cost()

    def _sound(self) -> Iterator[str]:
        sound, slow = (self.row.errors.get(name) for name in (SOUND, SLOW_PRESSURE))
        if sound is not None and slow is not None and sound > LOUD * self.error[1]:
            yield (
                f"Of the full run's pressure, {percent(sound)} is sound or particle noise, which "
                "no model predicts; averaged over the period of the longest sound wave, the "
                f"pressures differ by {percent(slow)}."
            )

    def _compared(self) -> Iterator[str]:
        beside = {
            "the nearest state in its basis": self.best,
            "the model's own estimate": self.estimate,
        }
        parts = [f"{words}: {_both(pair)}" for words, pair in beside.items() if pair is not None]
        if parts:
            yield _sentence("; ".join(parts))
        for field, error, estimate in zip(FIELDS, self.error, self.estimate or (), strict=False):
            if error > UNDERESTIMATED * estimate > 0.0:
                yield (
                    f"The error of the {field} is {format_figure(error / estimate, DIGITS)} times "
                    f"its estimate: add a training run at or near {self.row.parameters}, or use "
                    "fewer modes."
                )
        if self.surface is not None:
            error, least = self.surface
            nearest = "" if least is None else f", that of the nearest state by {percent(least)}"
            yield (
                f"The surface's elevation differs by {percent(error)}{nearest}, of the root mean "
                "square of its change."
            )
        if self.times:
            yield _sentence(self.times)
        yield from self._loads()
        for row in self.oscillations:
            if row.remark:
                yield f"The oscillation ({row.measured}) can't be compared: {row.remark}."
                continue
            errors = row.frequency_error, row.amplitude_error, row.phase_error
            frequency, amplitude, phase = (format_figure(error, DIGITS) for error in errors)
            estimates = row.frequency_estimated, row.amplitude_estimated, row.phase_estimated
            own = ""
            if None not in estimates:
                own = " (estimated: {} %, {} % and {} degrees)".format(
                    *(format_figure(estimate, DIGITS) for estimate in estimates)
                )
            yield (
                f"The oscillation ({row.measured}) differs by {frequency} % in frequency, "
                f"{amplitude} % in amplitude and, at the end, {phase} degrees in phase{own}; all "
                "errors over time include this phase."
            )
        yield from self.doubts

    def _loads(self) -> Iterator[str]:
        """Yield a sentence per measured force, with the errors of its components."""
        nearest = {(row.measured, row.quantity): row.relative_l2 for row in self.nearest_loads}
        for name, of_name in groupby(self.loads, key=lambda row: row.measured):
            rows = list(of_name)
            parts = list[str]()
            for row in rows:
                words = row.quantity.replace("_", " ")
                if not row.relative_l2:
                    off = f"{format_figure(row.rms_error, DIGITS)} {row.unit}"
                    parts.append(f"{words}: {ONLY_NOISE} in the full run, the difference is {off}")
                    continue
                errors = {
                    "without sound": row.without_sound if row.sound else None,
                    "share of sound": row.sound,
                    "nearest state": nearest.get((name, row.quantity)),
                    "estimate": row.estimated,
                }
                also = ", ".join(f"{label} {percent(e)}" for label, e in errors.items() if e)
                parts.append(f"{words} by {percent(row.relative_l2)}" + f" ({also})" * bool(also))
            vector = rows[0].vector_relative_l2
            as_vector = "" if vector is None else f", as a vector by {percent(vector)}"
            yield (
                f"The measured force ({name}) differs over time{as_vector}, and by component, "
                f"relative to its own change: {'; '.join(parts)}."
            )

    def _cost(self) -> Iterator[str]:
        timing = self.timing
        if timing is None or timing.full_seconds is None:
            yield "The time of the full run is unknown, and so is the break-even of the model."
            return
        takes = f"Undisturbed, on one thread, it takes {duration(timing.reduced_seconds or 0.0)}"
        full = duration(timing.full_seconds)
        if timing.speed_up is None:
            yield f"{takes}. The full run took {full}, as stated at its import."
            yield "No speed-up is given, because threads and machines of the two times may differ."
            return
        takes = f"{takes}, the full run {full} at its largest stable step."
        if timing.speed_up <= 1.0:
            yield f"{takes} The model is not faster; use one with evaluation: operators."
            return
        yield takes
        gains = timing.speed_up, timing.least_speed_up, timing.greatest_speed_up
        times, low, high = (format_figure(gain, DIGITS) for gain in gains)
        spread = "" if gains[1] is None else f" ({low} to {high} over {N_REPEATS} repeats)"
        yield f"That is {times}{spread} times as long."
        if self.offline_seconds is None or self.pays_from is None:
            yield "The cost of making the model is unknown, and so is its break-even."
            return
        yield (
            f"It pays off from {counted(self.pays_from, 'run')} on: making it took "
            f"{duration(self.offline_seconds)} of processor time on one thread, "
            f"{duration(self.training_seconds or 0.0)} of it for "
            f"{counted(self.n_training, 'training run')}."
        )


def percent(value: float) -> str:
    """Format an error for a sentence."""
    return f"{format_figure(value, DIGITS)} %"


def _both(errors: Pair) -> str:
    return f"{percent(errors[0])} and {percent(errors[1])}"


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def find_answer(workspace: Workspace, tables: Tables) -> Answer | None:
    """Return the answer of a comparison, None if no model completed a run."""
    case = workspace.case
    plan = case.plan
    model = next(iter(_by_preference(case, tables)), None)
    if model is None:
        return None
    compared = _compared(tables, model.name)
    judged = _judged(compared)
    error, worst = max(judged, key=_velocity_error)
    far = [pair for pair in compared if pair[1].role == "extrapolated" != worst.role]
    beyond = max(far, key=_velocity_error, default=None)
    point = next(p for p in plan.rom_points(model) if p.label == worst.parameters)
    basis, n_modes = basis_used(workspace, model, point)
    best = best_name(basis, n_modes)

    def rows_of(rows: Sequence[Row], compared: str = model.name) -> list[Row]:
        return [r for r in rows if (r.compared, r.parameters) == (compared, point.label)]

    nearest = rows_of(tables.errors, best)
    estimates = [row.figures for row in rows_of(tables.estimates)]
    timing = next(
        (r for r in tables.timings if (r.model, r.parameters) == (model.name, point.label)), None
    )
    loads = [row for row in tables.measures if row.quantity in LOADS]
    surface = [row for row in tables.measures if row.measured == SURFACE]
    full_seconds = None if timing is None else timing.full_seconds
    offline, training = offline_seconds(workspace, model, [point], full_seconds)
    return Answer(
        row=worst,
        n_points=len(judged),
        error=error,
        best=nearest[0].in_field if nearest else None,
        estimate=(estimates[0]["velocity_estimate"], estimates[0]["pressure_estimate"])
        if estimates
        else None,
        timing=timing,
        offline_seconds=offline,
        training_seconds=training,
        n_training=len(plan.bases[basis]),
        surface=_relative_errors(rows_of(surface), rows_of(surface, best)),
        since=f" from {since:g} s on" if (since := case.compare.from_time) else "",
        doubts=(
            *_doubts(workspace),
            *(f"This run is doubtful: {t}." for t in against(workspace, model, point)),
        ),
        outside=beyond and (len(far), beyond[1].parameters, beyond[0]),
        unphysical=tuple(_unphysical(workspace)),
        oscillations=tuple(rows_of(tables.oscillations)),
        times=plan.times_in_words,
        loads=tuple(rows_of(loads)),
        nearest_loads=tuple(rows_of(loads, best)),
    )


def _velocity_error(pair: tuple[Pair, ErrorRow]) -> float:
    return pair[0][0]


def _compared(tables: Tables, model: str) -> list[tuple[Pair, ErrorRow]]:
    """Return the errors of a model with their rows, where its runs are complete."""
    rows = (row for row in tables.errors if (row.compared, row.against) == (model, "full"))
    return [(error, row) for row in rows if (error := row.in_field) is not None]


def _judged(compared: Sequence[tuple[Pair, ErrorRow]]) -> list[tuple[Pair, ErrorRow]]:
    """Return the errors between the training values; without any, those outside, else all."""
    roles = ([pair for pair in compared if pair[1].role == role] for role in ROLES)
    return next(filter(None, roles))


def _by_preference(case: Case, tables: Tables) -> list[ReducedModelSection]:
    """Return the models that completed their runs, the recommended one first."""
    errors = dict[str, float]()
    least = dict[bool, float]()
    failed = {row.compared for row in tables.errors if row.status != "complete"}
    seconds = {row.model: row.reduced_seconds for row in tables.timings}
    models = [model for model in case.rom if _compared(tables, model.name)]

    def runs_alone(model: ReducedModelSection) -> bool:
        return family_of(case, model).can(Ability.RUNS_ALONE)

    for model in models:
        pairs = _judged(_compared(tables, model.name))
        errors[model.name] = error = float(np.mean([pair[0] for pair in pairs], axis=0).max())
        if model.name not in failed:
            kind = runs_alone(model)
            least[kind] = min(error, least.get(kind, math.inf))

    def key(model: ReducedModelSection) -> tuple[bool, bool, bool, float]:
        name = model.name
        off = errors[name] > (1.0 + ALIKE) * least.get(runs_alone(model), math.inf)
        return not runs_alone(model), name in failed, off, seconds.get(name) or math.inf

    return sorted(models, key=key)


def _unphysical(workspace: Workspace) -> Iterator[str]:
    """Yield a sentence for each unphysical full run of the case."""
    for point in workspace.case.plan.points:
        if found := workspace.unphysical(point):
            yield (
                f"The full run at {point.label} is unphysical, so errors against it say "
                f"nothing about a model: {'; '.join(found)}."
            )


def _doubts(workspace: Workspace) -> Iterator[str]:
    """Yield sentences with reasons to doubt that full runs belong to the case, if any."""
    plan = workspace.case.plan
    for point in plan.points if plan.strip is not None else ():
        with workspace.open(workspace.full_run(point)) as trajectory:
            inflow = inflow_of(workspace.case, point, trajectory)
        if inflow is not None and inflow.problem is not None:
            yield f"Warning: {inflow.problem}."
    runs = {point.label: workspace.imported(workspace.full_run(point)) for point in plan.points}
    said = {at: of["imported/doubts"] for at, of in runs.items() if of.get("imported/doubts")}
    if said:
        (first, *more) = said
        doubts = next(iter(said.values())).replace("\n", "; ")
        also = f"; so may those at {', '.join(more)}" if more else ""
        yield f"The run at {first} was imported, and may be of another flow: {doubts}{also}."


def _relative_errors(
    model: Sequence[MeasureRow], nearest: Sequence[MeasureRow]
) -> tuple[float, float | None] | None:
    """Return the errors of a model and of the nearest state, if the model has one."""
    errors = [rows[0].relative_l2 if rows else None for rows in (model, nearest)]
    return None if errors[0] is None else (errors[0], errors[1])


def tell_answer(workspace: Workspace, tables: Tables) -> None:
    """Report the answer, and the folders of tables and of pictures, which are drawn afterwards."""
    report = workspace.context.report
    out = workspace.out
    if tables == Tables():
        for sentence in _unphysical(workspace):
            report.prose(sentence)
        report.result(
            f"The full runs are in {out}. There is no reduced model to compare with them."
        )
        for sentence in _doubts(workspace):
            report.prose(sentence)
        return
    answer = find_answer(workspace, tables)
    nothing = "No reduced model was compared over a whole run."
    sentences = [*_unphysical(workspace), nothing, *_doubts(workspace)]
    for sentence in sentences if answer is None else answer.sentences():
        report.prose(sentence)
    drawn = workspace.case.compare.plots is not False
    pictures = f", pictures in {out / 'plots'}" if drawn else ""
    report.result(f"Tables are in {out / 'tables'}{pictures}.")
    report.result(f"To see all results on one page: sphrom report {workspace.context.words}")
