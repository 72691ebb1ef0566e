"""What the commands do with their arguments; what takes long to import is imported here, late."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphrom.cli.console import ConsoleReporter, tell
from sphrom.cli.interrupts import ignored_interrupts
from sphrom.errors import CaseError
from sphrom.text import exact

if TYPE_CHECKING:
    from sphrom.case.models import Case
    from sphrom.case.points import ParameterPoint

RUNS = Path("runs")
"""Where artifacts go unless --out says otherwise."""
ARTIFACT_SUFFIX = ".h5"
"""What the names of artifacts end in."""

STAGES = {
    "check": "setup.check",
    "fom": "offline.fom",
    "map": "offline.map",
    "pod": "offline.pod",
    "fit_psi": "offline.fit_psi",
    "operators": "offline.operators",
    "rom": "online.rom",
    "compare": "compare.compare",
    "pipeline": "pipeline",
    "trade": "trade.trade",
    "extremes": "trade.extremes",
    "sweep": "sweep.sweep",
    "import_": "exchange.import_",
    "export": "exchange.export",
    "report": "report.report",
}
"""The module of each stage, loaded when it is run."""


@dataclass(frozen=True)
class Options:
    """What every stage can be told on the command line."""

    case: Path
    out: Path | None = None
    overrides: Sequence[str] = field(default=())
    force: bool = False
    threads: int | None = None
    quiet: bool = False
    only: Sequence[str] = field(default=())
    resume: bool = False
    every: float = 60.0
    """Seconds from one checkpoint to the next."""


def run_stage(stage: str, options: Options, **asked: object) -> None:
    """Load the case and run one stage on it, with what else is asked of it.

    Raises SphromError, of which each kind is an exit code.
    """
    from sphrom.case.checks import case_warnings
    from sphrom.case.loader import load_case
    from sphrom.setup.context import StageContext

    if math.isnan(options.every):
        raise CaseError("--checkpoint-every: must be a number of seconds; got nan")
    case = load_case(options.case, options.overrides, options.force)
    report = ConsoleReporter(quiet=options.quiet)
    if (advice := ignored_interrupts()) is not None:
        report.info(advice)
    for warning in case_warnings(case):
        report.warn(warning)
    context = StageContext(
        case=case,
        out=options.out or RUNS / case.name,
        force=options.force,
        threads=options.threads,
        report=report,
        only=_select(case, options.only, _points(case, stage)),
        keep_valid=options.resume,
        resume=options.resume,
        checkpoint_every=options.every,
    )
    with _warnings_of_kernels(report):
        _module(stage).run(context, **asked)


def _module(stage: str) -> Any:
    """Return the module of a stage."""
    return import_module(f"sphrom.{STAGES[stage]}")


@contextmanager
def _warnings_of_kernels(report: ConsoleReporter) -> Iterator[None]:
    """Show in one line what the kernels warn of, within the block."""
    from sphrom.kernels.code_cache import CodeCacheWarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, CodeCacheWarning):
            report.warn(str(message))
        else:
            before(message, category, *place, **more)

    with warnings.catch_warnings():
        before, warnings.showwarning = warnings.showwarning, show
        yield


def export(source: Path, to: str, into: Path | None, at: Sequence[str], options: Options) -> None:
    """Export one artifact, or all of a case's, told apart by how the name ends."""
    if source.suffix != ARTIFACT_SUFFIX:
        run_stage("export", options, to=to, into=into, at=at)
        return
    for name, given in (("--set", options.overrides), ("--only", options.only), ("--at", at)):
        if given:
            raise CaseError(f"{name}: goes with a case file, not with an artifact ({source})")
    report = ConsoleReporter(quiet=options.quiet)
    _module("export").run_file(source, to, into, options.force, report)


def import_snapshots(files: Sequence[Path], options: Options, **meaning: Any) -> None:
    """Make a full run of a case from files that another program wrote."""
    from sphrom.exchange.foreign_snapshots import Meaning

    run_stage("import_", options, files=files, meaning=Meaning(**meaning))


def _points(case: Case, stage: str) -> tuple[ParameterPoint, ...]:
    """Return the points that a stage can run at."""
    if stage in ("trade", "extremes"):
        from sphrom.trade.candidates import extreme_points, trade_points

        return extreme_points(case) if stage == "extremes" else trade_points(case)
    if stage in ("rom", "export"):
        reduced = (point for model in case.rom for point in case.rom_points(model))
        return tuple(dict.fromkeys((*case.points, *reduced)))
    return case.points


def _select(
    case: Case, only: Sequence[str], points: Sequence[ParameterPoint]
) -> tuple[ParameterPoint, ...] | None:
    """Return those of some points that --only names, each `name=value`."""
    known = {point.label: point for point in points}
    elsewhere = {point.label for model in case.rom for point in case.rom_points(model)}
    elsewhere.update(point.label for point in case.points)
    chosen = dict.fromkeys(_label(text) for text in only)
    for label in chosen:
        if label in elsewhere.difference(known):
            raise CaseError(
                f"--only: this command doesn't run at {label}, though others do; it runs at "
                f"{', '.join(known)}"
            )
        if label not in known:
            raise CaseError(f"--only: the case has no {label}; it has {', '.join(known)}")
    return tuple(known[label] for label in chosen) or None


def _label(text: str) -> str:
    name, _, value = text.partition("=")
    try:
        return f"{name.strip()}={exact(float(value))}"
    except ValueError as error:
        raise CaseError(f"--only: must be like reynolds=100; got {text!r}") from error


def parse_shard(text: str | None) -> tuple[int, int] | None:
    """Return which share of how many `I/N` names, such as 2/8."""
    if text is None:
        return None
    number, _, total = text.partition("/")
    if not (number.isdecimal() and total.isdecimal() and 1 <= int(number) <= int(total)):
        raise CaseError(f"--shard: must be like 1/8, up to 8/8; got {text!r}")
    return int(number), int(total)


def new_case(kind: str, target: Path | None, *, force: bool) -> None:
    """Print a commented case, or write it to a file that isn't there yet."""
    from sphrom.case import template

    text = template.new_case(kind)
    if target is None:
        print(text, end="")
        return
    _write(target, text, force=force)
    tell(f"wrote {target}; next: sphrom case check {target}")
    schema = target.with_name(template.SCHEMA_FILE)
    if not schema.exists():
        tell(f"for completion and checks in an editor: sphrom case schema --out {schema}")


def _write(target: Path, text: str, *, force: bool) -> None:
    """Write a file, over another with `force` only. Raises CaseError when it can't be."""
    try:
        with target.open("w" if force else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise CaseError(f"{target}: is there already; --force writes over it") from error
    except OSError as error:
        raise CaseError(f"{target}: can't be written: {error.strerror}") from error


def print_schema(target: Path | None = None, *, force: bool = False) -> None:
    """Print the JSON schema of case files, or write it to a file."""
    from sphrom.case.schema import json_schema

    text = json.dumps(json_schema(), indent=2)
    if target is None:
        print(text)
        return
    _write(target, text + "\n", force=force)
    tell(f"wrote {target}")
