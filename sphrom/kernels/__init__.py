"""Compiled loops. This module contains only the settings that are needed before they are imported.

Importing the loops takes longer than many commands that run none of them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

# Waiting threads yield: on shared cores, spinning threads would block those they wait for.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

SUPPORT_RATIO = 2.0
"""Support radius of the smoothing kernel relative to its smoothing length (kappa)."""

when_compiling: list[Callable[[], object]] = []
"""Called when this process first has to compile a kernel that can be stored."""
_asked: int | None = None


def ask_for_threads(count: int | None) -> None:
    """Set the number of threads of kernels, now or once they are imported; None is all cores."""
    global _asked
    _asked = count
    loaded = sys.modules.get("sphrom.kernels.jit")
    if loaded is not None:
        loaded.set_threads(count)


def asked_for() -> int | None:
    """Return the requested number of threads; None is all cores."""
    return _asked
