"""Errors and interrupts as lines that a user can act on, and as exit codes."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from sphrom.console import LONGEST_LINE, tell
from sphrom.errors import SphromError
from sphrom.signals import Terminated, guarded, termination_interrupts
from sphrom.text import shortened

UsageError: Any = typer.BadParameter.__base__
"""What typer raises for arguments that it can't take; it exports only some kinds of it."""


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        with _visible_usage():
            for before, given in zip(["", *args], args, strict=False):
                _refuse_empty(before, given)
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
            tell("terminated" if terminated else "interrupted", error=True)
            raise typer.Exit(128 + (signal.SIGTERM if terminated else signal.SIGINT)) from None


def _refuse_empty(before: str, given: str) -> None:
    """Refuse an argument that is empty: as a path it would be the current folder."""
    if given.startswith("--") and given.endswith("=") and given.count("=") == 1:
        before, given = given[:-1], ""
    if not given:
        where = f"what follows {before}" if before.startswith("-") else "an argument"
        raise UsageError(f"{where} is empty; is a variable of the shell not set?")


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Make visible, and short, what typer's messages about usage repeat of the arguments."""
    try:
        yield
    except UsageError as error:
        error.message = shortened(error.message, LONGEST_LINE, keep="\n")
        raise


def ignored_interrupts() -> str | None:
    """Return what to do where SIGINT is ignored, which whoever started the command arranged."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        return None
    return (
        "SIGINT is ignored, as in background jobs of a script: stop this command with SIGTERM "
        "(`kill PID`), which also leaves a checkpoint"
    )
