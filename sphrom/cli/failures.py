"""Errors as lines that a user can act on, and as exit codes."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from sphrom.cli.interrupts import (
    exit_of,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)
from sphrom.console import LONGEST_LINE, tell
from sphrom.errors import SphromError, machine_error
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
            with termination_interrupts(), interrupts_come_again(), _visible_usage():
                return super().invoke(ctx)
        except SphromError as error:
            _fail(error)
        except (KeyboardInterrupt, SystemError) as error:
            interrupt = interrupt_behind(error)
            if interrupt is None:
                raise
            code, word = exit_of(interrupt)
            tell(word, error=True)
            raise typer.Exit(code) from None
        except (MemoryError, OSError) as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:
                raise
            _fail(machine_error(error))


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


def _fail(error: SphromError) -> None:
    for line in str(error).split("\n"):
        tell(f"error: {line}", error=True)
    raise typer.Exit(error.exit_code)
