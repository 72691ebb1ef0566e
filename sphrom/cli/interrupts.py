"""Signals that stop a command: SIGINT and SIGTERM end it in order, and none of them is lost.

An interrupt that arrives where Python can't raise it comes again, a moment later.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MOMENT = 0.01
"""Seconds after which it comes again."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which stops a command as an interrupt does."""


def exit_of(interrupt: KeyboardInterrupt) -> tuple[int, str]:
    """Return the exit code, as shells have it, and the word for what stopped a command."""
    if isinstance(interrupt, Terminated):
        return 128 + signal.SIGTERM, "terminated"
    return 128 + signal.SIGINT, "interrupted"


def interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that caused an error, such as one within a call of C code, or None.

    Where compiled code is loaded an interrupt may show as a SystemError: the call has returned a
    result although an exception was set.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return error
        error = error.__cause__ or error.__context__
    return None


@contextmanager
def termination_interrupts() -> Iterator[None]:
    """Within the block, SIGTERM raises Terminated."""

    def terminate(*_: object) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's business
        return
    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def interrupts_come_again() -> Iterator[None]:
    """Within the block, no interrupt is lost.

    Python prints an exception in a destructor or a weak reference's callback, of which each access
    to an HDF5 file has some, and goes on: a run would not notice that it was interrupted.
    """
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            number = signal.SIGTERM if lost.exc_type is Terminated else signal.SIGINT
            threading.Timer(MOMENT, _thread.interrupt_main, (number,)).start()
        else:
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
