"""The answer of a case in a few sentences: how far its model is off, how fast, when it pays.

It comes from the tables of a comparison, and from what artifacts say of their making.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from sphrom.compare.comparison_tables import ErrorRow, Tables, best_name
from sphrom.compare.costs import N_REPEATS, RunTiming, break_even, offline_seconds
from sphrom.compare.measured import SURFACE, OscillationRow
from sphrom.online.stable_ranges import against
from sphrom.plots.tables import format_figure
from sphrom.store.trained_models import basis_used
from sphrom.store.workspace import Workspace
from sphrom.text import counted, duration

DIGITS = 2
"""Significant digits of the figures in a sentence."""
ROLES = {
    "predicted": "which was not simulated for training",
    "extrapolated": "which was not simulated for training and lies outside of the trained values",
    "trained": "where it was trained",
}
"""What the roles of parameter points are called."""
Pair = tuple[float, float]
"""Errors of velocity and pressure [%]."""
Force = tuple[str, float, float | None, float | None]
"""Name of a measured force, its error over time, that of the nearest state and its estimate [%]."""


@dataclass(frozen=True)
class Answer:
    """What a reduced model brings at a parameter point that it was not trained on, if there is one.

    Where there are several, at the one with the largest error of velocity.
    """

    row: ErrorRow
    """That of the model against the full run."""
    n_points: int
    """Points of that role at which the model ran."""
    error: Pair
    best: Pair | None
    """The same of the nearest state in the basis."""
    estimate: Pair | None
    """The model's own estimate, for which no full run is needed."""
    timing: RunTiming | None
    offline_seconds: float | None
    training_seconds: float | None
    n_training: int
    forces: tuple[Force, ...] = ()
    oscillations: tuple[OscillationRow, ...] = ()
    surface: tuple[float, float | None] | None = None
    """Errors of the free surface's elevation and of the nearest state's [%], if there is one."""
    since: str = ""
    """From which instant on errors count, in words, where that isn't the first."""
    doubts: tuple[str, ...] = ()
    """Sentences that say why imported runs may not be runs of the case."""

    @property
    def pays_from(self) -> int | None:
        """How many runs make the model cheaper than full ones; None where never, or unknown."""
        timing = self.timing
        if timing is None or timing.speed_up is None or timing.reduced_seconds is None:
            return None
        return break_even(self.offline_seconds, timing.full_seconds, timing.reduced_seconds)

    def sentences(self) -> Iterator[str]:
        """Yield the answer."""
        one_of = "" if self.n_points == 1 else f", the worst of {self.n_points} such values"
        yield (
            f"At {self.row.parameters}, {ROLES[self.row.role]}{one_of}, {self.row.compared} "
            f"({counted(self.row.n_modes or 0, 'mode')}) differs from the full run by "
            f"{percent(self.error[0])} in velocity and {percent(self.error[1])} in pressure: "
            f"the root mean square of the difference, over the whole field and all instants"
            f"{self.since}, in percent of the full run's own; a pressure is less its mean"
            f"{'' if self.surface is None else ' and its part at rest'}."
        )
        yield from self._compared()
        yield from self._cost()

    def _compared(self) -> Iterator[str]:
        parts = []
        if self.best is not None:
            parts.append(f"the nearest state in its basis: {_both(self.best)}")
        if self.estimate is not None:
            parts.append(f"the model's own estimate: {_both(self.estimate)}")
        if parts:
            text = "; ".join(parts)
            yield f"{text[0].upper()}{text[1:]}."
        if self.surface is not None:
            error, least = self.surface
            nearest = "" if least is None else f", that of the nearest state by {percent(least)}"
            yield (
                f"The surface's elevation differs by {percent(error)}{nearest}, of the root mean "
                "square of its change."
            )
        for name, error, best, estimate in self.forces:
            nearest = "" if best is None else f", that of the nearest state by {percent(best)}"
            own = "" if estimate is None else f"; the model estimates {percent(estimate)}"
            found = f"{percent(error)} over time{nearest}{own}"
            yield f"The measured force ({name}) differs by {found}."
        for each in self.oscillations:
            errors = each.frequency_error, each.amplitude_error, each.phase_error
            frequency, amplitude, phase = (format_figure(error, DIGITS) for error in errors)
            yield (
                f"The oscillation ({each.measured}) differs by {frequency} % in frequency, "
                f"{amplitude} % in amplitude and, at the end, {phase} degrees in phase, which all "
                "errors over time include."
            )
        yield from self.doubts

    def _cost(self) -> Iterator[str]:
        timing = self.timing
        if timing is None or timing.full_seconds is None:
            yield "How long the full run took is unknown, and so is from when on the model pays."
            return
        own = f"Undisturbed, on one thread, it takes {duration(timing.reduced_seconds or 0.0)}"
        full = duration(timing.full_seconds)
        if timing.speed_up is None:
            yield f"{own}. The full run took {full}, as its import says."
            yield "There is no speed-up: the two times may be of other threads and machines."
            return
        took = f"{own}, the full run {full} at its largest stable step."
        if timing.speed_up <= 1.0:
            yield f"{took} It is not faster; a model with evaluation: operators is."
            return
        yield took
        gains = timing.speed_up, timing.least_speed_up, timing.greatest_speed_up
        times, low, high = (format_figure(each, DIGITS) for each in gains)
        spread = "" if gains[1] is None else f" ({low} to {high} over {N_REPEATS} repeats)"
        yield f"That is {times}{spread} times as long."
        if self.offline_seconds is None or self.pays_from is None:
            yield "What making it took is unknown, and so is from when on it pays."
            return
        yield (
            f"It pays from {counted(self.pays_from, 'run')} on: making it took "
            f"{duration(self.offline_seconds)} of processor time on one thread, "
            f"{duration(self.training_seconds or 0.0)} of it for "
            f"{counted(self.n_training, 'full run')} to learn from."
        )


def percent(value: float) -> str:
    """Return an error as sentences have it."""
    return f"{format_figure(value, DIGITS)} %"


def _both(errors: Pair) -> str:
    return f"{percent(errors[0])} and {percent(errors[1])}"


def find_answer(workspace: Workspace, tables: Tables) -> Answer | None:
    """Return the answer of a comparison, None where no model ran to its end."""
    plan = workspace.case.plan
    for model in plan.models_by_speed:
        points = {point.label: point for point in plan.rom_points(model)}
        found = [
            (error, row)
            for row in tables.errors
            if (row.compared, row.against) == (model.name, "full")
            and row.parameters in points
            and (error := row.in_field) is not None
        ]
        if not found:
            continue
        unseen = [pair for pair in found if pair[1].role != "trained"] or found
        error, worst = max(unseen, key=lambda pair: pair[0][0])
        point = points[worst.parameters]
        basis, n_modes = basis_used(workspace, model, point)
        best = best_name(basis, n_modes)
        nearest = [r for r in tables.errors if (r.compared, r.parameters) == (best, point.label)]
        own = (model.name, point.label)
        estimates = [r.figures for r in tables.estimates if (r.compared, r.parameters) == own]
        timings = [r for r in tables.timings if (r.model, r.parameters) == own]
        forces, expected = (
            _force_errors(tables, point.label, which) for which in ("relative_l2", "estimated")
        )
        full_seconds = timings[0].full_seconds if timings else None
        offline, training = offline_seconds(workspace, model, [point], full_seconds)
        return Answer(
            row=worst,
            n_points=len(unseen),
            error=error,
            best=nearest[0].in_field if nearest else None,
            estimate=(estimates[0]["velocity_estimate"], estimates[0]["pressure_estimate"])
            if estimates
            else None,
            timing=timings[0] if timings else None,
            offline_seconds=offline,
            training_seconds=training,
            n_training=len(plan.bases[basis]),
            surface=_surface_errors(tables, worst, best),
            since=f" from {since:g} s on" if (since := workspace.case.compare.from_time) else "",
            doubts=(
                *_doubts(workspace),
                *(f"This run is doubtful: {t}." for t in against(workspace, model, point)),
            ),
            oscillations=tuple(r for r in tables.oscillations if (r.compared, r.parameters) == own),
            forces=tuple(
                (name, force, forces.get((best, name)), expected.get((compared, name)))
                for (compared, name), force in forces.items()
                if compared == model.name
            ),
        )
    return None


def _doubts(workspace: Workspace) -> Iterator[str]:
    """Yield a sentence on the reasons why imported runs may not be runs of the case, if any."""
    runs = {p.label: workspace.imported(workspace.full_run(p)) for p in workspace.case.plan.points}
    said = {at: of["imported/doubts"] for at, of in runs.items() if of.get("imported/doubts")}
    if said:
        (first, *more), doubts = said, next(iter(said.values())).replace("\n", "; ")
        also = f"; so may those at {', '.join(more)}" if more else ""
        yield f"The run at {first} was imported, and may be of another flow: {doubts}{also}."


def _force_errors(
    tables: Tables, point: str, which: Literal["relative_l2", "estimated"]
) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for row in tables.measures:
        error = getattr(row, which)
        if row.parameters == point and row.quantity in ("force_x", "force_y") and error:
            key = (row.compared, row.measured)
            found[key] = math.hypot(found.get(key, 0.0), error)
    return found


def _surface_errors(tables: Tables, row: ErrorRow, best: str) -> tuple[float, float | None] | None:
    errors = {
        each.compared: each.relative_l2
        for each in tables.measures
        if (each.measured, each.parameters) == (SURFACE, row.parameters)
    }
    own = errors.get(row.compared)
    return None if own is None else (own, errors.get(best))


def tell_answer(workspace: Workspace, tables: Tables) -> None:
    """Tell the answer, and where tables and pictures are, as the last that a command says."""
    report, out = workspace.context.report, workspace.out
    if tables == Tables():
        report.result(
            f"The full runs are in {out}. There is no reduced model to compare with them."
        )
        return
    answer = find_answer(workspace, tables)
    sentences = ["No reduced model was compared over a whole run.", *_doubts(workspace)]
    for sentence in sentences if answer is None else answer.sentences():
        report.prose(sentence)
    pictures = f", pictures in {out / 'plots'}" if (out / "plots").is_dir() else ""
    report.result(f"Tables are in {out / 'tables'}{pictures}.")
    report.result(f"All of it on one page: sphrom report {workspace.context.words}")
