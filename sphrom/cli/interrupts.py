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
