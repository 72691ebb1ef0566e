"""Signals that stop a process in order: each one raises an exception, and none is lost.

Python prints exceptions that are raised in destructors and callbacks of weak references, and
continues. Each access to an HDF5 file runs some of these, so an interrupt could be lost there. A
signal that arrives in such code is sent again a moment later.
"""

from __future__ import annotations

import _thread
import errno
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from types import CodeType, FrameType
from typing import Any

from sphrom.errors import ArtifactError, ResourceError
from sphrom.machine import one_blas_thread

MOMENT = 0.01
"""Time after which a lost signal is sent again [s]."""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG}
"""Error numbers of a full disk or memory."""
_terminated: list[bool] = []
"""Not empty after a first SIGTERM, so that a second one does not disturb the clean-up.

A pool of processes sends one to all others as soon as the first has ended.
"""
Handler = Callable[[int, FrameType | None], Any]


class Terminated(KeyboardInterrupt):
    """SIGTERM, which stops a command like an interrupt."""


STOPPING: Mapping[type[BaseException], signal.Signals] = {
    KeyboardInterrupt: signal.SIGINT,
    Terminated: signal.SIGTERM,
}
"""The exceptions that stop a command, with their signals."""


@contextmanager
def termination_interrupts() -> Iterator[None]:
    """Within the block, SIGTERM raises Terminated."""

    def terminate(*_: object) -> None:
        if not _terminated:
            _terminated.append(True)
            raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return
    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        _terminated.clear()


def interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that caused an error, or None.

    An interrupt while compiled code is loaded may appear as a SystemError, because the call has
    returned a result although an exception was set.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return error
        error = error.__cause__ or error.__context__
    return None


@contextmanager
def guarded(*, computes: bool = True, solves: bool = True) -> Iterator[None]:
    """Within the block, lose no interrupt, raise errors of the project, and use one BLAS thread.

    The command line sets the number of threads before it starts. With more threads, the last bits
    of results would differ from its results. See `one_blas_thread` for `solves`.
    """
    try:
        with one_blas_thread(solves=solves) if computes else nullcontext(), interrupts_come_again():
            yield
    except SystemError as error:
        if (interrupt := interrupt_behind(error)) is not None:
            raise interrupt from None
        raise
    except BrokenPipeError:  # the reader of the output has closed it
        raise
    except MemoryError as error:
        raise ResourceError("out of memory; `sphrom case check` estimates the need") from error
    except OSError as error:
        kind = ResourceError if error.errno in FULL else ArtifactError
        raise kind(f"{error.filename or 'a file'}: {error.strerror or error}") from error


@contextmanager
def interrupts_come_again() -> Iterator[None]:
    """Within the block, no interrupt is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    lost: list[signal.Signals] = []  # may change at any time
    late: list[signal.Signals] = []
    ending: list[bool] = []
    hook_before = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        number = STOPPING.get(unraisable.exc_type)
        if number is None:
            hook_before(unraisable)
        else:
            send_again(number)

    def send_again(number: signal.Signals) -> None:
        lost.append(number)
        # Threads of `threading` hold a lock while they start, and a signal may arrive then.
        _thread.start_new_thread(send, (number,))

    def send(number: signal.Signals) -> None:
        time.sleep(MOMENT)
        _terminated.clear()
        _thread.interrupt_main(number)
        lost.pop()

    def guarded(handler: Handler) -> Handler:
        def handle(number: int, frame: FrameType | None) -> None:
            if ending:
                late.append(signal.Signals(number))
            elif _runs(hook.__code__, frame):
                send_again(signal.Signals(number))  # exceptions within the hook are lost as well
            else:
                handler(number, frame)

        return handle

    handlers = {number: signal.getsignal(number) for number in STOPPING.values()}
    try:
        for number, handler in handlers.items():
            if callable(handler):
                signal.signal(number, guarded(handler))
        sys.unraisablehook = hook
        yield
    finally:
        ending.append(True)  # atomic; from here on no interrupt disturbs the clean-up
        while lost:
            time.sleep(MOMENT)
        sys.unraisablehook = hook_before
        for number, handler in handlers.items():
            if callable(handler):
                signal.signal(number, handler)
    for missed in late[:1]:
        _thread.interrupt_main(missed)


def _runs(code: CodeType, frame: FrameType | None) -> bool:
    """Return whether a frame, or one of its callers, runs some code."""
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None
