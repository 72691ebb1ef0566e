"""How many threads kernels are to compute on; it can be said before kernels are loaded.

Loading them takes longer than many a command that runs none of them.
"""

from __future__ import annotations

import sys

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
