"""Stage `train`: the full runs that a model needs to be within a tolerance all over a region.

Weak greedy training (`sphrom.reduction.greedy`): the model's error is estimated at many points of
the region, the full model is run where it is worst, and the model learns from that run too. Full
runs and maps are those of the case and stay; bases, splines and operators are made anew each time,
in a folder of their own, which takes a small part of the time of a full run.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.checks import case_problems
from sphrom.case.identity import resolved_yaml
from sphrom.case.loader import case_of_text
from sphrom.case.messages import show_path
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Region, trained_at, training_model
from sphrom.case.study_sections import percentage
from sphrom.errors import ArtifactError, CaseError, UnstableError, error_of, machine_error
from sphrom.offline import fom
from sphrom.offline import map as map_stage
from sphrom.reduction.greedy import Progress, choose, ending
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.setup.cost import require_room, runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep.workers import Failure, Task, check_options, start_workers
from sphrom.train import report as train_report
from sphrom.train.journal import HeldOut, Journal, Stage
from sphrom.train.model import NONE, StageModel
from sphrom.train.report import FOLDER, Outcome, judged
from sphrom.whole_files import remove_whole, require_writable, write_whole

Array = NDArray[np.float64]

CASE_FILE = "case.yaml"
"""What the case with the chosen points is called, in the training's folder."""


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
    tolerance, budget : in place of those of the section `training`.
    workers : full runs at once, for each of which a point is chosen; None makes the first ones on
        all cores, and chooses one point at a time.
    scheduler : address of a Dask scheduler, whose workers make the full runs instead.
    write_case : where the case with the chosen points goes; None is into the folder `training`.

    Raises
    ------
    CaseError
        When there is no region, or the case can't be trained there.
    UnstableError
        When a full run became unstable: at once one of the first, after all other runs.
    """
    check_options(workers, scheduler)
    if write_case is not None:
        _check_case_path(write_case)
    case = _with_options(context.case, tolerance, budget)
    training = _Training(replace(context, case=case), workers, scheduler)
    path = write_case or training.folder / CASE_FILE
    _check_case_file(path, case, training.starts)
    outcome = training.run()
    found = trained_at(case, outcome.stages[-1].points)
    write_whole(path, resolved_yaml(found).encode())
    kept = training.share()
    train_report.publish(training.workspace, outcome, path, kept)
    if failed := [run for stage in outcome.stages for run in stage.held_out if run.failure]:
        labels = ", ".join(run.point.label for run in failed)
        raise UnstableError(
            f"{len(failed)} of the chosen full runs became unstable and were left out: {labels}; "
            "nothing is promised near them"
        )


def _check_case_path(path: Path) -> None:
    """Raise CaseError unless a file can be written there."""
    if not path.parent.is_dir():
        raise CaseError(f"--write-case: {path.parent} is no folder")
    try:
        require_writable(path)
    except ArtifactError as error:
        raise CaseError(f"--write-case: {error}") from error


def _check_case_file(path: Path, case: Case, points: Sequence[ParameterPoint]) -> None:
    """Raise CaseError unless a case, trained at some points, can be read there."""
    try:
        case_of_text(resolved_yaml(trained_at(case, points)), path.parent)
    except CaseError as error:
        raise CaseError(
            "--write-case: the case names files beside it, so name a file in "
            f"{case.folder}; in {path.parent} it can't be read"
        ) from error


def _with_options(case: Case, tolerance: str | None, budget: int | None) -> Case:
    """Return the case with options in place of keys. Raises CaseError where they are invalid."""
    changed: dict[str, object] = {}
    if tolerance is not None:
        try:
            percentage(tolerance)
        except ValueError as error:
            raise CaseError(f"--tolerance: {error}; got {tolerance!r}") from error
        changed["tolerance"] = tolerance
    if budget is not None:
        changed["budget"] = budget
    return case.model_copy(update={"training": case.training.model_copy(update=changed)})


class _Training:
    """The stages of a training, one after the other."""

    def __init__(self, context: StageContext, workers: int | None, scheduler: str | None) -> None:
        """Find the stages that are there, or where to begin. Raises CaseError."""
        self.context, self.case = context, context.case
        self._at_once, self._scheduler = workers, scheduler
        self.section = self.case.training
        model = training_model(self.case)
        if not self.section.ranges or model is None:
            raise CaseError(
                "training: the case names no region of parameters; give ranges, such as --set "
                "'training.reynolds=[50, 1000]'"
            )
        self.model = model
        self.region = Region(self.case)
        self.workspace = Workspace(context)
        self.folder = self.workspace.folder(FOLDER)
        if context.force:  # what an earlier training chose goes; full runs and maps stay
            for path in self.folder.glob("*.h5"):
                remove_whole(path)
        self.journal = Journal(self.case, model, self.folder, context.report, anew=context.force)
        stages = self.journal.stages
        self.starts = stages[0].points if stages else tuple(self.region.starts(self._known()))
        tested = self.case.plan.test_points
        self.candidates = [p for p in self.region.candidates() if p not in tested]
        self._check_starts()
        self._stage_model: tuple[int, StageModel] | None = None

    def _known(self) -> list[ParameterPoint]:
        """Return the case's own training points in the region whose full runs are there."""
        inside = [point for point in self.case.plan.train_points if self.region.contains(point)]
        corners = self.region.starts(())
        workspace = Workspace(self._context_of([*corners, *inside]))
        return [
            point for point in inside if workspace.reason_to_make(workspace.full_run(point)) is None
        ]

    def _check_starts(self) -> None:
        """Raise CaseError where the case can't be trained at the first points."""
        case = trained_at(self.case, self.starts)
        if problems := case_problems(case, force=self.context.force):
            problem = problems[0]
            raise CaseError(
                f"training: trained at {self.starts[0].label} and other points, "
                f"{show_path(problem.path)}: {problem.reason}"
            )
        # Raises CaseError where there is no local basis.
        bases = {case.plan.basis_for(self.model, point) for point in self.candidates}
        if not all(case.plan.has_error_estimate(name) for name in bases):
            raise CaseError(
                "operators.error_estimate: auto estimates no errors of so many modes, and training "
                "goes by them: set it to true"
            )
        if len(self.starts) >= self.section.budget:
            raise CaseError(
                f"training.budget: training starts from {len(self.starts)} full runs (the region's "
                "ends, and those of parameters.train that are there) and needs at least one more, "
                f"to test what the model promises; got {self.section.budget}"
            )

    def _context_of(self, points: Sequence[ParameterPoint]) -> StageContext:
        """Return a context with a case that is trained at some points."""
        case = trained_at(self.case, points)
        return replace(self.context, case=case, keep_valid=True, known=KnownArtifacts())

    def run(self) -> Outcome:
        """Go through the stages until training ends."""
        if not self.journal.stages:
            self._make_first()
        while True:
            stage = self._stage()
            ended = ending(self._progress(stage), self._tolerance, self.section.budget)
            if ended is not None:
                candidates, stages = tuple(self.candidates), tuple(self.journal.stages)
                return Outcome(self.case, self.region, self.model.name, candidates, stages, ended)
            self.journal.complete(self._predicted(stage))

    @property
    def _tolerance(self) -> float:
        return percentage(self.section.tolerance)

    def _make_first(self) -> None:
        for point, reason in self._full_runs(self.starts, self.starts).items():
            raise UnstableError(
                f"{point.label}, where the region ends: the full run became unstable: {reason}; "
                "a smaller region, time.courant_number or finer resolution may help"
            )

    def _full_runs(
        self, learnt: Sequence[ParameterPoint], points: Sequence[ParameterPoint]
    ) -> dict[ParameterPoint, str]:
        """Make full runs, and return why some became unstable."""
        context = self._context_of(tuple(dict.fromkeys((*learnt, *points))))
        return make(context, points, self._at_once, self._scheduler)

    def _stage(self) -> Stage:
        """Return the stage that is to be judged: the last one, or the one after it."""
        stages = self.journal.stages
        if stages and not stages[-1].held_out:
            return stages[-1]
        points = self.starts
        if stages:
            new = (run.point for run in stages[-1].held_out if run.failure is None)
            points = (*stages[-1].points, *new)
        if stages and len(points) == len(stages[-1].points):
            # All that were chosen became unstable: the model is the same.
            self.journal.add(replace(stages[-1], held_out=()))
            return self.journal.stages[-1]
        model = self._model_at(points)
        name = f"error of {self.model.name}, {len(points)} full runs"
        with self.context.report.progress(name, len(self.candidates)) as advance:
            estimates = []
            for point in self.candidates:
                estimates.append(model.estimate(point))
                advance(1)
        self.journal.add(Stage(points, np.array(estimates), model.floor()))
        return self.journal.stages[-1]

    def _model_at(self, points: Sequence[ParameterPoint]) -> StageModel:
        """Return the model that learnt from full runs at points; of each number there is one."""
        if self._stage_model is None or self._stage_model[0] != len(points):
            found = StageModel(self.context, self.model, points, self.folder)
            self._stage_model = len(points), found
        return self._stage_model[1]

    def _progress(self, stage: Stage) -> Progress:
        fields, earlier = list(self.section.fields), self.journal.held_out
        tried = {run.point for run in earlier} | set(stage.points)
        free = np.array([point not in tried for point in self.candidates])
        failed = sum(run.failure is not None for run in earlier)
        unstable = {run.point for run in earlier if run.failure}
        stable = np.array([point not in unstable for point in self.candidates])
        worst = judged(stage.estimates, earlier, fields)[stable].max()
        return Progress(
            worst_estimate=float(worst),
            floor=float(stage.floor[fields].max()),
            n_held_out=len(earlier) - failed,
            n_runs=len(stage.points) + failed,
            n_left=int(free.sum()),
        )

    def _predicted(self, stage: Stage) -> list[HeldOut]:
        """Choose points, make their full runs, and compare the model that hasn't seen them."""
        chosen = self._chosen(stage)
        problems = self._full_runs(stage.points, chosen)
        model, found = self._model_at(stage.points), []
        index = {point: k for k, point in enumerate(self.candidates)}
        for point in chosen:
            estimate = stage.estimates[index[point]]
            if point in problems:
                found.append(HeldOut(point, estimate, NONE, NONE, problems[point]))
                self.context.report.warn(
                    f"{point.label}: left out, as its full run became unstable: {problems[point]}"
                )
                continue
            found.append(HeldOut(point, estimate, *model.compared(point)))
            self.context.report.info(train_report.told(found[-1], self.section.fields))
        return found

    def _chosen(self, stage: Stage) -> list[ParameterPoint]:
        """Return where the full model is run next: at the worst points, apart from each other."""
        earlier, fields = self.journal.held_out, list(self.section.fields)
        tried = [*stage.points, *(run.point for run in earlier if run.failure is not None)]
        left = self.section.budget - len(tried)
        with start_workers(self._at_once or 1, self._scheduler, self.context.report) as workers:
            at_once = workers.number
        numbers = choose(
            self.region.places(self.candidates),
            judged(stage.estimates, earlier, fields),
            self.region.places(tried),
            min(left, at_once),
            self._tolerance,
        )
        return [self.candidates[k] for k in numbers]

    def share(self) -> list[str]:
        """Put the bases, splines and operators of the last stage where the case's are, if none is.

        What is there of another case stays, and its names are returned: the user decides.
        """
        points = self.journal.stages[-1].points
        self._model_at(points)
        here = Workspace(self._context_of(points))
        kept = []
        for target in (here.basis(), here.splines(), here.operators()):
            if not target.path.exists():
                _copy(self.folder / target.path.name, target.path)
            elif here.reason_to_make(target) is not None:
                kept.append(target.path.name)
        return kept


def _copy(source: Path, path: Path) -> None:
    """Copy a file so that it is there as a whole or not at all."""
    temporary = path.with_name(f".{path.name}-copy")
    try:
        shutil.copyfile(source, temporary)
        temporary.replace(path)
    except OSError as error:
        raise machine_error(error) from error


def make(
    context: StageContext,
    points: Sequence[ParameterPoint],
    workers: int | None,
    scheduler: str | None,
) -> dict[ParameterPoint, str]:
    """Make the full runs at points that are not there, map them, and say why some are unstable.

    The context's case has all points. Runs that were stopped go on from their checkpoints.

    Raises SphromError where a run fails for another reason than that it became unstable.
    """
    require_room(context.case, context.out, points, "fom")
    workspace = Workspace(replace(context, known=KnownArtifacts()))
    fom.ensure_packed(workspace)
    missing = [p for p in points if workspace.reason_to_make(workspace.full_run(p)) is not None]
    failed = _run(workspace, missing, workers, scheduler) if missing else []
    for failure in failed:
        if failure.exit_code != UnstableError.exit_code:
            raise error_of(failure.exit_code, f"{failure.point.label}: {failure.reason}")
    # Runs that became unstable are on disk too, as those of an earlier call are.
    workspace = Workspace(replace(context, known=KnownArtifacts()))
    problems = {failure.point: failure.reason for failure in failed}
    for point in points:
        if point not in problems:
            with workspace.open(workspace.full_run(point)) as run:
                if run.text("status") != "complete":
                    problems[point] = run.text("status_detail")
    stable = tuple(point for point in points if point not in problems)
    report = context.report.brief(progress=True)
    map_stage.run(replace(workspace.context, only=stable, report=report))
    return problems


def _run(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    workers: int | None,
    scheduler: str | None,
) -> list[Failure]:
    number = min(workers or runs_that_fit(workspace.case, "fom"), len(points))
    with start_workers(number, scheduler, workspace.context.report) as found:
        return found.run("full runs", workspace, points, make_run)


def make_run(task: Task) -> tuple[Failure, ...]:
    """Make the full run of a task."""
    fom.run(task.context(only=task.points, keep_valid=True, resume=True))
    return ()
