"""An interrupt that arrives where Python can't raise it comes again, a moment later."""

from __future__ import annotations

import _thread
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MOMENT = 0.01
"""Seconds after which it comes again."""


def comes_from_interrupt(error: BaseException | None) -> bool:
    """Return whether an error was caused by an interrupt, such as one within a call of C code.

    Where compiled code is loaded an interrupt may show as a SystemError: the call has returned a
    result although an exception was set.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


@contextmanager
def interrupts_come_again() -> Iterator[None]:
    """Within the block, no interrupt is lost.

    Python prints an exception in a destructor or a weak reference's callback, of which each access
    to an HDF5 file has some, and goes on: a run would not notice that it was interrupted.
    """
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if lost.exc_type is KeyboardInterrupt:
            threading.Timer(MOMENT, _thread.interrupt_main).start()
        else:
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
