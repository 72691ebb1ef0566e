"""The stages that make reduced models and run them, equal for all families.

A stage imports only the modules of the family of its models; a run from operators imports no
kernels of SPH.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from sphrom.artifacts import write_record
from sphrom.artifacts.records.reduced_models import HistoryTable
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.case.tables import MeasuredSection
from sphrom.errors import UnstableError
from sphrom.models.contract import Ability, family_of
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.tasks import Task, Told, recorded
from sphrom.store.workers import made_by_workers
from sphrom.store.workspace import Target, Workspace


def require_replaceable(context: StageContext, stages: Sequence[str]) -> None:
    """Check before several stages run that none would end at an artifact it must not overwrite.

    Nothing is checked if a full run will be continued, which changes all later artifacts.

    Raises ArtifactError that names the first such artifact.
    """
    workspace = Workspace(context)
    case = context.case
    plan = case.plan
    if context.force or any(workspace.shorter_run(point) is not None for point in plan.points):
        return
    alone = [m for m in case.rom if family_of(case, m).can(Ability.RUNS_ALONE)]
    last = [*map(workspace.model, alone)]
    last += [workspace.reduced_run(m, point) for m in case.rom for point in plan.rom_points(m)]
    last.append(workspace.comparison())
    targets: dict[Path, Target] = {}

    def add(target: Target) -> None:
        if target.path not in targets:
            for parent in target.parents.values():
                add(parent)
            targets[target.path] = target  # after its parents

    for target in last:
        add(target)
    for target in targets.values():
        if target.stage in stages:
            workspace.require_replaceable(target)


def map_runs(context: StageContext) -> None:
    """Stage `map`: map the full runs of the chosen parameter points."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only, "map")
    points = context.chosen(context.case.plan.points)
    targets = {(point, ""): workspace.mapped(point) for point in points}
    workspace = Workspace(made_by_workers(workspace, "maps", make_map, targets)[0])
    for point in points:
        ensure_mapped(workspace, point)


def make_map(task: Task) -> Told:
    """Map the full run of a task."""
    return recorded(task, lambda workspace: ensure_mapped(workspace, task.points[0]))


def ensure_mapped(workspace: Workspace, point: ParameterPoint) -> None:
    """Map a full run unless its map is up to date."""
    if workspace.must_make(workspace.mapped(point)):
        workspace.require(workspace.full_run(point))
        family_of(workspace.case).part("map_run")(workspace, point)


def make_basis(context: StageContext) -> None:
    """Stage `pod`: decompose the mapped snapshots of the training runs."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, None, "pod")
    if workspace.must_make(workspace.basis()):
        family_of(context.case).part("make_basis")(workspace)


def fit_splines(context: StageContext) -> None:
    """Stage `fit-psi`: fit splines to the modes of every basis."""
    family_of(context.case).part("fit_splines")(Workspace(context))


def project(context: StageContext) -> None:
    """Write the operators of all bases that a model from operators uses."""
    workspace = Workspace(context)
    if not context.case.plan.reference_bases:
        context.report.info("no reduced model has evaluation: operators: no operators to project")
        return
    require_room(context.case, workspace.out, None, "operators")
    if workspace.must_make(workspace.operators()):
        family_of(context.case).part("project")(workspace)


OPERATORS = make_basis, fit_splines, project
"""The stages that make operators from mapped full runs, without models in files."""


def train_models(context: StageContext) -> None:
    """Stage `operators`: project the operators, and train the models that are built from them.

    A model without the necessary corrections gets no artifact: its runs report why.
    """
    project(context)
    workspace = Workspace(context)
    case = context.case
    histories = getattr(case.scene, "histories", {}).items()
    measured = {name: one for name, one in histories if isinstance(one, MeasuredSection)}
    for section in case.rom:
        family = family_of(case, section)
        target = workspace.model(section)
        if not (family.can(Ability.RUNS_ALONE) and workspace.must_make(target)):
            continue
        started = time.perf_counter()
        common = {
            "model": section.name,
            "reference_density": case.fluid.reference_density,
            "sound_speed": case.plan.sound_speed,
            "histories": {name: HistoryTable.of(history) for name, history in measured.items()},
        }
        stored = family.part("trained")(workspace, section, common)
        if stored is not None:
            with workspace.create(target) as artifact:
                write_record(artifact, stored)
                artifact.annotate("timing/training", time.perf_counter() - started)


def run_models(context: StageContext) -> None:
    """Stage `rom`: run every reduced model of the case at the chosen parameter points.

    Raises UnstableError after all runs if one diverged; its artifact records the divergence.
    """
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only, "rom")
    unstable = []
    at = context.case.plan.rom_points
    runs = [(m, p) for m in context.chosen_models for p in context.chosen(at(m))]
    if not runs:
        context.report.info("no reduced model to run")
    # Runs from operators take less time than to tell a process of them.
    targets = {
        (point, model.name): workspace.reduced_run(model, point)
        for model, point in runs
        if not family_of(context.case, model).can(Ability.RUNS_ALONE)
    }
    workspace = Workspace(made_by_workers(workspace, "reduced runs", make_run, targets)[0])
    for model, point in runs:
        target = ensure_run(workspace, model, point)
        remove_checkpoints(target)
        with workspace.open_intermediate(target) as trajectory:  # checked once, not twice
            if trajectory.text("status") != "complete":
                detail = trajectory.text("status_detail")
                unstable.append(f"{model.name}, {point.label}: {detail}")
    if unstable:
        raise UnstableError("\n".join(unstable))


def make_run(task: Task) -> Told:
    """Make the reduced run of a task."""

    def make(workspace: Workspace) -> None:
        model = next(model for model in workspace.case.rom if model.name == task.model)
        remove_checkpoints(ensure_run(workspace, model, task.points[0]))

    return recorded(task, make)


def ensure_run(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> Target:
    """Run a reduced model at a parameter point unless its run is up to date."""
    target = workspace.reduced_run(model, point)
    if workspace.must_make(target):
        family_of(workspace.case, model).part("run_point")(workspace, model, point)
    return target
