"""What surrounds every call that computes: the command line's care, in a Python program."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from sphrom.errors import machine_error
from sphrom.machine import one_blas_thread
from sphrom.signals import interrupt_behind, interrupts_come_again


@contextmanager
def guarded(*, computes: bool = True) -> Iterator[None]:
    """Lose no interrupt, raise errors of the project, and compute on one BLAS thread.

    With more threads the last bits would differ from those of the command line.
    """
    try:
        with one_blas_thread() if computes else nullcontext(), interrupts_come_again():
            yield
    except SystemError as error:
        if (interrupt := interrupt_behind(error)) is not None:
            raise interrupt from None
        raise
    except (MemoryError, OSError) as error:
        raise machine_error(error) from error
