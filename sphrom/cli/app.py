"""The command line: the first help text, and the exit codes of errors."""

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
"""The base class of typer's errors for invalid arguments, which typer does not export."""


class Commands(TyperGroup):
    """Prints errors that a user can act on without a traceback, and sets the exit code."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        with _visible_usage():
            # An empty path would mean the current folder.
            if any(re.fullmatch("(--[a-z-]+=)?", argument) for argument in args):
                raise UsageError("an argument is empty; is a variable of the shell not set?")
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: Any) -> Any:
        try:
            with termination_interrupts(), guarded(computes=False), _visible_usage():
                return super().invoke(ctx)
        except SphromError as error:
            for line in str(error).split("\n"):
                tell(f"error: {line}", error=True, style="red")
            raise typer.Exit(error.exit_code) from None
        except KeyboardInterrupt as interrupt:
            terminated = isinstance(interrupt, Terminated)
            stopped = "terminated" if terminated else "interrupted"
            tell(f"{stopped}{_way_on(str(ctx.invoked_subcommand))}", error=True)
            raise typer.Exit(128 + (signal.SIGTERM if terminated else signal.SIGINT)) from None


def _way_on(command: str) -> str:
    """Return a message that says which files of a stopped command remain, and how to continue."""
    words, kept, does = ["sphrom", *sys.argv[1:]], "complete files are kept", "starts again"
    if command == "case":
        return ""
    if command in ("trade", "train", "sweep"):  # with --force they would start from the beginning
        words = [word for word in words if word != "--force"]
        kept, does = "finished runs are kept", "continues"
    elif command in ("fom", "rom", "run"):
        words += ["--resume"] * ("--resume" not in words)
        kept, does = "finished artifacts and checkpoints are kept", "continues from them"
    elif command == "export":
        words += ["--force"] * ("--force" not in words)
    return f"; {kept}: `{shlex.join(words)}` {does}"


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Escape and shorten the arguments that typer's messages about usage quote."""
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

    The stages, in order, are fom, map, pod, fit-psi, operators, rom and compare; `run` runs all of
    them. Each stage reads and writes HDF5 files, called artifacts, in the folder runs/CASE, or in
    the folder that --out names. `trade` weighs the speed of models against their accuracy. `sweep`
    runs one model at thousands of parameter values. `fit` estimates parameters from measurements.
    `train` chooses the full runs that a model is trained on.

    \b
    Example, from a case file to a comparison:
      sphrom case new taylor-green -o vortex.yaml
      sphrom case check vortex.yaml
      sphrom run vortex.yaml

    Exit codes: 0 done, 2 wrong usage or invalid case, 3 an artifact is missing or damaged,
    4 a run became unstable, 5 a run does not fit this machine, 130 interrupted, 143 terminated.
    """


app.add_typer(cases, name="case")
app.add_typer(stages)
