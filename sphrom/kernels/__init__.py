"""Compiled loops; here stand what is known, and what can be said, before they are loaded.

Loading them takes longer than many a command that runs none of them.
"""

from __future__ import annotations

import os
import sys

# Threads that wait give way: where cores are shared, spinning ones keep out those they wait for.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

SUPPORT_RATIO = 2.0
"""Support radius of the smoothing kernel over its smoothing length (kappa)."""

_asked: int | None = None


def ask_for_threads(count: int | None) -> None:
    """Let kernels use `count` threads, all cores by default, now or once they are loaded."""
    global _asked
    _asked = count
    loaded = sys.modules.get("sphrom.kernels.jit")
    if loaded is not None:
        loaded.set_threads(count)


def asked_for() -> int | None:
    """Return how many threads were asked for; None is all cores."""
    return _asked
