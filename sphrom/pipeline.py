"""Command `run`: every stage that the case needs, skipping what is there and still valid.

A stage is told of in one line, its details are for the log; the answer comes last.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from sphrom.case.models import Case
from sphrom.compare import compare
from sphrom.compare.answer import tell_answer
from sphrom.compare.tables import Tables
from sphrom.console import format_seconds
from sphrom.errors import CaseError, UnstableError
from sphrom.offline import fit_psi, fom, map, operators, pod
from sphrom.online import rom
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.text import counted, nearest, quoted

STAGES: Mapping[str, Callable[[StageContext], Tables | None]] = {
    "fom": fom.run,
    "map": map.run,
    "pod": pod.run,
    "fit-psi": fit_psi.run,
    "operators": operators.run,
    "rom": rom.run,
    "compare": compare.make,
}
"""The stages in their order; the last one returns the tables of the comparison."""


def run(context: StageContext, until: str | None = None) -> None:
    """Run all stages in order, or those `until` one, itself included.

    Artifacts that are valid are kept. With `force`, those that no longer belong to the case are
    made again; without, they stop the run. A reduced model that diverges does not keep the others
    from being compared; it is reported at the end.

    Raises CaseError when there is no such stage.
    """
    context = replace(context, keep_valid=True)
    tables: Tables | None = None
    unstable: UnstableError | None = None
    for name in _needed(context.case, until):
        try:
            tables = _run_stage(name, context)
        except UnstableError as error:
            if name != "rom":
                raise
            unstable = error
    if tables is not None:
        tell_answer(Workspace(context), tables)
    if unstable is not None:
        raise unstable


def _run_stage(name: str, context: StageContext) -> Tables | None:
    """Run one stage, tell in a line what it made, and return its result."""
    started, before = time.monotonic(), len(context.known.written)
    result = STAGES[name](replace(context, report=context.report.details))
    number = len(context.known.written) - before
    made = f"made {counted(number, 'artifact')}" if number else "all is there"
    context.report.info(f"{name}: {made}, {format_seconds(time.monotonic() - started)}")
    return result


def _needed(case: Case, until: str | None) -> list[str]:
    """Return the stages that a case needs: one without reduced models its full runs only."""
    names = list(STAGES)
    if until is not None:
        if until not in names:
            raise CaseError(f"no stage is called {quoted(until)}; {nearest(str(until), names)}")
        names = names[: names.index(until) + 1]
    spared = set() if case.rom else {"map", "pod", "fit-psi"}
    if not case.plan.reference_bases:
        spared.add("operators")
    return [name for name in names if name not in spared]
