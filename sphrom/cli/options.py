"""Options that commands share, and the functions that declare a command and run its stage."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from sphrom import stages
from sphrom.console import LOG, LogFile, Reporter

WITHOUT_LOG = ("check", "draw")
"""Stages that write no log beside the artifacts."""


# Shell completion is silent about errors: a message would disturb the line that the user types.
def complete_kinds(incomplete: str) -> list[str]:
    """Return the kinds of scene that begin with a text."""
    from sphrom.case.scenes import DEFAULTS

    return [kind for kind in DEFAULTS if kind.startswith(incomplete)]


def complete_keys(incomplete: str) -> list[str]:
    """Return the keys of a case with fixed names that begin with a text."""
    from sphrom.case.schema import is_section, key_paths, node_at

    paths = (path for path in key_paths() if not is_section(node_at(path) or {}))
    names = (".".join(map(str, path)) + "=" for path in paths)
    return [name for name in names if name.startswith(incomplete)]


def complete_values(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the parameter values and models of the case on the command line, for --only."""
    from sphrom.case.loader import load_case
    from sphrom.errors import SphromError

    # typer has not parsed the arguments yet if the line ends within an option.
    named = ctx.params.get("case") or next(iter(ctx.args), None)
    try:
        case = load_case(named or "")
    except SphromError:
        return []
    labels = [point.label.replace(", ", ",") for point in case.plan.points]
    labels += [model.name for model in case.rom]
    return [label for label in labels if label.startswith(incomplete)]


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """Return an option; `metavar` stands for its value in the help, `names` replace its own."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def argument(metavar: str, text: str, **more: Any) -> Any:
    """Return an argument; `metavar` stands for its value in the help."""
    return typer.Argument(metavar=metavar, help=text, show_default=False, **more)


class Command(TyperCommand):
    """A command whose summary is not cut in the list of commands."""

    def get_short_help_str(self, limit: int = 0) -> str:
        return super().get_short_help_str(sys.maxsize)


@dataclass(frozen=True)
class Options:
    """The options that commands share, each with its help."""

    case: Annotated[Path, argument("CASE", "The case file (YAML).")]
    out: Annotated[
        Path | None,
        option("DIR", "Folder of the artifacts.  [default: runs/CASE in the current folder]"),
    ] = None
    overrides: Annotated[
        list[str] | None,
        option(
            "KEY=VALUE",
            "Change a key of the case, such as time.step=1e-3.",
            "--set",
            autocompletion=complete_keys,
        ),
    ] = None
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite files; accept a time step above its limit.")
    ] = False
    threads: Annotated[int | None, option("N", "Threads to use.  [default: all cores]", min=1)] = (
        None
    )
    quiet: Annotated[bool, typer.Option("--quiet", help="Show warnings and results only.")] = False
    verbose: Annotated[bool, typer.Option("--verbose", help="Show details and all tables.")] = False
    only: Annotated[
        list[str] | None,
        option(
            "NAME=VALUE[,...]",
            "Run these parameter values only; for rom and export also a MODEL. May be repeated.",
            autocompletion=complete_values,
        ),
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue stopped runs from their checkpoints.")
    ] = False
    checkpoint_every: Annotated[
        float,
        option(
            "SECONDS", "Shortest time between checkpoints; 0 writes one after every step.", min=0.0
        ),
    ] = 60.0
    workers: Annotated[
        int | None,
        option(
            "N",
            "Number of parallel processes.  [default: one; for sweep and train, one per core]",
            min=1,
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        option("ADDRESS", "Run on the workers of this Dask scheduler, such as tcp://node1:8786."),
    ] = None

    @property
    def words(self) -> str:
        """The arguments that make another command use the same artifacts."""
        changes = [word for text in self.overrides or () for word in ("--set", text)]
        out = [] if self.out is None else ["--out", str(self.out)]
        return shlex.join([str(self.case), *changes, *out])


ALL = tuple(signature(Options).parameters)
"""The options of stages with long runs, which may be stopped and resumed."""
BY_POINT = ALL[: ALL.index("resume")]
"""The options of stages that may run at selected parameter values."""
WHOLE = ALL[: ALL.index("only")]
"""The options of stages that always process the whole case."""
SHARED_OUT = ("workers", "scheduler")
"""The options of stages whose runs several processes may make."""
WITHOUT_THREADS = tuple(name for name in WHOLE if name != "threads")
"""The options of stages whose workers have one thread each."""


def parameters_of(function: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the parameters of a function or dataclass with their annotations for typer."""
    kinds = get_type_hints(function, include_extras=True)
    return {
        name: parameter.replace(annotation=kinds[name], kind=Parameter.KEYWORD_ONLY)
        for name, parameter in signature(function).parameters.items()
        if name in kinds
    }


def command(
    app: typer.Typer,
    name: str,
    taken: Sequence[str] = WHOLE,
    more: Iterable[Parameter] = (),
    does: Callable[..., None] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds a function as a command; its docstring is the help.

    The function takes the shared options as one `Options`, and the command's own as parameters.

    Parameters
    ----------
    taken : names of the fields of Options that the command has.
    more : further options, which the function takes as keywords.
    does : function to call instead of the decorated one.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def run(**values: Any) -> None:
            (does or function)(Options(**{name: values.pop(name) for name in taken}), **values)

        common = parameters_of(Options)
        named = parameters_of(function)
        others = [p for n, p in named.items() if n not in ("options", "fields")]
        run.__signature__ = Signature(  # type: ignore[attr-defined]
            [*(common[name] for name in ALL if name in taken), *others, *more]
        )
        app.command(name, cls=Command, help=function.__doc__)(run)
        return function

    return decorate


def stage_command(
    app: typer.Typer, name: str, taken: Sequence[str] = WHOLE
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds a command which runs a stage.

    The decorated function has no body. Its parameters are the command's own options, which the
    stage gets, and its docstring is the help.
    """
    return command(app, name, taken, does=partial(run_stage, name))


def run_stage(stage: str, options: Options, **asked: object) -> Any:
    """Load the case, run one stage on it, and return the stage's result.

    `asked` are the command's own options. Raises SphromError; each kind has its exit code.
    """
    from sphrom.case.loader import load_case

    case = load_case(options.case, options.overrides or (), options.force)
    log = LogFile(None if stage in WITHOUT_LOG else stages.folder_of(case, options.out) / LOG)
    report = Reporter(quiet=options.quiet, verbose=options.verbose, log=log)
    with log.recorded(["sphrom", *sys.argv[1:]]):
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            report.info("SIGINT is ignored here: stop this command with SIGTERM (`kill PID`)")
        context = stages.context_of(case, report, options.out, options.force, options.threads)
        resume = options.resume
        every = options.checkpoint_every
        context = stages.with_checkpoints(context, resume=resume, every=every)
        context = stages.with_workers(context, options.workers, options.scheduler)
        context = replace(context, words=options.words)
        context = stages.selected(context, stage, options.only or ())
        if stage == "run":
            return stages.run_all(context)
        return stages.run_stage(stage, context, **asked)
