"""Errors as lines that a user can act on, and as exit codes."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from sphrom.cli.console import tell
from sphrom.cli.interrupts import (
    exit_of,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)
from sphrom.errors import ArtifactError, ResourceError, SphromError
from sphrom.text import visible

UsageError: Any = typer.BadParameter.__base__
"""What typer raises for arguments that it can't take; it exports only some kinds of it."""
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG}


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        with _visible_usage():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        try:
            with termination_interrupts(), interrupts_come_again(), _visible_usage():
                return super().invoke(ctx)
        except SphromError as error:
            _fail(error, str(error))
        except (KeyboardInterrupt, SystemError) as error:
            interrupt = interrupt_behind(error)
            if interrupt is None:
                raise
            code, word = exit_of(interrupt)
            tell(word, error=True)
            raise typer.Exit(code) from None
        except MemoryError:
            _fail(ResourceError(), "out of memory; `sphrom case check` tells what a case needs")
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise
            kind = ResourceError() if error.errno in _FULL else ArtifactError()
            _fail(kind, f"{error.filename or 'a file'}: {error.strerror or error}")


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Make visible what typer's messages about usage repeat of the arguments."""
    try:
        yield
    except UsageError as error:
        error.message = visible(error.message, keep="\n")
        raise


def _fail(error: SphromError, text: str) -> None:
    for line in text.split("\n"):
        tell(f"error: {line}", error=True)
    raise typer.Exit(error.exit_code)
