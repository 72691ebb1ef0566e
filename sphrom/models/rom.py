"""Stage `rom`: reduced runs, on moving particles (Alg. 3.4-3.5) or on the reference points.

A run imports only the modules of its own kind; one from operators imports no kernels of SPH.
"""

from __future__ import annotations

from importlib import import_module

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.workspace import Target, Workspace


def run(context: StageContext) -> None:
    """Run every reduced model of the case at the chosen parameter points.

    Raises UnstableError after all runs if one diverged; its artifact records the divergence.
    """
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only, "rom")
    unstable = []
    at = context.case.plan.rom_points
    runs = [(m, p) for m in context.chosen_models for p in context.chosen(at(m))]
    if not runs:
        context.report.info("no reduced model to run")
    for model, point in runs:
        target = ensure_run(workspace, model, point)
        remove_checkpoints(target)
        with workspace.open_intermediate(target) as trajectory:  # checked once, not twice
            if trajectory.text("status") != "complete":
                detail = trajectory.text("status_detail")
                unstable.append(f"{model.name}, {point.label}: {detail}")
    if unstable:
        raise UnstableError("\n".join(unstable))


def ensure_run(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> Target:
    """Run a reduced model at a parameter point unless its run is up to date."""
    target = workspace.reduced_run(model, point)
    if workspace.must_make(target):
        kind = "points.runs" if model.from_operators else "particles.runs"
        if workspace.case.scene.has_surface:
            kind = "surface.model"
        import_module(f"sphrom.models.{kind}").run_point(workspace, model, point)
    return target
