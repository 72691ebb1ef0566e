"""Run the stages of a case: what the command line and Python programs have in common.

Stages are imported when they are run, as some take long to load.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphrom.errors import CaseError
from sphrom.text import exact

if TYPE_CHECKING:
    from sphrom.case.models import Case
    from sphrom.case.points import ParameterPoint
    from sphrom.console import Reporter
    from sphrom.setup.context import StageContext

RUNS = Path("runs")
"""Where artifacts go unless another folder is named."""

STAGES = {
    "check": "setup.cost",
    "draw": "setup.draw",
    "fom": "offline.fom",
    "map": "offline.map",
    "pod": "offline.pod",
    "fit_psi": "offline.fit_psi",
    "operators": "offline.operators",
    "rom": "online.rom",
    "compare": "compare.compare",
    "figures": "compare.figures",
    "pipeline": "pipeline",
    "trade": "trade.trade",
    "extremes": "trade.extremes",
    "sweep": "sweep.sweep",
    "fit": "fit.fit",
    "train": "train.train",
    "import_": "exchange.import_",
    "export": "exchange.export",
    "report": "report.report",
}
"""The module of each stage, loaded when it is run."""


def context_of(
    case: Case,
    report: Reporter,
    *,
    out: Path | None = None,
    force: bool = False,
    threads: int | None = None,
) -> StageContext:
    """Return what a stage needs to know to run on a case, and report the case's warnings."""
    from sphrom.case.hints import case_warnings
    from sphrom.setup.context import StageContext

    for warning in case_warnings(case):
        report.warn(warning)
    return StageContext(
        case=case,
        out=folder_of(case, out),
        force=force,
        threads=threads,
        report=report,
    )


def folder_of(case: Case, out: Path | None) -> Path:
    """Return the folder of a case's artifacts: the one that is given, or its own."""
    return out or RUNS / case.name


def with_checkpoints(context: StageContext, *, resume: bool, every: float) -> StageContext:
    """Return a context whose runs are continued, or not, and leave checkpoints `every` seconds.

    Raises CaseError where that is no time.
    """
    if not every >= 0.0:
        raise CaseError(f"--checkpoint-every: must be a number of seconds; got {every:g}")
    return replace(context, keep_valid=resume, resume=resume, checkpoint_every=every)


def run_stage(stage: str, context: StageContext, **asked: Any) -> None:
    """Run one stage, with what else is asked of it.

    Raises SphromError.
    """
    with _warnings_in_lines(context.report):
        import_module(f"sphrom.{STAGES[stage]}").run(context, **asked)


@contextmanager
def _warnings_in_lines(report: Reporter) -> Iterator[None]:
    """Show in one line what the kernels' cache warns of, and nothing of overflows, in the block.

    Values that aren't finite are refused where they are written, by name and place.
    """
    from sphrom.kernels.code_cache import CodeCacheWarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, CodeCacheWarning):
            report.warn(str(message))
        elif not issubclass(category, RuntimeWarning):
            before(message, category, *place, **more)

    with warnings.catch_warnings():
        before, warnings.showwarning = warnings.showwarning, show
        yield


def selected(context: StageContext, stage: str, only: Sequence[str]) -> StageContext:
    """Return a context with the models and the points that texts such as `--only` has choose.

    A name is a model's, `name=value,...` is of points; without one of a kind all of it is chosen.

    Raises CaseError where the stage runs no such model, or at no such point.
    """
    names = [text for text in only if "=" not in text and _is_model(context.case, stage, text)]
    points = selected_points(context.case, stage, [text for text in only if text not in names])
    return replace(context, only=points, models=tuple(names) or None)


def _is_model(case: Case, stage: str, text: str) -> bool:
    """Return whether a text names a model of the case. Raises CaseError where one can't be run."""
    from sphrom.case.messages import nearest

    names = [model.name for model in case.rom]
    if stage != "rom":
        if text in names:
            raise CaseError(f"--only: this command can't be limited to a model, {text}; rom can")
        return False
    if text not in names:
        raise CaseError(
            f"--only: must be a model of the case, or like reynolds=100; got {text!r}; "
            f"{nearest(text, names)}"
        )
    return True


def selected_points(
    case: Case, stage: str, only: Sequence[str]
) -> tuple[ParameterPoint, ...] | None:
    """Return the points of a stage with some values, each text `name=value,...`; None is all.

    Raises CaseError where it doesn't run at one.
    """
    points = _points(case, stage)
    elsewhere = [point for model in case.rom for point in case.plan.rom_points(model)]
    elsewhere += case.plan.points
    chosen: dict[ParameterPoint, None] = {}
    for text in only:
        wanted = _wanted(text)
        found = [point for point in points if _agrees(point, wanted)]
        label = ", ".join(f"{name}={exact(value)}" for name, value in wanted.items())
        known = ", ".join(point.label for point in points)
        if not found and any(_agrees(point, wanted) for point in elsewhere):
            raise CaseError(
                f"--only: this command doesn't run at {label}, though others do; it runs at {known}"
            )
        if not found:
            raise CaseError(f"--only: the case has no {label}; it has {known}")
        chosen.update(dict.fromkeys(found))
    return tuple(chosen) or None


def _agrees(point: ParameterPoint, wanted: Mapping[str, float]) -> bool:
    """Return whether a point has the wanted values; it may have others beside them."""
    values = point.as_dict()
    return all(exact(values[n]) == exact(v) if n in values else False for n, v in wanted.items())


def _points(case: Case, stage: str) -> tuple[ParameterPoint, ...]:
    """Return the points that a stage can run at."""
    if stage in ("trade", "extremes"):
        from sphrom.trade.candidates import extreme_points, trade_points

        return extreme_points(case) if stage == "extremes" else trade_points(case)
    if stage in ("rom", "export"):
        reduced = (point for model in case.rom for point in case.plan.rom_points(model))
        return tuple(dict.fromkeys((*case.plan.points, *reduced)))
    return case.plan.points


def _wanted(text: str) -> dict[str, float]:
    """Return the values by name of a text such as lid=0.8,reynolds=150."""
    wanted = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        try:
            wanted[name.strip()] = float(value)
        except ValueError as error:
            raise CaseError(f"--only: must be like reynolds=100; got {text!r}") from error
    return wanted
