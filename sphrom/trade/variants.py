"""Full models at other Mach numbers and smoothing lengths, for `trade --extremes`.

Both are properties of the full model: a reduced model has them from the runs that it learns from.
Each value has full runs, bases and operators of its own, in a folder of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sphrom.case.checks import case_problems, coarser_resolution
from sphrom.case.messages import show_path
from sphrom.case.models import Case
from sphrom.case.parameters import ParameterSection, TestValues, TrainValues
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.offline import fit_psi, fom, operators, pod
from sphrom.offline import map as mapping
from sphrom.setup.reporters import BriefReporter
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade import full as trade_full
from sphrom.trade.candidates import global_basis
from sphrom.trade.full import Variant

VARIED = {
    "Mach number": ("fluid", "mach_number", "mach"),
    "h/dx": ("discretization", "smoothing_length_ratio", "hdx"),
}
"""Section and key of each varied property, and how the names of its folders begin."""


@dataclass(frozen=True)
class Varied:
    """The full model with another value of a property."""

    what: str
    """A key of VARIED."""
    value: float
    variant: Variant

    @property
    def full_run(self) -> str:
        """How tables call its full run."""
        case = self.variant.case
        return f"full run, {case.discretization.resolution} across, to {case.time.final_time:.4g} s"

    @property
    def label(self) -> str:
        """How warnings call it."""
        return f"{self.what} {exact(self.value)}"


def varied_models(case: Case, models: Sequence[ReducedModelSection]) -> list[Varied]:
    """Return the full model at every Mach number and smoothing length that a case lists.

    `models` are the reduced ones to be made of each.
    """
    asked = case.trade.extremes
    listed = {"Mach number": asked.mach_numbers, "h/dx": asked.smoothing_length_ratios}
    return [
        Varied(what, value, variant_of(case, models, what, value))
        for what, values in listed.items()
        for value in sorted(set(values))
    ]


def variant_of(
    case: Case, models: Sequence[ReducedModelSection], what: str, value: float
) -> Variant:
    """Return the full model with another value of a property, at the trained points.

    It has as many snapshots as the case. Where its steps would be more than the case allows, its
    time is cut, and the snapshots are closer.
    """
    section, key, folder = VARIED[what]
    changed = getattr(case, section).model_copy(update={key: value})
    other = learning_from(case, case.bases[global_basis(case)]).model_copy(
        update={section: changed}
    )
    resolution = coarser_resolution(case) or case.discretization.resolution
    plan, courant = step_plan(case), case.time.courant_number
    variant = trade_full.with_steps(other, resolution, courant, plan)
    share = min(1.0, case.trade.extremes.max_steps / step_plan(variant.case).n_steps)
    if share < 1.0:
        shorter = replace(plan, time_step=share * plan.time_step)
        variant = trade_full.with_steps(other, resolution, courant, shorter)
    duration = share * (plan.n_snapshots - 1) * plan.snapshot_interval
    from_time = share * case.compare.from_time
    changes = {
        "time": variant.case.time.model_copy(update={"final_time": duration}),
        "compare": case.compare.model_copy(update={"from_time": from_time}),
        "rom": tuple(models),
    }
    name = f"extreme-{resolution}-{folder}{exact(value)}"
    return Variant(name, variant.case.model_copy(update=changes))


def learning_from(case: Case, points: Sequence[ParameterPoint]) -> Case:
    """Return a case with full runs at some points and no others, and one basis."""
    if len(case.parameter_names) == 1:
        train = TrainValues(reynolds=tuple(point.reynolds for point in points))
    else:
        train = TrainValues(points=tuple(point.as_dict() for point in points))
    changes = {
        "parameters": ParameterSection(train=train, test=TestValues()),
        "basis": case.basis.model_copy(update={"subsets": {}, "lagrangian": False}),
        "operators": case.operators.model_copy(update={"error_estimate": False}),
    }
    return case.model_copy(update=changes)


def learnt(workspace: Workspace, varied: Varied) -> Workspace:
    """Make a variant's full runs and the artifacts of its reduced models; return their workspace.

    Raises
    ------
    UnstableError
        When one of its full runs is unstable.
    CaseError
        When the case can't be had with that value.
    ResourceError
        When a run would not fit this machine.
    """
    if problems := case_problems(varied.variant.case):
        where = show_path(problems[0].path)
        raise CaseError(f"{where}: {problems[0].reason}" if where else problems[0].reason)
    report = BriefReporter(workspace.context.report, label=varied.label)
    own = trade_full.workspace_of(
        Workspace(replace(workspace.context, report=report, only=None)), varied.variant
    )
    for stage in (fom, mapping, pod, fit_psi, operators):
        stage.run(own.context)
    return own
