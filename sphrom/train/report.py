"""The outcome of a training: tables, the plot, and a statement of what the model promises."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.studies import Region
from sphrom.case.study_sections import percentage
from sphrom.plots.canvas import save
from sphrom.plots.panels import Curve, Panel, draw_grid
from sphrom.plots.tables import (
    UNKNOWN,
    about,
    format_figure,
    rows_of_columns,
    write_csv,
    write_json,
)
from sphrom.reduction.error_calibration import FIELDS
from sphrom.reduction.greedy import Ending, safety_factor
from sphrom.store.workspace import Workspace
from sphrom.train.journal import HeldOut, Stage

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

FOLDER = "training"
"""Of a training, below that of the case's artifacts."""
LABELS = {"reynolds": "Re [–]"}
"""Of parameters with a usual symbol."""


@dataclass(frozen=True)
class Outcome:
    """A training that ended."""

    case: Case
    region: Region
    model: str
    candidates: tuple[ParameterPoint, ...]
    stages: tuple[Stage, ...]
    ending: Ending

    @property
    def fields(self) -> list[int]:
        """Which of velocity and pressure count."""
        return list(self.case.training.fields)

    @property
    def quantity(self) -> str:
        """Their names."""
        return " and ".join(FIELDS[k] for k in self.fields)

    @property
    def tolerance(self) -> float:
        """[%]."""
        return percentage(self.case.training.tolerance)

    @property
    def held_out(self) -> list[HeldOut]:
        """The runs that were predicted before they were learnt from."""
        return [run for stage in self.stages for run in stage.held_out if run.failure is None]

    @property
    def errors(self) -> list[float]:
        """Their true errors, of the worst field [%]."""
        return [float(run.error[self.fields].max()) for run in self.held_out]

    def earlier(self, stage: int) -> list[HeldOut]:
        """Return the runs held out before a stage."""
        return [run for each in self.stages[:stage] for run in each.held_out]

    def estimates(self, stage: int) -> Array:
        """Return the corrected estimates (n_candidates,) of a stage, of the worst field [%]."""
        return judged(self.stages[stage].estimates, self.earlier(stage), self.fields)

    def worst(self, stage: int) -> tuple[float, ParameterPoint]:
        """Return the largest corrected estimate [%] of a stage, and where it is."""
        found = self.estimates(stage)
        unstable = {r.point for s in self.stages for r in s.held_out if r.failure is not None}
        stable = [k for k, point in enumerate(self.candidates) if point not in unstable]
        at = max(stable, key=lambda k: found[k])
        return float(found[at]), self.candidates[at]


FIGURES = ("estimate", "error", "floor")
"""Of a run that a model predicted: its estimate without a factor, its true error and that of the
best approximation [%]."""


def factors(held_out: Sequence[HeldOut]) -> Array:
    """Return the factors (2,) on estimates of velocity and pressure that cover all true errors."""
    known = [run for run in held_out if run.failure is None]
    estimates = np.array([run.estimate for run in known]).reshape(-1, 2)
    errors = np.array([run.error for run in known]).reshape(-1, 2)
    return np.array([safety_factor(estimates[:, k], errors[:, k]) for k in range(2)])


def judged(estimates: Array, held_out: Sequence[HeldOut], fields: Sequence[int]) -> Array:
    """Return corrected estimates (n,) of the worst of the fields that count."""
    corrected = estimates * factors(held_out)
    return np.asarray(corrected[:, list(fields)].max(axis=1))


def told(run: HeldOut, fields: Sequence[int]) -> str:
    """Return what a run that was held out tells, in a line."""
    parts = [
        f"{FIELDS[k]}: estimated {_percent(run.estimate[k])}, true {_percent(run.error[k])}, "
        f"at best {_percent(run.floor[k])}"
        for k in fields
    ]
    return f"{run.point.label}, not seen before: {'; '.join(parts)}"


def _percent(value: float) -> str:
    return f"{_known(value)} %" if np.isfinite(value) else UNKNOWN


def publish(
    workspace: Workspace, outcome: Outcome, case_file: Path, kept: Sequence[str] = ()
) -> None:
    """Write tables and the plot, and show what was found.

    `kept` names the files of the case that are still those of other training points.
    """
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    rows = _rows(outcome)
    write_csv(folder / "training.csv", rows)
    origin = about(outcome.case.name, workspace.threads)
    last = len(outcome.stages) - 1
    origin |= {
        "model": outcome.model,
        "quantity": outcome.case.training.quantity,
        "tolerance_percent": outcome.tolerance,
        "ending": outcome.ending,
        "trained": [point.as_dict() for point in outcome.stages[last].points],
    }
    write_json(folder / "training.json", {"stages": rows}, origin)
    save(draw_training(outcome), folder / "training.png")
    report.table(
        f"training of {outcome.model}: errors of {outcome.quantity} in %, those of runs held "
        "out before the model learnt from them",
        ("full runs", "worst estimate", "at", "factor", "next run", "estimate", "true", "at best"),
        list(_cells(outcome)),
    )
    for line in _statement(outcome):
        (report.info if outcome.ending == "within" else report.warn)(line)
    report.info(f"tables, training.json and training.png are in {folder}")
    n_points = len(outcome.stages[last].points)
    following = f"sphrom run {case_file}"
    if kept:
        following += f" --force, which makes {', '.join(kept)} again for them; full runs stay"
    report.info(f"the case with the {n_points} points: {case_file}; next: {following}")


def _rows(outcome: Outcome) -> list[DataclassInstance]:
    """Return a row for each stage and each of the runs that it chose; errors in %.

    The factor is that on the estimates, from the runs held out before; the worst estimate has it,
    and is None where the model diverges.
    """
    names = [f"{FIELDS[k]}_{figure}" for k in range(2) for figure in FIGURES]
    units = {"full_runs": None, "worst_estimate": "%", "factor": None, "floor": "%"}
    units |= {**dict.fromkeys(outcome.region.names), **dict.fromkeys(names, "%"), "failure": None}
    rows = []
    for number, stage in enumerate(outcome.stages):
        worst, _ = outcome.worst(number)
        common = {
            **dict.fromkeys(units),
            "full_runs": len(stage.points),
            "worst_estimate": worst if np.isfinite(worst) else None,
            "factor": float(factors(outcome.earlier(number))[outcome.fields].max()),
            "floor": float(stage.floor[outcome.fields].max()),
            "failure": "",
        }
        for run in stage.held_out:
            figures = np.stack([getattr(run, figure) for figure in FIGURES], axis=1).ravel()
            known = [value if np.isfinite(value) else None for value in figures.tolist()]
            told = {**run.point.as_dict(), **dict(zip(names, known, strict=True))}
            rows.append({**common, **told, "failure": run.failure or ""})
        if not stage.held_out:
            rows.append(common)
    return rows_of_columns(units, rows)


def _cells(outcome: Outcome) -> Iterator[tuple[str, ...]]:
    for number, stage in enumerate(outcome.stages):
        worst, at = outcome.worst(number)
        factor = factors(outcome.earlier(number))[outcome.fields]
        shown = " / ".join(f"{each:.2f}" for each in factor)
        begin = str(len(stage.points)), _known(worst), at.label, shown
        for run in stage.held_out:
            errors: tuple[str, ...] = ("unstable", "", "")
            if run.failure is None:
                figures = (getattr(run, name)[outcome.fields] for name in FIGURES)
                errors = tuple(" / ".join(map(_known, each)) for each in figures)
            yield (*begin, run.point.label, *errors)
        if not stage.held_out:
            yield (*begin, "", "", "", "")


def _known(value: float) -> str:
    return format_figure(value) if np.isfinite(value) else UNKNOWN


def _statement(outcome: Outcome) -> Iterator[str]:
    """Yield what the training reached, and why it ended."""
    last = outcome.stages[-1]
    worst, at = outcome.worst(len(outcome.stages) - 1)
    n_runs, tolerance = len(last.points), f"{outcome.tolerance:g} %"
    floor = format_figure(last.floor[outcome.fields].max())
    reached = f"worst estimate {_percent(worst)} at {at.label}"
    if errors := outcome.errors:
        worst_error, last_error = _percent(max(errors)), _percent(errors[-1])
        reached += f", worst error held out {worst_error}, the last {last_error}"
    ends = {
        "within": f"within {tolerance} everywhere with {n_runs} full runs",
        "budget": f"not within {tolerance}: the budget of {outcome.case.training.budget} full runs "
        "is spent; --budget gives more, and the same command goes on",
        "candidates": f"not within {tolerance}: all candidates have full runs; training.candidates "
        "gives more",
        "floor": f"not within {tolerance}, and no further run would bring it there: the best "
        f"approximations of the training runs are wrong by up to {floor} %; more modes "
        "(n_modes of the model) or a larger tolerance",
    }
    yield f"{ends[outcome.ending]}: {reached}; at best {floor} % in its basis"


def draw_training(outcome: Outcome) -> Figure:
    """Return the fall of the worst estimate; beside it, over one parameter, the estimates."""
    error, stages = f"error of {outcome.quantity} [%]", outcome.stages
    estimates = [_finite(outcome.estimates(k)) for k in range(len(stages))]
    n_runs = np.array([len(stage.points) for stage in stages])
    worst = Curve("worst estimate", n_runs, np.array([each.max() for each in estimates]))
    learnt = np.array([len(s.points) for s in stages for r in s.held_out if r.failure is None])
    curves = [worst, *_known_errors(outcome, learnt, n_runs)]
    panels = [Panel("", "full runs learnt from", error, curves, "logarithmic")]
    names = [name for name in outcome.region.names if name in outcome.case.training.ranges]
    if len(names) == 1:
        values, held_out = (
            np.array([point.as_dict()[names[0]] for point in points])
            for points in (outcome.candidates, [run.point for run in outcome.held_out])
        )
        order = np.argsort(values)
        curves = [
            Curve(f"estimate, {n_runs[k]} runs", values[order], estimates[k][order])
            for k in dict.fromkeys((0, len(stages) - 1))
        ]
        curves += _known_errors(outcome, held_out, values)
        axes: Literal["both logarithmic", "logarithmic"] = (
            "both logarithmic" if names[0] == REYNOLDS else "logarithmic"
        )
        panels.insert(0, Panel("", LABELS.get(names[0], names[0]), error, curves, axes))
    return draw_grid([panels])


def _known_errors(outcome: Outcome, at: Array, range_of: Array) -> list[Curve]:
    """Return the true errors of runs held out, and the tolerance over a range."""
    ends = np.array([range_of.min(), range_of.max()])
    return [
        Curve("true, before it was seen", at, _finite(np.array(outcome.errors)), "reference"),
        Curve("tolerance", ends, np.full(2, outcome.tolerance), "level"),
    ]


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)
