"""Arguments and options that several commands have, and how a command gets them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from sphrom.cli import completion

CaseFile = Annotated[
    Path,
    typer.Argument(
        metavar="CASE",
        help="The case file (YAML).",
        show_default=False,
        autocompletion=completion.case_files,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="Folder of the artifacts.  [default: runs/<name of the case>]"
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the case, such as time.step=1e-3.",
        autocompletion=completion.keys,
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Write over artifacts; insist on a step beyond its limit."),
]
ForceRun = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Make again what no longer belongs to the case, and only that; insist on a step "
        "beyond its limit.",
    ),
]
ForceCheck = Annotated[
    bool, typer.Option("--force", help="Insist on a step beyond its limit, as stages do.")
]
OutCheck = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Folder whose disk has to have room.  [default: runs/<name of the case>]",
    ),
]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, metavar="N", help="Threads to use.  [default: all cores]"),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show warnings and results only.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Show details and all tables.")]
Log = Annotated[
    Path | None,
    typer.Option(
        "--log",
        metavar="FILE",
        help="Add what the command says, with details, to this file.  [default: sphrom.log, beside "
        "the artifacts]",
    ),
]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Go on from the checkpoints of runs that were stopped."),
]
CheckpointEvery = Annotated[
    float,
    typer.Option(
        "--checkpoint-every",
        min=0.0,
        metavar="SECONDS",
        help="Time from one checkpoint of a run to the next, more where writing takes long; 0 is "
        "after every step.",
    ),
]
Only = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        metavar="NAME=VALUE[,...]",
        help="At these parameter values only; with rom also a MODEL's name, for this model only. "
        "May be repeated.",
        autocompletion=completion.values,
    ),
]


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
    verbose: bool = False
    log: Path | None = None
    """Where the log goes; None is beside the artifacts."""

    @property
    def words(self) -> list[str]:
        """The arguments by which another command finds the same artifacts."""
        changes = [word for text in self.overrides for word in ("--set", text)]
        out = [] if self.out is None else ["--out", str(self.out)]
        return [str(self.case), *changes, *out]


COMMON: Mapping[str, tuple[Any, object]] = {
    "case": (CaseFile, Parameter.empty),
    "out": (Out, None),
    "overrides": (Set, None),
    "force": (Force, False),
    "threads": (Threads, None),
    "quiet": (Quiet, False),
    "verbose": (Verbose, False),
    "log": (Log, None),
    "only": (Only, None),
    "resume": (Resume, False),
    "every": (CheckpointEvery, 60.0),
}
"""Annotations and defaults of common options, by the fields of `Options`."""
WHOLE = tuple(COMMON)[:8]
"""Options of a stage that takes the whole case."""
BY_POINT = (*WHOLE, "only")
"""The same of one that may be run at some parameter values only."""
OF_RUNS = tuple(COMMON)
"""The same of one whose long runs may be stopped and resumed."""


def command(
    app: typer.Typer,
    name: str,
    taken: Sequence[str] = WHOLE,
    help: str | None = None,
    own: Sequence[Parameter] = (),
    **instead: Any,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds a function as a command, with some common options.

    The function gets these as `Options`, and has the command's own as further parameters.

    Parameters
    ----------
    taken : names of COMMON.
    help : by default the function's docstring.
    own : options of the command that the function gets as further keywords.
    instead : annotations of common options that mean something else, such as `force`.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            options = {key: given.pop(key) for key in taken}
            for key in {"overrides", "only"} & options.keys():
                options[key] = options[key] or ()
            function(Options(**options), **given)

        kinds = get_type_hints(function, include_extras=True)
        _, *named = signature(function).parameters.values()
        run.__signature__ = Signature(  # type: ignore[attr-defined]
            [
                Parameter(
                    key,
                    Parameter.KEYWORD_ONLY,
                    annotation=instead.get(key, kind),
                    default=default,
                )
                for key, (kind, default) in COMMON.items()
                if key in taken
            ]
            + [
                p.replace(annotation=kinds[p.name], kind=Parameter.KEYWORD_ONLY)
                for p in named
                if p.kind is not Parameter.VAR_KEYWORD
            ]
            + [*own]
        )
        app.command(name, help=help or function.__doc__)(run)
        return function

    return decorate
