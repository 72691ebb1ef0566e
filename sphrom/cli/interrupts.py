"""Interrupts from the keyboard, and SIGTERM, as exceptions: what is half done is then cleaned up.

One that arrives where Python can't raise it comes again, a moment later.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

MOMENT = 0.01
"""Seconds after which it comes again."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, by which batch systems, and other programs, end this one."""


def interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that caused an error, such as one within a call of C code.

    Where compiled code is loaded an interrupt may show as a SystemError: the call has returned a
    result although an exception was set.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return error
        error = error.__cause__ or error.__context__
    return None


@contextmanager
def interrupts_come_again() -> Iterator[None]:
    """Within the block, no interrupt is lost.

    Python prints an exception in a destructor or a weak reference's callback, of which each access
    to an HDF5 file has some, and goes on: a run would not notice that it was interrupted.
    """
    before = sys.unraisablehook
    in_main = threading.current_thread() is threading.main_thread()
    # What the program was started with stays where it is not the default, as below `nohup`.
    terminates = in_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL

    def hook(lost: Any) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = signal.SIGTERM if issubclass(lost.exc_type, Terminated) else signal.SIGINT
            threading.Timer(MOMENT, _thread.interrupt_main, (again,)).start()
        else:
            before(lost)

    sys.unraisablehook = hook
    if terminates:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        sys.unraisablehook = before
        if terminates:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
