"""What making a reduced model costs: the full runs that it learns from, and the stages after."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.timings import is_imported, known_seconds
from sphrom.store.operators import memory_timing
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace


def offline_seconds(
    workspace: Workspace, model: ReducedModelSection, points: Iterable[ParameterPoint]
) -> tuple[float | None, float | None]:
    """Return the cost of making a reduced model [s]: all of it, and the full runs it learns from.

    Spin-ups and packing count; the closures of other models, in the same artifact, don't. None
    where nobody knows, as the cost of an imported run is unknown.
    """
    case = workspace.case
    names = {case.basis_for(model, point): None for point in points}
    trained = {point: None for name in names for point in case.bases[name]}
    runs: dict[Path, Target] = {}
    for point in trained:
        _collect(workspace.full_run(point), runs)
    spent = [_full_seconds(workspace, run) for run in runs.values()]
    known = [seconds for seconds in spent if seconds is not None]
    if len(known) < len(spent):
        return None, None
    training = sum(known)
    stages = [workspace.mapped(point) for point in trained]
    stages += [workspace.basis(), workspace.splines()]
    offline = training + sum(_wall_seconds(workspace, stage) for stage in stages)
    if model.from_operators:
        offline += _operator_seconds(workspace, model, names)
    return offline, training


def _collect(target: Target, found: dict[Path, Target]) -> None:
    """Add a target and all that it is made from."""
    found[target.path] = target
    for parent in target.parents.values():
        _collect(parent, found)


def _operator_seconds(
    workspace: Workspace, model: ReducedModelSection, names: Iterable[str]
) -> float:
    closures = workspace.case.memory_models
    own = [(name, model.size) for name in names if model.projection == "apg"]
    with workspace.open(workspace.operators()) as artifact:
        others = [
            artifact.number(memory_timing(*closure)) for closure in closures if closure not in own
        ]
        return artifact.number("wall_seconds") - sum(others)


def _full_seconds(workspace: Workspace, target: Target) -> float | None:
    """Return the cost of a full run, or of an artifact it is made from [s]; None if unknown."""
    with workspace.open(target) as artifact:
        if is_imported(artifact):
            return known_seconds(artifact)
        return artifact.number("wall_seconds")


def _wall_seconds(workspace: Workspace, target: Target) -> float:
    with workspace.open(target) as artifact:
        return artifact.number("wall_seconds")
