"""Errors as lines that a user can act on, and as exit codes."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import typer
from typer.core import TyperGroup

from sphrom.cli.interrupts import (
    exit_of,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)
from sphrom.console import tell
from sphrom.errors import SphromError, machine_error
from sphrom.text import shortened

UsageError: Any = typer.BadParameter.__base__
"""What typer raises for arguments that it can't take; it exports only some kinds of it."""


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **kw: Any) -> Any:
        with _visible_usage():
            for before, given in pairwise(["", *args]):
                # An empty path would be the working directory.
                if not given or re.fullmatch(r"--[\w-]+=", given):
                    option = given or (before if before.startswith("-") else "an argument")
                    raise typer.BadParameter(f"{option.removesuffix('=')} is empty: give a value")
            return super().make_context(info_name, args, *rest, **kw)

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


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Make visible what typer's messages about usage repeat of the arguments."""
    try:
        yield
    except UsageError as error:
        lines = error.message.split("\n")
        error.message = "\n".join(shortened(line) for line in lines)
        raise


def _fail(error: SphromError) -> None:
    for line in str(error).split("\n"):
        tell(f"error: {line}", error=True)
    raise typer.Exit(error.exit_code)
