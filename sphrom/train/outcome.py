"""The stages and the outcome of a training, with its tables, its figure and its conclusion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import percentage
from sphrom.metrics.histories import QUANTITIES
from sphrom.plots.canvas import save
from sphrom.plots.panels import Curve, Panel, draw_grid
from sphrom.plots.tables import UNKNOWN, format_figure, rows_of_columns, write_csv, write_json
from sphrom.reduction.greedy import Ending, safety_factor
from sphrom.store.workspace import Workspace
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FOLDER = "training"
"""Folder of a training, within that of the case's artifacts."""
LABELS = {"reynolds": "Re [–]"}
"""Labels of parameters with a usual symbol."""
FIGURES = ("estimate", "error", "floor")
"""Errors of a predicted run [%]: the estimate without a factor, the true error, and the error of
the best approximation."""


@dataclass(frozen=True)
class HeldOut:
    """A full run that a model predicted before it became a training run; errors are in %."""

    point: ParameterPoint
    estimate: Array
    """(2,) of velocity and pressure, before any correction; infinite without an estimate."""
    error: Array
    """(2,) true errors, infinite if the model's run diverged."""
    floor: Array
    """(2,) errors of the best approximation in the basis."""
    failure: str | None = None
    """The reason why the full run failed; it then has no errors."""


@dataclass(frozen=True)
class Stage:
    """A model that was trained at some points."""

    points: tuple[ParameterPoint, ...]
    candidates: Sequence[ParameterPoint]
    estimates: Array
    """(n_candidates, 2) estimated errors [%], infinite without an estimate."""
    floor: Array
    """(2,) largest errors of the best approximations of the training runs [%]."""
    earlier: tuple[HeldOut, ...]
    """Runs that earlier stages chose."""
    held_out: tuple[HeldOut, ...] = ()
    """Runs that this stage chose."""

    @property
    def unstable(self) -> tuple[ParameterPoint, ...]:
        """The points where earlier full runs became unstable."""
        return tuple(run.point for run in self.earlier if run.failure is not None)

    @property
    def tried(self) -> tuple[ParameterPoint, ...]:
        """All points where the full model was run."""
        return (*self.points, *self.unstable)

    @property
    def factors(self) -> Array:
        """(2,) safety factors on estimates of velocity and pressure, to cover all true errors."""
        complete = [run for run in self.earlier if run.failure is None]
        estimates = np.array([run.estimate for run in complete]).reshape(-1, 2)
        errors = np.array([run.error for run in complete]).reshape(-1, 2)
        return np.array([safety_factor(estimates[:, k], errors[:, k]) for k in range(2)])

    def judged(self, fields: Sequence[int]) -> Array:
        """Return the estimates with safety factors (n_candidates,), the largest of `fields` [%]."""
        return np.asarray((self.estimates * self.factors)[:, list(fields)].max(axis=1))

    def worst(self, fields: Sequence[int]) -> tuple[float, ParameterPoint]:
        """Return the largest of these estimates, and its point, where full runs are stable."""
        pairs = zip(self.judged(fields).tolist(), self.candidates, strict=True)
        stable = [pair for pair in pairs if pair[1] not in self.unstable]
        return max(stable, key=lambda pair: pair[0])


@dataclass(frozen=True)
class Outcome:
    """A completed training."""

    case: Case
    model: str
    stages: Sequence[Stage]
    ending: Ending

    @property
    def fields(self) -> list[int]:
        """The indices of the fields that count, velocity and pressure."""
        return list(self.case.training.fields)

    @property
    def quantity(self) -> str:
        """The names of the fields that count."""
        return " and ".join(QUANTITIES[k] for k in self.fields)

    @property
    def held_out(self) -> list[HeldOut]:
        """The runs that were predicted before they became training runs."""
        return [run for stage in self.stages for run in stage.held_out if run.failure is None]

    @property
    def errors(self) -> list[float]:
        """The true errors of the held-out runs, of the worst field [%]."""
        return [float(run.error[self.fields].max()) for run in self.held_out]


def publish(
    workspace: Workspace, outcome: Outcome, case_file: Path, kept: Sequence[str] = ()
) -> None:
    """Write tables and the figure, and show the results.

    `kept` are the names of files of the case that still belong to other training points.
    """
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    points = outcome.stages[-1].points
    names = [f"{QUANTITIES[k]}_{figure}" for k in range(2) for figure in FIGURES]
    units = {"full_runs": None, "worst_estimate": "%", "factor": None, "floor": "%"}
    units |= {**dict.fromkeys(points[0].as_dict()), **dict.fromkeys(names, "%"), "failure": None}
    rows = list(_rows(outcome))
    table = rows_of_columns(units, ({**dict.fromkeys(units), **row} for row in rows))
    write_csv(folder / "training.csv", table)
    write_json(
        folder / "training.json",
        {"stages": table},
        outcome.case.name,
        workspace.threads,
        model=outcome.model,
        quantity=outcome.case.training.quantity,
        tolerance_percent=percentage(outcome.case.training.tolerance),
        ending=outcome.ending,
        trained=[point.as_dict() for point in points],
    )
    save(draw_training(outcome), folder / "training.png")
    others = [name for name in names if name.partition("_")[0] not in outcome.quantity]
    shown = [name for name in units if name not in (*others, "failure")]
    parameters = points[0].as_dict()
    cells = [row | {name: exact(row[name]) for name in parameters if name in row} for row in rows]
    report.table(
        f"training of {outcome.model}: errors in %; for each chosen run the estimate, the true "
        "error and that of the best approximation, before it became a training run",
        [name.replace("_", " ") for name in shown],
        [[format_figure(row.get(name)) for name in shown] for row in cells],
    )
    (report.info if outcome.ending == "within" else report.warn)(_statement(outcome))
    report.info(f"tables, training.json and training.png are in {folder}")
    _, option, out = workspace.context.words.partition(" --out ")
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
        common = {
            "full_runs": len(stage.points),
            "worst_estimate": _finite(stage.worst(outcome.fields)[0]),
            "factor": float(stage.factors[outcome.fields].max()),
            "floor": float(stage.floor[outcome.fields].max()),
            "failure": "",
        }
        for run in stage.held_out:
            figures = {
                f"{QUANTITIES[k]}_{figure}": _finite(getattr(run, figure)[k])
                for k in range(2)
                for figure in FIGURES
            }
            yield {**common, **run.point.as_dict(), **figures, "failure": run.failure or ""}
        if not stage.held_out:
            yield common


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _percent(value: float) -> str:
    return f"{format_figure(float(value))} %" if np.isfinite(value) else UNKNOWN


def _statement(outcome: Outcome) -> str:
    """Return a sentence on the accuracy of the model and the end of the training."""
    last, tolerance = outcome.stages[-1], f"{percentage(outcome.case.training.tolerance):g} %"
    worst, at = last.worst(outcome.fields)
    floor = _percent(last.floor[outcome.fields].max())
    ends = {
        "within": f"within {tolerance} everywhere with {len(last.points)} full runs",
        "budget": f"not within {tolerance}: the budget of {outcome.case.training.budget} full runs "
        "is spent; the same command continues with a larger --budget",
        "floor": f"not within {tolerance}, and further runs would not help; use more modes "
        "(n_modes), or a larger tolerance",
    }
    reached = f"worst estimate {_percent(worst)} at {at.label}"
    if errors := outcome.errors:
        reached += f", worst error of held-out runs {_percent(max(errors))}"
    return f"{ends[outcome.ending]}: {reached}; best possible error in its basis {floor}"


def draw_training(outcome: Outcome) -> Figure:
    """Draw the worst estimate over the runs, and for one parameter the estimates beside it."""
    error, stages = f"error of {outcome.quantity} [%]", outcome.stages
    candidates = stages[0].candidates
    estimates = [stage.judged(outcome.fields) for stage in stages]
    estimates = [np.where(np.isfinite(each), each, np.nan) for each in estimates]
    n_runs = np.array([len(stage.points) for stage in stages])
    worst = Curve("worst estimate", n_runs, np.array([each.max() for each in estimates]))
    held = [len(s.points) for s in stages for r in s.held_out if r.failure is None]
    curves = [worst, *_known_errors(outcome, np.array(held, dtype=int), n_runs)]
    panels = [Panel("", "training runs", error, curves, "logarithmic")]
    names = list(outcome.case.training.ranges)
    if len(names) == 1:
        values, held_out = (
            np.array([point.as_dict()[names[0]] for point in points])
            for points in (candidates, [run.point for run in outcome.held_out])
        )
        order = np.argsort(values)
        curves = [
            Curve(f"estimate, {n_runs[k]} runs", values[order], estimates[k][order])
            for k in dict.fromkeys((0, len(stages) - 1))
        ]
        curves += _known_errors(outcome, held_out, values)
        label, log = LABELS.get(names[0], names[0]), names[0] in LABELS
        beside = Panel("", label, error, curves, "both logarithmic" if log else "logarithmic")
        panels.insert(0, beside)
    return draw_grid([panels])


def _known_errors(outcome: Outcome, at: Array, range_of: Array) -> list[Curve]:
    """Return curves of the true errors of held-out runs, and of the tolerance over a range."""
    ends, errors = np.array([range_of.min(), range_of.max()]), np.array(outcome.errors)
    finite = np.where(np.isfinite(errors), errors, np.nan)
    return [
        Curve("true error, held out", at, finite, "reference"),
        Curve("tolerance", ends, np.full(2, percentage(outcome.case.training.tolerance)), "level"),
    ]
