"""Full models at other Mach numbers and smoothing lengths, for `trade --extremes`.

Both are properties of the full model: a reduced model has them from the runs that it learns from.
Each value has full runs, bases and operators of its own, in a folder of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from sphrom.case.checks import case_problems
from sphrom.case.messages import show_path
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.sections import ReducedModelSection
from sphrom.case.trade_checks import coarser_resolution
from sphrom.errors import CaseError
from sphrom.offline import fit_psi, fom, operators, pod
from sphrom.offline import map as mapping
from sphrom.plots.tables import format_figure
from sphrom.setup.context import Reporter
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade import full as trade_full
from sphrom.trade.candidates import global_basis
from sphrom.trade.full import Variant

STAGES = (fom, mapping, pod, fit_psi, operators)
"""What makes the artifacts of a variant, in this order."""


def _with_mach_number(case: Case, value: float) -> Case:
    section = case.fluid.model_copy(update={"mach_number": value})
    return case.model_copy(update={"fluid": section})


def _with_smoothing_length(case: Case, value: float) -> Case:
    section = case.discretization.model_copy(update={"smoothing_length_ratio": value})
    return case.model_copy(update={"discretization": section})


CHANGES: Mapping[str, Callable[[Case, float], Case]] = {
    "Mach number": _with_mach_number,
    "h/dx": _with_smoothing_length,
}
"""What is varied, and how a case with a value of it is had."""
FOLDERS = {"Mach number": "mach", "h/dx": "hdx"}
"""What the names of their folders begin with."""
SAME_TIME = 1e-9
"""How far, relatively, times may be apart that are one."""


@dataclass(frozen=True)
class Varied:
    """The full model with another value of something, to learn from."""

    what: str
    """A key of CHANGES."""
    value: float
    variant: Variant

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
    """Return the full model with another value of something, at the trained points.

    It has as many snapshots as the case. Where its steps would be more than the case allows, its
    time is cut, and the snapshots are closer.
    """
    other = CHANGES[what](_learning(case), value)
    resolution = coarser_resolution(case) or case.discretization.resolution
    plan = step_plan(case)
    variant = trade_full.with_steps(other, resolution, case.time.courant_number, plan)
    share = min(1.0, case.trade.extremes.max_steps / step_plan(variant.case).n_steps)
    if share < 1.0:
        shorter = replace(plan, time_step=share * plan.time_step)
        variant = trade_full.with_steps(other, resolution, case.time.courant_number, shorter)
    duration = share * (plan.n_snapshots - 1) * plan.snapshot_interval
    compare = case.compare.model_copy(update={"from_time": share * case.compare.from_time})
    changes = {
        "time": variant.case.time.model_copy(update={"final_time": duration}),
        "compare": compare,
        "rom": tuple(models),
    }
    name = f"extreme-{resolution}-{FOLDERS[what]}{exact(value)}"
    return Variant(name, variant.case.model_copy(update=changes))


def _learning(case: Case) -> Case:
    """Return a case with the runs that the global basis learns from, and no others."""
    trained = tuple(point.reynolds for point in case.bases[global_basis(case)])
    train = case.parameters.train.model_copy(update={"reynolds": trained})
    test = case.parameters.test.model_copy(update={"reynolds": ()})
    changes = {
        "parameters": case.parameters.model_copy(update={"train": train, "test": test}),
        "basis": case.basis.model_copy(update={"subsets": {}, "lagrangian": False}),
        "operators": case.operators.model_copy(update={"error_estimate": False}),
    }
    return case.model_copy(update=changes)


def learnt(workspace: Workspace, varied: Varied) -> Workspace:
    """Make the full runs of a variant, and what its reduced models need; return where they are.

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
    report = _Quiet(workspace.context.report, varied.label)
    quiet = Workspace(replace(workspace.context, report=report, only=None))
    own = trade_full.workspace_of(quiet, varied.variant)
    for stage in STAGES:
        stage.run(own.context)
    return own


def describe(variants: Sequence[Varied]) -> str:
    """Return which full runs were made, in words."""
    first = variants[0].variant.case
    points = ", ".join(point.label for point in first.train_points)
    longest = max(each.variant.case.time.final_time for each in variants)
    cut = [
        f"; {each.label} to {format_figure(each.variant.case.time.final_time)} s"
        for each in variants
        if each.variant.case.time.final_time < longest * (1.0 - SAME_TIME)
    ]
    resolution = first.discretization.resolution
    return (
        f"Mach numbers and h/dx have full runs of their own, {resolution} across, to "
        f"{format_figure(longest)} s, at {points}" + "".join(cut)
    )


class _Quiet:
    """Passes warnings on to a reporter, and says whom they are about."""

    def __init__(self, report: Reporter, label: str) -> None:
        self._report = report
        self._label = label

    def info(self, text: str) -> None:
        """Keep it."""

    def warn(self, text: str) -> None:
        """Warn the user in one line."""
        self._report.warn(f"{self._label}: {text}")

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Keep it."""

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Keep it: a bar counts the variants."""
        yield lambda done: None
