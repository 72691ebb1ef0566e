"""The command line: what help says first, and errors as lines and exit codes."""

from __future__ import annotations

import re
import shlex
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sphrom.cli.cases import cases
from sphrom.cli.stage_commands import stages
from sphrom.console import LONGEST_LINE, tell
from sphrom.errors import SphromError
from sphrom.signals import Terminated, guarded, termination_interrupts
from sphrom.text import shortened
from sphrom.version import __version__

UsageError: Any = typer.BadParameter.__base__
"""What typer raises for arguments that it can't take; it exports only some kinds of it."""


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        with _visible_usage():
            if any(re.fullmatch("(--[a-z-]+=)?", given) for given in args):  # a path: this folder
                raise UsageError("an argument is empty; is a variable of the shell not set?")
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: Any) -> Any:
        try:
            with termination_interrupts(), guarded(computes=False), _visible_usage():
                return super().invoke(ctx)
        except SphromError as error:
            for line in str(error).split("\n"):
                tell(f"error: {line}", error=True)
            raise typer.Exit(error.exit_code) from None
        except KeyboardInterrupt as interrupt:
            terminated = isinstance(interrupt, Terminated)
            stopped = "terminated" if terminated else "interrupted"
            tell(f"{stopped}{_way_on(str(ctx.invoked_subcommand))}", error=True)
            raise typer.Exit(128 + (signal.SIGTERM if terminated else signal.SIGINT)) from None


def _way_on(command: str) -> str:
    """Return what is kept of a command that was stopped, and how to go on."""
    words, kept, does = ["sphrom", *sys.argv[1:]], "complete files are kept", "starts again"
    if command == "case":
        return ""
    if command in ("trade", "train", "sweep"):  # which start anew if they are forced to
        words = [word for word in words if word != "--force"]
        kept, does = "finished runs are kept", "goes on"
    elif command in ("fom", "rom", "run"):
        words += ["--resume"] * ("--resume" not in words)
        kept, does = "finished artifacts and checkpoints are kept", "goes on from them"
    elif command == "export":
        words += ["--force"] * ("--force" not in words)
    return f"; {kept}: `{shlex.join(words)}` {does}"


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Make visible, and short, what typer's messages about usage repeat of the arguments."""
    try:
        yield
    except UsageError as error:
        error.message = shortened(error.message, LONGEST_LINE, keep="\n")
        raise


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        tell(f"sphrom {__version__}")
        raise typer.Exit()


@app.callback()
def sphrom(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Turn a smoothed-particle-hydrodynamics simulation into a reduced model.

    The stages in their order: fom, map, pod, fit-psi, operators, rom, compare; run does all of
    them. Each reads artifacts (HDF5) from runs/<name of the case> in the current folder, or from
    the folder that --out names, and writes its own there. The command trade weighs the speed of
    models against their accuracy, sweep runs one model at thousands of parameter values, fit finds
    parameters from measurements, and train chooses the full runs that a model is trained on.

    \b
    Example, from a case file to a comparison:
      sphrom case new taylor-green -o vortex.yaml
      sphrom case check vortex.yaml
      sphrom run vortex.yaml

    Exit codes: 0 done, 2 wrong usage or invalid case, 3 an artifact is missing or damaged,
    4 a run became unstable, 5 it would not fit this machine, 130 interrupted, 143 terminated.
    """


app.add_typer(cases, name="case")
app.add_typer(stages)
