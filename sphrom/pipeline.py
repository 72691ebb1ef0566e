"""Command `run`: every stage that the case needs, skipping what is there and still valid."""

from __future__ import annotations

from dataclasses import replace

from sphrom.case.messages import nearest, show
from sphrom.case.models import Case
from sphrom.compare import compare
from sphrom.errors import CaseError, UnstableError
from sphrom.offline import fit_psi, fom, map, operators, pod
from sphrom.online import rom
from sphrom.setup.context import StageContext

STAGES = {
    "fom": fom,
    "map": map,
    "pod": pod,
    "fit-psi": fit_psi,
    "operators": operators,
    "rom": rom,
    "compare": compare,
}
"""The stages in their order."""


def run(context: StageContext, until: str | None = None) -> None:
    """Run all stages in order, or those `until` one, itself included.

    Artifacts that are valid are kept. With `force`, those that no longer belong to the case are
    made again; without, they stop the run. A reduced model that diverges does not keep the others
    from being compared; it is reported at the end.

    Raises CaseError when there is no such stage.
    """
    context = replace(context, keep_valid=True)
    unstable: UnstableError | None = None
    for name in _needed(context.case, until):
        try:
            STAGES[name].run(context)
        except UnstableError as error:
            if name != "rom":
                raise
            unstable = error
    if unstable is not None:
        raise unstable


def _needed(case: Case, until: str | None) -> list[str]:
    """Return the stages that a case needs: one without reduced models its full runs only."""
    names = list(STAGES)
    if until is not None:
        if until not in names:
            raise CaseError(f"no stage is called {show(until)}; {nearest(str(until), names)}")
        names = names[: names.index(until) + 1]
    spared = set() if case.rom else {"map", "pod", "fit-psi"}
    if not case.reference_bases:
        spared.add("operators")
    return [name for name in names if name not in spared]
