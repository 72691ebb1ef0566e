"""Stage `train`: choose training runs until a model is within a tolerance in all of a region.

This is weak greedy training (`sphrom.reduction.greedy`): the model's error is estimated at many
points of the region, and the full model runs where the estimate is largest. That run becomes a
training run, and the next stage begins. Full runs and maps belong to the case and are kept. Bases,
splines and operators are made anew in each stage, in a folder of their own, at a small part of the
cost of a full run. A repeated command makes the same choices and continues where it was stopped.

Errors are root mean squares over the reference points and the compared times, over those of the
field [%], for the velocity and for the pressure less its mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.case.checks import case_problems
from sphrom.case.models import Case, resolved_yaml
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import Region, fast_section, percent, trained_at
from sphrom.case.study_sections import percentage
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.histories import QUANTITIES
from sphrom.metrics.measures import since
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, family_of
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.plots.panels import Curve, Panel, draw_grid, save
from sphrom.plots.tables import UNKNOWN, format_figure, rows_of_columns, write_csv, write_json
from sphrom.reduction.greedy import Ending, choose, ending, safety_factor
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    reconstruct,
    weighted_mean,
)
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.setup.cost import require_room, runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep.workers import Failure, Task, check_options, start_workers
from sphrom.text import exact
from sphrom.whole_files import require_writable, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FOLDER = "training"
"""Folder of a training, within that of the case's artifacts."""
LABELS = {"reynolds": "Re [–]"}
"""Labels of parameters with a usual symbol."""
FIGURES = ("estimate", "error", "floor")
"""Errors of a predicted run [%]: the estimate, the true error, and the best approximation's."""


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
    report = workspace.context.report
    folder = workspace.folder(FOLDER)
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


def _in_percent(value: float) -> str:
    return f"{format_figure(float(value))} %" if np.isfinite(value) else UNKNOWN


def _statement(outcome: Outcome) -> str:
    """Return a sentence on the accuracy of the model and the end of the training."""
    last, tolerance = outcome.stages[-1], f"{percentage(outcome.case.training.tolerance):g} %"
    worst, at = last.worst(outcome.fields)
    floor = _in_percent(last.floor[outcome.fields].max())
    ends = {
        "within": f"within {tolerance} everywhere with {len(last.points)} full runs",
        "budget": f"not within {tolerance}: the budget of {outcome.case.training.budget} full runs "
        "is spent; the same command continues with a larger --budget",
        "floor": f"not within {tolerance}, and further runs would not help; use more modes "
        "(n_modes), or a larger tolerance",
    }
    reached = f"worst estimate {_in_percent(worst)} at {at.label}"
    if errors := outcome.errors:
        reached += f", worst error of held-out runs {_in_percent(max(errors))}"
    return f"{ends[outcome.ending]}: {reached}; best possible error in its basis {floor}"


def draw_training(outcome: Outcome) -> Figure:
    """Draw the worst estimate over the runs, and for one parameter the estimates beside it."""
    error = f"error of {outcome.quantity} [%]"
    stages = outcome.stages
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
        label = LABELS.get(names[0], names[0])
        log = names[0] in LABELS
        beside = Panel("", label, error, curves, "both logarithmic" if log else "logarithmic")
        panels.insert(0, beside)
    return draw_grid([panels])


def _known_errors(outcome: Outcome, at: Array, range_of: Array) -> list[Curve]:
    """Return curves of the true errors of held-out runs, and of the tolerance over a range."""
    ends = np.array([range_of.min(), range_of.max()])
    errors = np.array(outcome.errors)
    finite = np.where(np.isfinite(errors), errors, np.nan)
    return [
        Curve("true error, held out", at, finite, "reference"),
        Curve("tolerance", ends, np.full(2, percentage(outcome.case.training.tolerance)), "level"),
    ]


CASE_FILE = "case.yaml"
"""Name of the case with the chosen points, in the folder of the training."""
MADE_HERE = ("basis", "spline", "b-spline", "operators")
"""Kinds of artifacts that every stage makes anew, in a folder of their own."""
N_BLOCK_SNAPSHOTS = 16
"""Number of snapshots to read at once."""
NONE = np.full(2, np.inf)
"""The errors of a diverged run, and missing estimates."""


def run(
    context: StageContext,
    tolerance: str | None = None,
    budget: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    write_case: Path | None = None,
) -> None:
    """Choose full runs until a model is within a tolerance, and write the case with their points.

    Parameters
    ----------
    tolerance, budget : replace those of the section `training`.
    workers : number of parallel full runs, and of points that a stage chooses; None chooses one
        point at a time, and makes the first runs on all cores.
    scheduler : address of a Dask scheduler, whose workers make the full runs instead.
    write_case : file of the case with the chosen points; by default in the folder `training`.

    Raises CaseError when there is no region, or the case can't be trained there; UnstableError when
    a full run became unstable: immediately for one of the first runs, otherwise at the end.
    """
    check_options(workers, scheduler)
    share = None if tolerance is None else f"{exact(percent(tolerance, '--tolerance'))}%"
    options = {"tolerance": share, "budget": budget}
    changed = {key: value for key, value in options.items() if value is not None}
    section = context.case.training.model_copy(update=changed)
    case = context.case.model_copy(update={"training": section})
    training = _Training(replace(context, case=case), workers, scheduler)
    path = write_case or training.workspace.folder(FOLDER) / CASE_FILE
    if not path.parent.is_dir():
        raise CaseError(f"--write-case: {path.parent} is not a folder")
    require_writable(path)
    outcome = training.run()
    chosen = trained_at(case, outcome.stages[-1].points)
    write_whole(path, resolved_yaml(chosen, path.parent).encode())
    publish(training.workspace, outcome, path, training.share(outcome.stages[-1].points))
    if failed := [run for stage in outcome.stages for run in stage.held_out if run.failure]:
        labels = ", ".join(run.point.label for run in failed)
        raise UnstableError(
            f"{len(failed)} of the chosen full runs became unstable and were left out: {labels}; "
            "near them the tolerance is not ensured"
        )


class _Training:
    """The stages of a training, one after the other."""

    def __init__(self, context: StageContext, workers: int | None, scheduler: str | None) -> None:
        """Choose the first points. Raises CaseError."""
        self.context = context
        self.case = context.case
        self._at_once, self._scheduler = workers, scheduler
        self.section = self.case.training
        model = fast_section(self.case, self.section.model)
        family_of(self.case).require(Ability.TRAINING, "training")
        if not self.section.ranges or model is None:
            raise CaseError(
                "training: the case has no region of parameters; give ranges, such as --set "
                "'training.reynolds=[50, 1000]'"
            )
        self.model = model
        self.region = Region(self.case)
        self.workspace = Workspace(context)
        self.starts = tuple(self.region.starts(self._existing()))
        tested = self.case.plan.test_points
        self.candidates = [p for p in self.region.candidates() if p not in tested]
        self._check_starts()

    def _existing(self) -> list[ParameterPoint]:
        """Return the case's own training points in the region whose full runs exist."""
        inside = [point for point in self.case.plan.train_points if self.region.contains(point)]
        workspace = Workspace(self._context_of([*self.region.starts(()), *inside]))
        return [
            point for point in inside if workspace.reason_to_make(workspace.full_run(point)) is None
        ]

    def _check_starts(self) -> None:
        """Raise CaseError if the case can't be trained at the first points."""
        case = trained_at(self.case, self.starts)
        for problem in case_problems(case, force=self.context.force):
            raise CaseError(
                f"training: with runs at {self.starts[0].label} and other points, {problem}"
            )
        # Raises CaseError at points without a local basis.
        bases = {case.plan.basis_for(self.model, point) for point in self.candidates}
        if not all(case.plan.has_error_estimate(name) for name in bases):
            raise CaseError(
                "operators.error_estimate: auto makes no error estimates for so many modes, "
                "and training needs them; set it to true"
            )

    def _context_of(self, points: Sequence[ParameterPoint]) -> StageContext:
        """Return a context with the case that is trained at some points."""
        case = trained_at(self.case, points)
        return replace(self.context, case=case, keep_valid=True, known=KnownArtifacts())

    def run(self) -> Outcome:
        """Run stages until the training ends."""
        for point, reason in self._full_runs(self.starts).items():
            raise UnstableError(
                f"{point.label}, a corner of the region: the full run became unstable: {reason}; "
                "try a smaller region"
            )
        points = self.starts
        stages = list[Stage]()
        earlier = tuple[HeldOut, ...]()
        fields = self.section.fields
        while True:
            model = StageModel(self.context, self.model, points)
            name, estimates = f"error of {self.model.name}, {len(points)} full runs", []
            with self.context.report.progress(name, len(self.candidates)) as advance:
                for point in self.candidates:
                    estimates.append(model.estimate(point))
                    advance(1)
            stage = Stage(points, self.candidates, np.array(estimates), model.floor(), earlier)
            ended = ending(
                stage.worst(fields)[0],
                float(stage.floor[list(fields)].max()),
                percentage(self.section.tolerance),
                n_held_out=sum(run.failure is None for run in stage.earlier),
                n_left=self.section.budget - len(stage.tried),
            )
            if ended is not None:
                return Outcome(self.case, self.model.name, (*stages, stage), ended)
            held_out = self._predicted(stage, model)
            stages.append(replace(stage, held_out=held_out))
            earlier += held_out
            points += tuple(run.point for run in held_out if run.failure is None)

    def _full_runs(
        self, points: Sequence[ParameterPoint], trained: Sequence[ParameterPoint] = ()
    ) -> dict[ParameterPoint, str]:
        """Make and map missing full runs at points; return reasons of unstable ones, by point.

        Stopped runs continue from their checkpoints. The points `trained` belong to the case, too.

        Raises SphromError if a run fails for another reason than instability.
        """
        context = self._context_of(tuple(dict.fromkeys((*trained, *points))))
        require_room(context.case, context.out, points, "fom")
        workspace = Workspace(context)
        fom.ensure_packed(workspace)
        missing = [p for p in points if workspace.reason_to_make(workspace.full_run(p)) is not None]
        failed: list[Failure] = []
        if missing:
            number = min(self._at_once or runs_that_fit(context.case, "fom"), len(missing))
            with start_workers(number, self._scheduler, context.report) as workers:
                failed = workers.run("full runs", workspace, missing, make_run)
        for failure in failed:
            if failure.kind is not UnstableError:
                raise failure.kind(f"{failure.point.label}: {failure.reason}")
        # Unstable runs are on disk, too, also those of earlier calls.
        workspace = Workspace(replace(context, known=KnownArtifacts()))
        problems = {failure.point: failure.reason for failure in failed}
        for point in points:
            if point not in problems:
                with workspace.open(workspace.full_run(point)) as run:
                    if run.text("status") != "complete":
                        problems[point] = run.text("status_detail")
        stable = tuple(point for point in points if point not in problems)
        report = context.report.brief(progress=True)
        stages.map_runs(replace(workspace.context, only=stable, report=report))
        return problems

    def _predicted(self, stage: Stage, model: StageModel) -> tuple[HeldOut, ...]:
        """Choose the worst points, apart from each other, run them, and compare the predictions."""
        with start_workers(self._at_once or 1, self._scheduler, self.context.report) as workers:
            at_once = workers.number
        numbers = choose(
            self.region.places(self.candidates),
            stage.judged(self.section.fields),
            self.region.places(stage.tried),
            min(self.section.budget - len(stage.tried), at_once),
            percentage(self.section.tolerance),
        ).tolist()
        problems = self._full_runs([self.candidates[k] for k in numbers], stage.points)
        held_out = []
        for k in numbers:
            point, estimate = self.candidates[k], stage.estimates[k]
            if (problem := problems.get(point)) is not None:
                held_out.append(HeldOut(point, estimate, NONE, NONE, problem))
                self.context.report.warn(
                    f"{point.label}: left out, as its full run became unstable: {problem}"
                )
                continue
            held_out.append(HeldOut(point, estimate, *model.compared(point)))
        return tuple(held_out)

    def share(self, points: Sequence[ParameterPoint]) -> list[str]:
        """Make the case's bases, splines and operators for the chosen points, unless some exist.

        Artifacts of other points are kept, and their names are returned, so that the user decides.
        """
        here = Workspace(self._context_of(points))
        targets = (here.basis(), here.splines(), here.operators())
        existing = [target for target in targets if target.path.exists()]
        kept = [each.path.name for each in existing if here.reason_to_make(each) is not None]
        context = replace(here.context, report=here.context.report.brief(progress=True))
        if not kept:
            stages.make_operators(context)
        return kept


def make_run(task: Task) -> tuple[Failure, ...]:
    """Make the full run of a task."""
    fom.run(task.context(only=task.points, keep_valid=True, resume=True))
    return ()


class StageModel:
    """A model that is trained at some points with mapped full runs."""

    def __init__(
        self, context: StageContext, model: ReducedModelSection, points: Sequence[ParameterPoint]
    ) -> None:
        """Make the bases, splines and operators for the points, unless they are up to date."""
        context = replace(
            context,
            case=trained_at(context.case, points),
            force=True,
            keep_valid=True,
            known=KnownArtifacts(),
            folders=dict.fromkeys(MADE_HERE, Workspace(context).folder(FOLDER)),
            report=context.report.brief(progress=True),
        )
        stages.make_operators(context)
        self.workspace = Workspace(context)
        self._points = points
        self._fast = FastModel(self.workspace, model)

    def estimate(self, point: ParameterPoint) -> Array:
        """Return the estimated errors (2,) of the model at a point, infinite if there are none."""
        if (run := self._run(point)) is None or (own := run.estimate) is None:
            return NONE
        late = self._counted(run.time)
        squares = np.sum(own.errors[late] ** 2, axis=0), np.sum(own.sizes[late] ** 2, axis=0)
        return _percent(*squares)

    def floor(self) -> Array:
        """Return the largest errors (2,) of the best approximations of the training runs."""
        floors = [self.compared(point, approximation=True)[1] for point in self._points]
        return np.asarray(np.max(floors, axis=0))

    def compared(
        self, point: ParameterPoint, *, approximation: bool = False
    ) -> tuple[Array, Array]:
        """Return the errors at a point with a mapped full run, of the model and of its basis.

        The errors (2,) [%] of the model's run are infinite if it diverged. Those of the basis are
        of the best approximation; with `approximation`, only these are computed.
        """
        basis = self._fast.at_point(point).basis
        run = None if approximation else self._run(point)
        error, floor, size = np.zeros((3, 2))
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            counted = np.flatnonzero(self._counted(mapped.read("time")))
            stored = [mapped.dataset(name) for name in ("density_fluctuation", "velocity")]
            for begin in range(counted[0], counted[-1] + 1, N_BLOCK_SNAPSHOTS):
                some = slice(begin, min(begin + N_BLOCK_SNAPSHOTS, counted[-1] + 1))
                density, velocity = (each[some] for each in stored)
                fields = _fields(basis, density, velocity)
                size += _squares(basis, *fields)
                mean = mean_density_fluctuation(basis, density)
                best = reconstruct(basis, project(basis, density, velocity), mean)
                floor += _distance(basis, _fields(basis, *best), fields)
                if run is not None:
                    mean = np.full(len(density), run.reduced.mean_density_fluctuation)
                    state = reconstruct(basis, run.coordinates[some], mean)
                    error += _distance(basis, _fields(basis, *state), fields)
        return NONE if run is None else _percent(error, size), _percent(floor, size)

    def _run(self, point: ParameterPoint) -> FastRun | None:
        """Return the run at a point; None if it diverges or needs too many steps."""
        try:
            run = self._fast.run(point)
        except CaseError:
            return None
        return None if run.failure is not None else run

    def _counted(self, time: Array) -> NDArray[np.bool_]:
        """Return the mask of the compared times."""
        return since(time, self.workspace.case.compare.from_time)


def _fields(basis: TrialBasis, density: Array, velocity: Array) -> tuple[Array, Array]:
    """Return velocities (n_snapshots, n_points, 2), and densities without their means."""
    return velocity, density - weighted_mean(density, basis.weights)[:, None]


def _squares(basis: TrialBasis, velocity: Array, density: Array) -> Array:
    """Return sums of squares (2,) over points and snapshots."""
    of_velocity = np.sum(np.sum(velocity**2, axis=2) @ basis.weights)
    return np.array([of_velocity, np.sum(density**2 @ basis.weights)])


def _distance(basis: TrialBasis, fields: tuple[Array, Array], others: tuple[Array, Array]) -> Array:
    """Return sums of squares (2,) of differences between fields."""
    return _squares(basis, *(a - b for a, b in zip(fields, others, strict=True)))


def _percent(squares: Array, sizes: Array) -> Array:
    """Return the relative errors [%] from sums of squares of errors and of fields."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = 100.0 * np.sqrt(squares / sizes)
    return np.where(np.isfinite(shares), shares, np.inf)
