"""Command `run`: every stage that the case needs, skipping what is there and still valid."""

from __future__ import annotations

from dataclasses import replace

from sphrom.compare import compare
from sphrom.errors import UnstableError
from sphrom.offline import fit_psi, fom, map, operators, pod
from sphrom.online import rom
from sphrom.setup.context import StageContext


def run(context: StageContext) -> None:
    """Run all stages in order.

    A case without reduced models needs its full runs only. Artifacts that are valid are kept. With
    `force`, those that no longer belong to the case are made again; without, they stop the run. A
    reduced model that diverges does not keep the others from being compared; it is reported at
    the end.
    """
    context = replace(context, keep_valid=True)
    unstable: UnstableError | None = None
    fom.run(context)
    for stage in (map.run, pod.run, fit_psi.run) if context.case.rom else ():
        stage(context)
    if context.case.reference_bases:
        operators.run(context)
    try:
        rom.run(context)
    except UnstableError as error:
        unstable = error
    compare.run(context)
    if unstable is not None:
        raise unstable
