"""How kernels are compiled.

Every loop over particles is a `sweep`: it is compiled once, with threads, and each particle owns
its sums, so that results are bitwise the same on any number of threads. The compiled code is kept
in a folder named after a hash of all kernel sources, because the compiler's own cache does not
notice when a function that is called from another file changes.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

# Contraction and reassociation let loops vectorise; NaN and infinities keep their meaning.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}


def source_hash() -> str:
    """Return a hash of every kernel source and of the compiler's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    base = os.environ.get("SPHROM_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return Path(base or Path.home() / ".cache") / "sphrom" / source_hash()


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(_cache_folder())


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


def set_threads(count: int | None) -> int:
    """Use `count` threads (all cores by default) and return how many are used."""
    available = numba.config.NUMBA_NUM_THREADS
    used = available if count is None else max(1, min(count, available))
    numba.set_num_threads(used)
    return used
