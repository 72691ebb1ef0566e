"""The outcome of a training: its stages, and their tables and figure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import TrainingSection, percentage
from sphrom.metrics.histories import QUANTITIES
from sphrom.plots.panels import Curve, Panel, draw_grid, save
from sphrom.plots.tables import UNKNOWN, format_figure, rows_of_columns, write_csv, write_json
from sphrom.reduction.greedy import Ending, safety_factor
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.text import counted, exact

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = "training"
"""Folder of a training, within that of the case's artifacts."""
LABELS = {"reynolds": "Re [–]"}
"""Labels of parameters with a usual symbol."""
OSCILLATING = "oscillation"
LIMITED = (*QUANTITIES, OSCILLATING)
"""The quantities with errors; for oscillations, the larger of frequency and amplitude."""
FIGURES = ("estimate", "error", "floor")
"""Errors of a predicted run [%]: the estimate, the true error, and the best approximation's."""


@dataclass(frozen=True)
class HeldOut:
    """A full run that a model predicted before it became a training run; errors are in %."""

    point: ParameterPoint
    estimate: Array
    """(3,) of LIMITED, before any correction; infinite without an estimate."""
    error: Array
    """(3,) true errors, infinite if the model's run diverged."""
    floor: Array
    """(3,) errors of the best approximation in the basis."""
    failure: str | None = None
    """The reason why the full run failed; it then has no errors."""


@dataclass(frozen=True)
class Stage:
    """A model that was trained at some points."""

    points: tuple[ParameterPoint, ...]
    candidates: Sequence[ParameterPoint]
    estimates: Array
    """(n_candidates, 3) estimated errors of LIMITED [%], infinite without an estimate."""
    floor: Array
    """(3,) largest errors of the best approximations of the training runs [%]."""
    earlier: tuple[HeldOut, ...]
    """Runs that earlier stages chose."""
    fields: tuple[int, ...]
    """The indices in LIMITED of the quantities that the tolerance limits."""
    held_out: tuple[HeldOut, ...] = ()
    """Runs that this stage chose."""

    @property
    def complete(self) -> list[HeldOut]:
        """The stable runs that earlier stages chose."""
        return [run for run in self.earlier if run.failure is None]

    @property
    def tried(self) -> list[ParameterPoint]:
        """All points where the full model was run."""
        return [*self.points, *(run.point for run in self.earlier if run.failure is not None)]

    @property
    def factors(self) -> Array:
        """(3,) safety factors on estimates, to cover all true errors."""
        n_limited = len(LIMITED)
        pairs = np.array([(run.estimate, run.error) for run in self.complete])
        pairs = pairs.reshape(-1, 2, n_limited)
        return np.array([safety_factor(*pairs[..., k].T) for k in range(n_limited)])

    @cached_property
    def judged(self) -> Array:
        """The largest estimates with safety factors of all fields (n_candidates,) [%]."""
        return np.asarray((self.estimates * self.factors)[:, self.fields].max(axis=1))

    @property
    def worst(self) -> tuple[float, ParameterPoint]:
        """The largest of these, and its point, where full runs are stable."""
        unstable = {run.point for run in self.earlier if run.failure is not None}
        pairs = zip(self.judged.tolist(), self.candidates, strict=True)
        return max((p for p in pairs if p[1] not in unstable), key=lambda pair: pair[0])

    @property
    def worst_floor(self) -> float:
        """The largest error of the best approximations, of all fields [%]."""
        return float(self.floor[list(self.fields)].max())


@dataclass(frozen=True)
class Outcome:
    """A completed training."""

    section: TrainingSection
    model: str
    stages: Sequence[Stage]
    ending: Ending

    @property
    def tolerance(self) -> float:
        """The tolerance of the training [%]."""
        return percentage(self.section.tolerance)

    @property
    def quantity(self) -> str:
        """The names of the quantities that the tolerance limits."""
        return " and ".join(LIMITED[k] for k in self.section.fields)

    @property
    def shown(self) -> tuple[str, ...]:
        """The quantities of LIMITED that have columns in the table."""
        return tuple(dict.fromkeys((*QUANTITIES, *(LIMITED[k] for k in self.section.fields))))

    @property
    def held_out(self) -> list[HeldOut]:
        """The runs that were predicted before they became training runs."""
        return [run for stage in self.stages for run in stage.held_out if run.failure is None]

    @property
    def errors(self) -> list[float]:
        """The true errors of the held-out runs, of the worst field [%]."""
        return [float(run.error[list(self.section.fields)].max()) for run in self.held_out]


def publish(
    context: StageContext, outcome: Outcome, case_file: Path, kept: Sequence[str] = ()
) -> None:
    """Write tables and the figure, and show the results.

    `kept` are the names of files of the case that still belong to other training points.
    """
    report = context.report
    workspace = Workspace(context)
    folder = workspace.folder(FOLDER)
    points = outcome.stages[-1].points
    parameters = list(points[0].as_dict())
    errors = {f"{quantity}_{figure}": "%" for quantity in outcome.shown for figure in FIGURES}
    units: dict[str, str | None] = {"full_runs": None, "worst_estimate": "%"}
    units |= {"factor": None, "floor": "%", **dict.fromkeys(parameters), **errors, "failure": None}
    rows = [{**dict.fromkeys(units), **row} for row in _rows(outcome)]
    table = rows_of_columns(units, rows)
    write_csv(folder / "training.csv", table)
    write_json(
        folder / "training.json",
        {"stages": table},
        context.case.name,
        workspace.threads,
        model=outcome.model,
        quantity=outcome.section.quantity,
        tolerance_percent=outcome.tolerance,
        ending=outcome.ending,
        trained=[point.as_dict() for point in points],
    )
    save(draw_training(outcome), folder / "training.png")
    limited = [name for name in errors if name.partition("_")[0] in outcome.quantity]
    shown = ["full_runs", "worst_estimate", "factor", "floor", *parameters, *limited]
    for row in rows:
        row |= {name: exact(row[name]) for name in parameters if row[name] is not None}
    report.table(
        f"training of {outcome.model}: errors in %; for each chosen run the estimate, the true "
        "error and that of the best approximation, before it became a training run",
        [name.replace("_", " ") for name in shown],
        [[format_figure(row[name]) for name in shown] for row in rows],
    )
    (report.info if outcome.ending == "within" else report.warn)(_statement(outcome))
    for sentence in _on_errors(outcome):
        report.info(sentence)
    report.info(f"tables, training.json and training.png are in {folder}")
    _, option, out = context.words.partition(" --out ")
    following = f"sphrom run {case_file}{option}{out}"
    if kept:
        following += f" --force, which makes {', '.join(kept)} again and keeps full runs"
    report.info(f"the case with the {len(points)} points: {case_file}; next: {following}")


def _rows(outcome: Outcome) -> Iterator[dict[str, Any]]:
    """Yield a row, by column, for each stage and each of the runs that it chose; errors are in %.

    The worst estimate includes the safety factor, which comes from earlier held-out runs. Figures
    of diverged models, which aren't finite, are None.
    """
    for stage in outcome.stages:
        row = {
            "full_runs": len(stage.points),
            "worst_estimate": _finite(stage.worst[0]),
            "factor": float(stage.factors[list(stage.fields)].max()),
            "floor": stage.worst_floor,
            "failure": "",
        }
        if not stage.held_out:
            yield row
        for run in stage.held_out:
            figures = {
                f"{quantity}_{figure}": _finite(getattr(run, figure)[k])
                for k, quantity in enumerate(outcome.shown)
                for figure in FIGURES
            }
            yield {**row, **run.point.as_dict(), **figures, "failure": run.failure or ""}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _in_percent(value: float) -> str:
    return f"{format_figure(value)} %" if np.isfinite(value) else UNKNOWN


def _statement(outcome: Outcome) -> str:
    """Return a sentence on the accuracy of the model and the end of the training."""
    last = outcome.stages[-1]
    tolerance = f"{outcome.tolerance:g} %"
    worst, at = last.worst
    ends = {
        "within": f"within {tolerance} everywhere with {len(last.points)} full runs",
        "budget": f"not within {tolerance}: the budget of {outcome.section.budget} full runs "
        "is spent; the same command continues with a larger --budget",
        "floor": f"not within {tolerance}, and further runs would not help; use more modes "
        "(n_modes), or a larger tolerance",
    }
    return (
        f"{outcome.quantity} {ends[outcome.ending]}: worst estimate {_in_percent(worst)} at "
        f"{at.label}; best possible error in its basis {_in_percent(last.worst_floor)}"
    )


def _on_errors(outcome: Outcome) -> Iterator[str]:
    """Yield sentences on errors before the last run, and on fields that have no tolerance."""
    if errors := outcome.errors:
        yield (
            f"models of fewer runs predicted the {counted(len(errors), 'chosen run')}, from which "
            f"the model now learns too, with errors of up to {_in_percent(max(errors))}"
        )
    last = outcome.stages[-1]
    for k, name in enumerate(QUANTITIES):
        if k in outcome.section.fields:
            continue
        estimates = last.estimates[:, k] * last.factors[k]
        at = last.candidates[int(estimates.argmax())].label
        text = f"{name} has no tolerance: worst estimate {_in_percent(estimates.max())} at {at}"
        if runs := outcome.held_out:
            error = max(float(run.error[k]) for run in runs)
            estimate = max(float(run.estimate[k]) for run in runs)
            text += (
                f"; models of fewer runs had errors of up to {_in_percent(error)}, estimated as "
                f"up to {_in_percent(estimate)}"
            )
        yield text


def draw_training(outcome: Outcome) -> Figure:
    """Draw the worst estimate over the runs, and for one parameter the estimates beside it."""
    error = f"error of {outcome.quantity} [%]"
    stages = outcome.stages
    estimates = [np.where(np.isfinite(s.judged), s.judged, np.nan) for s in stages]
    n_runs = np.array([len(stage.points) for stage in stages])
    curves = [Curve("worst estimate", n_runs, np.array([found.max() for found in estimates]))]
    n_held_out = [len(s.points) for s in stages for r in s.held_out if r.failure is None]
    curves += _known_errors(outcome, np.array(n_held_out, dtype=int), n_runs)
    panels = [Panel("", "training runs", error, curves, "logarithmic")]
    name, *others = outcome.section.ranges
    if not others:
        held_out = [run.point for run in outcome.held_out]
        values, at = (
            np.array([point.as_dict()[name] for point in points])
            for points in (stages[0].candidates, held_out)
        )
        order = np.argsort(values)
        curves = [
            Curve(f"estimate, {n_runs[k]} runs", values[order], estimates[k][order])
            for k in dict.fromkeys((0, len(stages) - 1))
        ]
        curves += _known_errors(outcome, at, values)
        panel = Panel("", LABELS.get(name, name), error, curves, "logarithmic")
        panels.insert(0, replace(panel, axes="both logarithmic") if name in LABELS else panel)
    return draw_grid([panels])


def _known_errors(outcome: Outcome, at: Array, range_of: Array) -> list[Curve]:
    """Return curves of the true errors of held-out runs, and of the tolerance over a range."""
    ends = np.array([range_of.min(), range_of.max()])
    errors = np.array(outcome.errors)
    finite = np.where(np.isfinite(errors), errors, np.nan)
    return [
        Curve("true error, held out", at, finite, "reference"),
        Curve("tolerance", ends, np.full(2, outcome.tolerance), "level"),
    ]
