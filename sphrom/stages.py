"""The list of stages, and functions that run one stage or all stages of a case.

The command line and Python programs share it. Stages are imported when they run: some load long.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphrom.errors import CaseError, UnstableError
from sphrom.text import counted, duration, exact, nearest, quoted

if TYPE_CHECKING:
    from sphrom.case.models import Case
    from sphrom.case.points import ParameterPoint
    from sphrom.console import Reporter
    from sphrom.progress import StageTime
    from sphrom.setup.context import StageContext

RUNS = Path("runs")
"""Default folder of artifacts."""
ADDRESS = r"([a-z]+://)?[^\s/]+:[0-9]+"
"""Pattern of a scheduler's address; Dask would wait long for any other."""
PIPELINE = ("fom", "map", "pod", "fit-psi", "operators", "rom", "compare")
"""The stages of the command `run`, in order."""
STAGES = {
    "check": "setup.cost",
    "draw": "setup.draw",
    "fom": "models.fom",
    "map": "models.stages:map_runs",
    "pod": "models.stages:make_basis",
    "fit-psi": "models.stages:fit_splines",
    "operators": "models.stages:train_models",
    "rom": "models.stages:run_models",
    "compare": "compare.compare",
    "figures": "compare.figures",
    "trade": "trade.trade",
    "extremes": "trade.extremes",
    "sweep": "sweep.sweep",
    "fit": "fit.fit",
    "train": "train.train",
    "import": "exchange.import_",
    "export": "exchange.export",
    "report": "report.report",
}
"""The module of each stage, with the name of its function unless that is `run`."""

WITH_WORKERS = ("fom", "map", "rom", "trade", "extremes", "sweep", "train")
"""The stages whose runs other processes may make, by the options `workers` and `scheduler`."""
STUDIES = ("figures", "trade", "extremes", "sweep", "train", "import", "report")
"""Further stages with progress, whose times `study_times` estimates."""


def context_of(
    case: Case, report: Reporter, out: Path | None, force: bool, threads: int | None
) -> StageContext:
    """Return the context in which stages run on a case, and report the case's warnings."""
    from sphrom.case.hints import case_warnings
    from sphrom.setup.context import StageContext

    for warning in case_warnings(case):
        report.warn(warning)
    return StageContext(case, folder_of(case, out), force, threads, report)


def folder_of(case: Case, out: Path | None) -> Path:
    """Return the folder of a case's artifacts: `out`, or the default for its name."""
    return out or RUNS / case.name


def with_checkpoints(context: StageContext, *, resume: bool, every: float) -> StageContext:
    """Return a context in which runs write a checkpoint `every` so many seconds.

    With `resume`, stopped runs continue from them. Raises CaseError for a negative interval.
    """
    if not every >= 0.0:
        raise CaseError(f"--checkpoint-every: must be a number of seconds; got {every:g}")
    return replace(context, keep_valid=resume, resume=resume, checkpoint_every=every)


def with_workers(
    context: StageContext, workers: int | None = None, scheduler: str | None = None
) -> StageContext:
    """Return a context with processes for independent runs.

    Raises CaseError for processes of both kinds, or if a scheduler has no address.
    """
    if workers is not None and scheduler is not None:
        raise CaseError("--workers: can't be combined with --scheduler, which has its own workers")
    if scheduler is not None and re.fullmatch(ADDRESS, scheduler) is None:
        example = "such as tcp://node1:8786"
        raise CaseError(f"--scheduler: must be an address {example}; got {quoted(scheduler)}")
    return replace(context, workers=workers, scheduler=scheduler)


def run_stage(stage: str, context: StageContext, **asked: Any) -> Any:
    """Run one stage with its own options `asked`, and return its result.

    Raises SphromError.
    """
    has_workers = stage in WITH_WORKERS
    if has_workers:
        workers = asked.pop("workers", context.workers)
        context = with_workers(context, workers, asked.pop("scheduler", context.scheduler))
    with (
        _warnings_in_lines(context.report),
        _whole(context, [stage], asked) as context,
        context.report.stage(stage),
    ):
        module, _, name = STAGES[stage].partition(":")
        run = getattr(import_module(f"sphrom.{module}"), name or "run")
        parameters = signature(run).parameters
        known = [*parameters][1:] + ["workers", "scheduler"] * has_workers
        takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
        for option in asked:
            if option not in known and not takes_any:
                raise CaseError(
                    f"{stage}: has no option {quoted(option)}; {nearest(option, known)}"
                )
        return run(context, **asked)


def run_all(context: StageContext, until: str | None = None) -> None:
    """Run all stages that the case needs, up to and including the stage `until`.

    Valid artifacts are kept. An artifact that no longer belongs to the case is made again with
    `force`, and stops the run otherwise, before anything is computed. If a reduced model diverges,
    the others are still compared, and the error is raised at the end. Each stage reports one line,
    and its details go to the log; the last stage reports the results.

    Raises CaseError when there is no such stage.
    """
    from sphrom.models.stages import require_replaceable
    from sphrom.store.workers import compiled_ahead

    unstable: UnstableError | None = None
    stages = _needed(context.case, until)
    require_replaceable(context, stages)
    has_listed = "operators" in stages and context.case.scene.domain.n_dim == 2
    ahead = compiled_ahead() if has_listed else nullcontext()
    with ahead, _whole(replace(context, keep_valid=True), stages, {}) as context:
        for stage in stages:
            started = time.monotonic()
            before = len(context.known.written)
            try:
                run_stage(stage, replace(context, report=context.report.details))
            except UnstableError as error:
                if stage != "rom":
                    raise
                unstable = error
            if stage != PIPELINE[-1]:
                number = len(context.known.written) - before
                made = f"made {counted(number, 'artifact')}" if number else "all artifacts exist"
                context.report.info(f"{stage}: {made}, {duration(time.monotonic() - started)}")
    if unstable is not None:
        raise unstable


@contextmanager
def _whole(
    context: StageContext, stages: Sequence[str], asked: Mapping[str, Any]
) -> Iterator[StageContext]:
    """Show the progress of stages in all, and provide a context that reports it."""

    def times() -> Mapping[str, StageTime]:
        if stages[0] in STUDIES:
            from sphrom.study_times import times_of_study

            return times_of_study(context, stages[0], asked)
        from sphrom.setup.cost import stage_times

        known = stage_times(context)
        return {stage: known[stage] for stage in stages}

    if not set(stages) <= {*PIPELINE, *STUDIES}:
        yield context
        return
    with context.report.whole(times) as report:
        yield replace(context, report=report)


def _needed(case: Case, until: str | None) -> list[str]:
    """Return the stages that a case needs; without reduced models, these are its full runs."""
    from sphrom.models.contract import Ability, family_of

    if until is not None and until not in PIPELINE:
        raise CaseError(f"no stage is called {quoted(until)}; {nearest(str(until), PIPELINE)}")
    spared = set() if case.rom else {"map", "pod", "fit-psi"}
    if not family_of(case).can(Ability.MODE_FIELDS):
        spared.add("fit-psi")
    if not case.plan.reference_bases:
        spared.add("operators")
    last = PIPELINE.index(until or PIPELINE[-1])
    return [stage for stage in PIPELINE[: last + 1] if stage not in spared]


@contextmanager
def _warnings_in_lines(report: Reporter) -> Iterator[None]:
    """Within the block, report warnings of the kernels' cache in one line and ignore overflows.

    Kernels that are compiled are shown by name. Values that aren't finite are refused later, when
    they are written.
    """
    from sphrom.console import show_compiling
    from sphrom.kernels.code_cache import CodeCacheWarning, CompilingWarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **details: Any) -> None:
        if issubclass(category, CodeCacheWarning):
            tell = report.note if issubclass(category, CompilingWarning) else report.warn
            tell(str(message))
            if tell == report.note:
                show_compiling()
        elif not issubclass(category, RuntimeWarning):
            before(message, category, *where, **details)

    with warnings.catch_warnings():
        before = warnings.showwarning
        warnings.showwarning = show
        yield


def selected(context: StageContext, stage: str, only: Sequence[str]) -> StageContext:
    """Return a context restricted to the models and points that the texts of `--only` select.

    A name selects a model, `name=value,...` selects points. If no text selects a model, all models
    are selected, and likewise for points.

    Raises CaseError where the stage runs no such model, or at no such point.
    """
    models = [model.name for model in context.case.rom if stage in ("rom", "export")]
    names = tuple(text for text in only if text in models)
    all_points = _points(context.case, stage)
    points: dict[ParameterPoint, None] = {}
    for text in only:
        selection = [point for point in all_points if _agrees(point, text)]
        if not selection and text not in names:
            runs = ", ".join([*(point.label for point in all_points), *models])
            raise CaseError(f"--only: got {text!r}; this command runs {runs}")
        points.update(dict.fromkeys(selection))
    return replace(context, only=tuple(points) or None, models=names or None)


def _agrees(point: ParameterPoint, text: str) -> bool:
    """Return whether a point has the parameter values of a text such as lid=0.8,reynolds=150."""
    values = point.as_dict()
    try:
        wanted = [part.split("=") for part in text.split(",")]
        return all(exact(values[name.strip()]) == exact(float(value)) for name, value in wanted)
    except (KeyError, ValueError):
        return False


def _points(case: Case, stage: str) -> tuple[ParameterPoint, ...]:
    """Return the points that a stage can run at."""
    if stage in ("trade", "extremes"):
        from sphrom.trade.candidates import trade_points

        return trade_points(case)
    if stage in ("rom", "export"):
        reduced = (point for model in case.rom for point in case.plan.rom_points(model))
        return tuple(dict.fromkeys((*case.plan.points, *reduced)))
    return case.plan.points
