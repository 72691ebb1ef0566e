"""Signals that stop a process in order: they raise an exception, and none of them is lost.

Python prints an exception in a destructor or a weak reference's callback, of which each access to
an HDF5 file has some, and goes on: a run would not notice that it was stopped. A signal that
arrives there comes again, a moment later.
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
"""Seconds after which it comes again."""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG}
"""Errors of a machine that has no more room."""
Handler = Callable[[int, FrameType | None], Any]


class Terminated(KeyboardInterrupt):
    """SIGTERM, which stops a command as an interrupt does."""


STOPPING: Mapping[type[BaseException], signal.Signals] = {
    KeyboardInterrupt: signal.SIGINT,
    Terminated: signal.SIGTERM,
}
"""What is raised, and by which signal."""


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
def guarded(*, computes: bool = True) -> Iterator[None]:
    """Lose no interrupt, raise errors of the project, and compute on one BLAS thread.

    With more threads the last bits would differ from those of the command line, which sets their
    number before it starts.
    """
    try:
        with one_blas_thread() if computes else nullcontext(), interrupts_come_again():
            yield
    except SystemError as error:
        if (interrupt := interrupt_behind(error)) is not None:
            raise interrupt from None
        raise
    except BrokenPipeError:  # whoever reads the output has had enough
        raise
    except MemoryError as error:
        raise ResourceError("out of memory; `sphrom case check` tells what a case needs") from error
    except OSError as error:
        kind = ResourceError if error.errno in FULL else ArtifactError
        raise kind(f"{error.filename or 'a file'}: {error.strerror or error}") from error


@contextmanager
def interrupts_come_again() -> Iterator[None]:
    """Within the block, no interrupt is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    lost: list[signal.Signals] = []  # which may be changed at any time
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
        _thread.interrupt_main(number)
        lost.pop()

    def guarded(handler: Handler) -> Handler:
        def handle(number: int, frame: FrameType | None) -> None:
            if ending:
                late.append(signal.Signals(number))
            elif _runs(hook.__code__, frame):
                send_again(signal.Signals(number))  # what is raised within the hook is lost as well
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
        ending.append(True)  # in one step that nothing can interrupt: cleaning up is left alone
        while lost:
            time.sleep(MOMENT)
        sys.unraisablehook = hook_before
        for number, handler in handlers.items():
            if callable(handler):
                signal.signal(number, handler)
    for missed in late[:1]:
        _thread.interrupt_main(missed)


def _runs(code: CodeType, frame: FrameType | None) -> bool:
    """Return whether a frame, or one that it was called from, runs some code."""
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None
