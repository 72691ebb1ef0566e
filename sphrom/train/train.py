"""Stage `train`: choose training runs until a model is within a tolerance in all of a region.

This is weak greedy training (`sphrom.reduction.greedy`): the model's error is estimated at many
points of the region, and the full model runs where the estimate is largest. That run becomes a
training run, and the next stage begins. A repeated command makes the same choices and continues
where it was stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.checks import case_problems
from sphrom.case.model_sections import AUTO, ReducedModelSection
from sphrom.case.models import Case, resolved_yaml
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Region, changed, fast_section, percent, trained_at
from sphrom.case.study_sections import TrainingSection, percentage
from sphrom.errors import CaseError, UnstableError
from sphrom.models.contract import Ability, family_of
from sphrom.reduction.greedy import Ending, choose, ending
from sphrom.setup.context import StageContext
from sphrom.store.variants import Variant
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.train.outcome import FOLDER, OSCILLATING, HeldOut, Outcome, Stage, publish
from sphrom.train.surrogate import Surrogate
from sphrom.whole_files import require_writable, write_whole

CASE_FILE = "case.yaml"
"""Name of the case with the chosen points, in the folder of the training."""


def run(
    context: StageContext,
    tolerance: str | None = None,
    budget: int | None = None,
    write_case: Path | None = None,
) -> None:
    """Choose full runs until a model is within a tolerance, and write the case with their points.

    At each stage it chooses as many points as the context has workers, which make their runs.

    Parameters
    ----------
    tolerance, budget : replace those of the section `training`.
    write_case : file of the case with the chosen points; by default in the folder `training`.

    Raises CaseError when there is no region, or the case can't be trained there; UnstableError when
    a full run became unstable: immediately for one of the first runs, otherwise at the end.
    """
    options: dict[str, object] = {}
    if tolerance is not None:
        options["tolerance"] = f"{exact(percent(tolerance, '--tolerance'))}%"
    if budget is not None:
        options["budget"] = budget
    case = changed(context.case, training=options)
    context = replace(context, case=case)
    model = _model(case)
    if case.training.quantity == AUTO:
        oscillates = model.settles_on_cycles and case.plan.oscillations
        quantity = OSCILLATING if oscillates else "velocity"
        case = changed(case, training={"quantity": quantity})
        context = replace(context, case=case)
    region = Region(case)
    starts = region.starts(_existing(context, region))
    candidates = [p for p in region.candidates() if p not in case.plan.test_points]
    _check_starts(context, model, starts, candidates)
    path = write_case or Workspace(context).folder(FOLDER) / CASE_FILE
    if not path.parent.is_dir():
        raise CaseError(f"--write-case: {path.parent} is not a folder")
    require_writable(path)
    surrogate = Surrogate(context, model, starts)
    stages, ended = greedy(surrogate, region, candidates, case.training)
    write_whole(path, resolved_yaml(trained_at(case, surrogate.points), path.parent).encode())
    outcome = Outcome(case.training, model.name, stages, ended)
    publish(context, outcome, path, surrogate.share())
    if failed := [run for stage in stages for run in stage.held_out if run.failure]:
        labels = ", ".join(run.point.label for run in failed)
        raise UnstableError(
            f"{len(failed)} of the chosen full runs became unstable and were left out: "
            f"{labels}; near them the model may miss the tolerance"
        )


def greedy(
    surrogate: Surrogate,
    region: Region,
    candidates: Sequence[ParameterPoint],
    section: TrainingSection,
) -> tuple[list[Stage], Ending]:
    """Extend a surrogate where it is worst among candidates, until training ends."""
    tolerance = percentage(section.tolerance)
    stages: list[Stage] = []
    earlier: tuple[HeldOut, ...] = ()
    while True:
        with surrogate.part():
            estimates, floor = surrogate.evaluate(candidates)
            stage = Stage(surrogate.points, candidates, estimates, floor, earlier, section.fields)
            stages.append(stage)
            n_left = section.budget - len(stage.tried)
            ended = ending(
                stage.worst[0],
                stage.worst_floor,
                tolerance,
                n_held_out=len(stage.complete),
                n_left=n_left,
            )
            if ended is not None:
                return stages, ended
            chosen = choose(
                region.places(candidates),
                stage.judged,
                region.places(stage.tried),
                min(n_left, surrogate.at_once),
                tolerance,
            )
            held_out = surrogate.extend({candidates[k]: estimates[k] for k in chosen.tolist()})
            stages[-1] = replace(stage, held_out=held_out)
            earlier += held_out


def _model(case: Case) -> ReducedModelSection:
    """Return the model to train. Raises CaseError if there is none, or no region."""
    model = fast_section(case, case.training.model)
    family_of(case, model).require(Ability.TRAINING, "training")
    limits_oscillations = case.training.quantity == OSCILLATING
    if limits_oscillations and not (model and model.settles_on_cycles and case.plan.oscillations):
        raise CaseError(
            "training.quantity: oscillation needs a model with calibrated: cycle, and a measured "
            "frequency"
        )
    if not case.training.ranges or model is None:
        raise CaseError(
            "training: the case has no region of parameters; give ranges, such as --set "
            "'training.reynolds=[50, 1000]'"
        )
    return model


def _existing(context: StageContext, region: Region) -> list[ParameterPoint]:
    """Return the case's own training points in the region whose full runs exist."""
    inside = [point for point in context.case.plan.train_points if region.contains(point)]
    case = trained_at(context.case, [*region.starts(()), *inside])
    workspace = Variant(context, case).workspace
    return [p for p in inside if workspace.reason_to_make(workspace.full_run(p)) is None]


def _check_starts(
    context: StageContext,
    model: ReducedModelSection,
    starts: Sequence[ParameterPoint],
    candidates: Sequence[ParameterPoint],
) -> None:
    """Raise CaseError if the case can't be trained at the first points."""
    case = trained_at(context.case, starts)
    for problem in case_problems(case, force=context.force):
        raise CaseError(f"training: with runs at {starts[0].label} and other points, {problem}")
    # Raises CaseError at points without a local basis.
    bases = {case.plan.basis_for(model, point) for point in candidates}
    if not all(map(case.plan.has_error_estimate, bases)):
        raise CaseError(
            "operators.error_estimate: auto makes no error estimates for so many modes, but "
            "training needs them; set it to true"
        )
