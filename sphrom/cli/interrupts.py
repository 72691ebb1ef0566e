"""How a command ends that SIGINT or SIGTERM stops: in order, with a word and an exit code."""

from __future__ import annotations

import signal

from sphrom.signals import (
    Terminated,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)

__all__ = [
    "Terminated", "exit_of", "ignored_interrupts", "interrupt_behind", "interrupts_come_again",
    "termination_interrupts",
]  # fmt: skip


def ignored_interrupts() -> str | None:
    """Return what to do where SIGINT is ignored, which whoever started the command arranged."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        return None
    return (
        "SIGINT is ignored, as in background jobs of a script: stop this command with SIGTERM "
        "(`kill PID`), which also leaves a checkpoint"
    )


def exit_of(interrupt: KeyboardInterrupt) -> tuple[int, str]:
    """Return the exit code, as shells have it, and the word for what stopped a command."""
    if isinstance(interrupt, Terminated):
        return 128 + signal.SIGTERM, "terminated"
    return 128 + signal.SIGINT, "interrupted"
