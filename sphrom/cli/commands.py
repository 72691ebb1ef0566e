"""What the commands do with their arguments; what takes long to import is imported here, late."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sphrom import stages
from sphrom.cli.failures import ignored_interrupts
from sphrom.cli.options import Options
from sphrom.console import LOG, LogFile, Reporter, recorded, require_log, tell
from sphrom.errors import CaseError
from sphrom.exchange.meaning import Meaning
from sphrom.whole_files import open_to_write

WITHOUT_LOG = ("check", "draw")
"""Stages that leave nothing beside the artifacts."""
ARTIFACT_SUFFIX = ".h5"
"""What the names of artifacts end in."""


def run_stage(stage: str, options: Options, **asked: object) -> None:
    """Load the case and run one stage on it, with what else is asked of it.

    Raises SphromError, of which each kind is an exit code.
    """
    from sphrom.case.loader import load_case

    case = load_case(options.case, options.overrides, options.force)
    log = None if stage in WITHOUT_LOG else _log(options, stages.folder_of(case, options.out))
    report = _reporter(options, log)
    with recorded(log, ["sphrom", *sys.argv[1:]]):
        if (advice := ignored_interrupts()) is not None:
            report.info(advice)
        context = stages.context_of(
            case,
            report,
            out=options.out,
            force=options.force,
            threads=options.threads,
        )
        context = stages.with_checkpoints(context, resume=options.resume, every=options.every)
        context = stages.selected(context, stage, options.only)
        context = replace(context, words=shlex.join(options.words))
        stages.run_stage(stage, context, **asked)


def _reporter(options: Options, log: LogFile | None = None) -> Reporter:
    """Return whom a command tells how it is getting on. Raises CaseError for a contradiction."""
    if options.quiet and options.verbose:
        raise CaseError("--quiet: contradicts --verbose; choose one")
    return Reporter(quiet=options.quiet, verbose=options.verbose, log=log)


def _log(options: Options, folder: Path) -> LogFile:
    path = folder / LOG if options.log is None else require_log(options.log)
    return LogFile(path)


def export(to: str, into: Path | None, at: Sequence[str], options: Options) -> None:
    """Export one artifact, or all of a case's, told apart by how the name ends."""
    source = options.case
    if source.suffix != ARTIFACT_SUFFIX:
        run_stage("export", options, to=to, into=into, at=at)
        return
    from sphrom.exchange import export as stage

    for name, given in (("--set", options.overrides), ("--only", options.only), ("--at", at)):
        if given:
            raise CaseError(f"{name}: goes with a case file, not with an artifact ({source})")
    stage.run_file(source, to, into, options.force, _reporter(options))


def import_snapshots(
    files: Sequence[Path], options: Options, meaning: Meaning, write_case: Path | None
) -> None:
    """Make a full run of a case, or of one written for them, from another program's files."""
    if write_case is not None:
        from sphrom.exchange.instants import fitting_text

        text, keys = fitting_text(options.case, options.overrides, files, meaning)
        _write(write_case, text, force=options.force)
        tell(f"wrote {write_case}, with {' '.join(keys)}; next: sphrom run {write_case}")
        options = replace(options, case=write_case, overrides=())
    run_stage("import_", options, files=files, meaning=meaning)


def parse_shard(text: str | None) -> tuple[int, int] | None:
    """Return which share of how many `I/N` names, such as 2/8."""
    if text is None:
        return None
    number, _, total = text.partition("/")
    if not (re.fullmatch(r"\d{1,9}/\d{1,9}", text) and 1 <= int(number) <= int(total)):
        raise CaseError(f"--shard: must be like 1/8, up to 8/8; got {text!r}")
    return int(number), int(total)


def new_case(kind: str | None, target: Path | None, *, full: bool, force: bool) -> None:
    """Print a case to start from, or write it to a file that isn't there yet."""
    from sphrom.case import template

    text = template.new_case(template.require_kind(kind), full=full)
    if target is None:
        print(text, end="")
        return
    _write(target, text, force=force)
    tell(f"wrote {target}; next: sphrom case check {target}")
    schema = target.with_name(template.SCHEMA_FILE)
    if not schema.exists():
        tell(f"for completion and checks in an editor: sphrom case schema -o {schema}")


def copy_example(name: str | None, target: Path | None, *, force: bool) -> None:
    """Write one of the cases that come with the program, or list them."""
    from sphrom.case import template

    if name is None:
        known = template.examples()
        width = max(map(len, known))
        for each, path in known.items():
            tell(f"{each:{width}}  {template.title(path)}")
        return
    source = template.example(name)
    target = target or Path(source.name)
    _write(target, source.read_text(encoding="utf-8"), force=force)
    tell(f"wrote {target}; next: sphrom run {target}")


def show_case(source: Path, overrides: Sequence[str], *, force: bool) -> None:
    """Print every key of a case with its value."""
    from sphrom.case.loader import load_case
    from sphrom.case.models import resolved_yaml

    print(resolved_yaml(load_case(source, overrides, force)), end="")


def _write(target: Path, text: str, *, force: bool) -> None:
    """Write a file, over another with `force` only. Raises CaseError when it can't be."""
    try:
        with open_to_write(target, "w" if force else "x") as file:
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
