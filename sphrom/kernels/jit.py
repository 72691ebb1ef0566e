"""How kernels are compiled.

Every loop over particles is a `sweep`: it is compiled once, with threads, and each particle owns
its sums, so that results are bitwise the same on any number of threads. The compiled code is kept
in a folder named after a hash of all kernel sources, because the compiler's own cache does not
notice when a function that is called from another file changes.

Code that this process has just compiled and the same code loaded from the folder can differ in the
last bits: sums may be reassociated, and what is stored was optimised once more. The run that
compiles a kernel therefore need not equal later ones bit for bit; those equal one another.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar


def source_hash() -> str:
    """Return a hash of every kernel source and of the compiler's version."""
    digest = hashlib.sha256(version("numba").encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    base = os.environ.get("SPHROM_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return Path(base or Path.home() / ".cache") / "sphrom" / source_hash()


# In the environment, because the compiler reads its settings again when any of them changes there.
if not os.environ.get("NUMBA_CACHE_DIR"):
    os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder())

import numba  # noqa: E402

# Where something else imported the compiler before, it has read its settings already.
numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]

Function = TypeVar("Function", bound=Callable[..., object])

# Contraction and reassociation let loops vectorise; NaN and infinities keep their meaning.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}


def term(function: Function) -> Function:
    """Compile a small function that is called from sweeps."""
    compiled: Function = numba.njit(
        cache=True, fastmath=FAST_MATH, error_model="numpy", nogil=True
    )(function)
    return compiled


def sweep(function: Function) -> Function:
    """Compile a loop over particles, its `numba.prange` shared out over threads."""
    return numba.njit(
        cache=True, fastmath=FAST_MATH, error_model="numpy", nogil=True, parallel=True
    )(function)


def serial(function: Function) -> Function:
    """Compile a loop for one thread, in the order and the arithmetic that it is written in."""
    compiled: Function = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    return compiled


def set_threads(count: int | None) -> int:
    """Use `count` threads (all cores by default) and return how many are used."""
    available = numba.config.NUMBA_NUM_THREADS
    used = available if count is None else max(1, min(count, available))
    numba.set_num_threads(used)
    return used
