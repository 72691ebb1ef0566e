"""Compilation of kernels.

Every loop over particles is `parallel`: it is compiled once, with threads, and each particle has
its own sums, so results are bitwise the same with any number of threads. The compiled code is
stored in a folder named after a hash of all kernel sources, because the compiler's own cache does
not notice a change of a function that is called from another file.

The process that compiles a kernel and those that load it use the same machine code, and so does a
process that cannot store it. The compiler alone does not ensure that: the stored code of a function
contains copies of all functions it calls, optimised once more, under names that are overridden by
functions already loaded. Sums would then depend on the order of compilation and loading. Here the
copies belong to the function that they were made for (`_OwnCopies`).
"""

from __future__ import annotations

import hashlib
import pickle
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite.binding import Linkage
from numba.core import event
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import CompileResult
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.extending import overload

from sphrom.kernels import asked_for, when_compiling
from sphrom.kernels.code_cache import CodeCache, CompilingWarning, find_cache
from sphrom.machine import compiling

Function = TypeVar("Function", bound=Callable[..., object])

# Contraction and reassociation let loops vectorise; NaN and infinities keep their meaning.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}
# No function is called through a C pointer, and the code for such calls takes time to compile.
SETTINGS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
LIBRARIES = ("numba", "llvmlite", "numpy")
"""Libraries on which compiled code depends."""


def term(function: Function) -> Function:
    """Compile a small function that is called from loops."""
    return _kept(numba.njit(fastmath=FAST_MATH, **SETTINGS)(function))


def inlined(function: Function) -> Function:
    """Compile a function by copying it into its callers, as if it were written there.

    Its products are then ordered together with theirs. It may take functions and return views.
    """
    compiled: Function = numba.njit(fastmath=FAST_MATH, inline="always", **SETTINGS)(function)
    return compiled


def like(number: float, other: float) -> float:
    """Return a number in the precision of another one."""
    return type(other)(number)


@overload(like)
def _compiled_like(number: Any, other: Any) -> Any:
    """Return the implementation of `like` for numbers of two types."""
    precision = np.float32 if other == numba.float32 else np.float64

    def convert(number: Any, other: Any) -> Any:
        return precision(number)

    return convert


def parallel(function: Function) -> Function:
    """Compile a loop over particles; its `numba.prange` is divided among threads."""
    return _kept(numba.njit(fastmath=FAST_MATH, parallel=True, **SETTINGS)(function))


def serial(function: Function) -> Function:
    """Compile a loop for one thread, with the order and the arithmetic of its source."""
    return _kept(numba.njit(**SETTINGS)(function))


def set_threads(count: int | None) -> int:
    """Use `count` threads (all cores by default) and return the number in use."""
    used = threads_for(count)
    numba.set_num_threads(used)
    return used


def threads_for(count: int | None) -> int:
    """Return the available number of threads if `count` are requested; None is all cores."""
    available: int = numba.config.NUMBA_NUM_THREADS
    return available if count is None else max(1, min(count, available))


def source_hash() -> str:
    """Return a hash of every kernel source and of the compiler."""
    digest = hashlib.sha256(sys.version.encode())
    for library in LIBRARIES:
        digest.update(f"{library} {version(library)}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def compiled_with() -> dict[str, str]:
    """Return the dependencies of compiled code other than its sources, by name."""
    _, processor, features = cpu_target.target_context.codegen().magic_tuple()
    marked = hashlib.sha256(features.encode()).hexdigest()[:8]
    versions = {library: version(library) for library in LIBRARIES}
    return {**versions, "processor": f"{processor} with features {marked}"}


class _OwnCopies(JITCodeLibrary):
    """Compiled code that calls its own copies of the functions that are linked into it."""

    def _optimize_final_module(self) -> None:
        super()._optimize_final_module()
        linked = {
            function.name
            for library in self._linking_libraries
            for function in library._get_module_for_linking().functions
        }
        for function in self._final_module.functions:
            if function.name in linked and not function.is_declaration:
                function.linkage = Linkage.internal


JITCPUCodegen._library_class = _OwnCopies


@lru_cache(maxsize=1)
def code_cache() -> CodeCache:
    """Return the cache of compiled code; warn once if it is not writable."""
    return find_cache(source_hash())


class _KeptCode(NullCache):
    """The machine code of one function, for each kind of arguments and processor."""

    def __init__(self, compiled: Any) -> None:
        function = compiled.py_func
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._waiting = {"dispatcher": compiled}

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the code compiled for a signature, or None if it must be compiled."""
        # Loaded code needs only the memory management of arrays. The whole target, for example the
        # compilation rules of all numpy functions, takes longer to load than many commands take.
        rtsys.initialize(target_context)
        file = self._file(signature, target_context.codegen())
        content = code_cache().read(file)
        if content is None:
            _tell_of_compiling()
            # To wait for another process that compiles it is told, and timed, like compiling it.
            with event.trigger_event("numba:compile", data=self._waiting):
                code_cache().claim(file)
            content = code_cache().read(file)  # another process may have stored it meanwhile
            if content is None:
                return None
            code_cache().release(file)
        return CompileResult._rebuild(target_context, *pickle.loads(content))

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store the code compiled for a signature.

        A signal that arrives while LLVM returns the object code only prevents the storing.
        """
        file = self._file(signature, compiled.codegen)
        with suppress(RuntimeError):
            code_cache().write(file, dumps(compiled._reduce()))
        code_cache().release(file)

    def _file(self, signature: Any, codegen: Any) -> str:
        made_for = hashlib.sha256(repr((signature, codegen.magic_tuple())).encode())
        return f"{self._name}-{made_for.hexdigest()[:16]}.nbc"


@lru_cache(maxsize=1)
def _tell_of_compiling() -> None:
    if code_cache().writable:
        for call in when_compiling:
            call()
        text = "compiling kernels, once on this machine: each takes some seconds, and is kept"
        warnings.warn(text, CompilingWarning, stacklevel=1)


def _kept(compiled: Any) -> Any:
    """Cache the code of a kernel; functions from elsewhere are not stored in this folder."""
    of_kernels = isinstance(compiled, CPUDispatcher) and (
        Path(compiled.py_func.__code__.co_filename).parent == Path(__file__).parent
    )
    if of_kernels:
        compiled._cache = _KeptCode(compiled)
    return compiled


class _Compiling(event.Listener):
    """Counts the time spent on compiling functions, including the functions that they call."""

    depth = 0

    def on_start(self, event: Any) -> None:
        """Start the clock at the outermost function."""
        compiling[0] -= (self.depth == 0) * time.process_time()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        """Stop the clock at the outermost function."""
        self.depth -= 1
        compiling[0] += (self.depth == 0) * time.process_time()


event.register("numba:compile", _Compiling())
set_threads(asked_for())
