"""How kernels are compiled.

Every loop over particles is `parallel`: it is compiled once, with threads, and each particle owns
its sums, so that results are bitwise the same on any number of threads. The compiled code is kept
in a folder named after a hash of all kernel sources, because the compiler's own cache does not
notice when a function that is called from another file changes.

The process that compiles a kernel and those that load it compute with the same machine code, and
so does a process that can't keep it. The compiler alone does not see to that: what it stores of a
function holds copies of all that it calls, optimised once more, under names that give way to what
is loaded already. Sums would then depend on what was compiled or loaded before. Here the copies
belong to the function that they were made for (`_OwnCopies`).
"""

from __future__ import annotations

import hashlib
import pickle
import sys
import time
import warnings
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numba
from llvmlite.binding import Linkage
from numba.core import event
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import CompileResult
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from sphrom.kernels import asked_for
from sphrom.kernels.code_cache import CodeCache, CompilingWarning, find_cache
from sphrom.machine import compiling

Function = TypeVar("Function", bound=Callable[..., object])

# Contraction and reassociation let loops vectorise; NaN and infinities keep their meaning.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}
LIBRARIES = ("numba", "llvmlite", "numpy")
"""Those that compiled code depends on."""


def term(function: Function) -> Function:
    """Compile a small function that is called from loops."""
    return _kept(numba.njit(fastmath=FAST_MATH, error_model="numpy", nogil=True)(function))


def parallel(function: Function) -> Function:
    """Compile a loop over particles, its `numba.prange` shared out over threads."""
    return _kept(
        numba.njit(fastmath=FAST_MATH, error_model="numpy", nogil=True, parallel=True)(function)
    )


def serial(function: Function) -> Function:
    """Compile a loop for one thread, in the order and the arithmetic that it is written in."""
    return _kept(numba.njit(error_model="numpy", nogil=True)(function))


def set_threads(count: int | None) -> int:
    """Use `count` threads (all cores by default) and return how many are used."""
    used = threads_for(count)
    numba.set_num_threads(used)
    return used


def threads_for(count: int | None) -> int:
    """Return how many threads there can be where `count` are asked for; None is all cores."""
    available: int = numba.config.NUMBA_NUM_THREADS
    return available if count is None else max(1, min(count, available))


def source_hash() -> str:
    """Return a hash of every kernel source and of what compiles it."""
    digest = hashlib.sha256(sys.version.encode())
    for library in LIBRARIES:
        digest.update(f"{library} {version(library)}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def compiled_with() -> dict[str, str]:
    """Return what compiled code depends on besides its sources, by name."""
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
    """Return where code is kept; warns, once, where it can't be."""
    return find_cache(source_hash())


class _KeptCode(NullCache):
    """The machine code of one function, for each kind of arguments and processor."""

    def __init__(self, function: Callable[..., object]) -> None:
        self._name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return what was compiled for a signature, None where it has to be compiled."""
        # The memory of arrays is all that loaded code needs. What a whole target knows, such as how
        # to compile each of numpy's functions, takes longer to load than many a command does.
        rtsys.initialize(target_context)
        content = code_cache().read(self._file(signature, target_context.codegen()))
        if content is None:
            _tell_of_compiling()
            return None
        return CompileResult._rebuild(target_context, *pickle.loads(content))

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled for a signature.

        A signal that arrives while LLVM hands the object code over costs the copy, not the code.
        """
        try:
            content = dumps(compiled._reduce())
        except RuntimeError:
            return
        code_cache().write(self._file(signature, compiled.codegen), content)

    def _file(self, signature: Any, codegen: Any) -> str:
        made_for = hashlib.sha256(repr((signature, codegen.magic_tuple())).encode())
        return f"{self._name}-{made_for.hexdigest()[:16]}.nbc"


@lru_cache(maxsize=1)
def _tell_of_compiling() -> None:
    if code_cache().writable:
        text = "compiling kernels, once on this machine: each takes some seconds, and is kept"
        warnings.warn(text, CompilingWarning, stacklevel=1)


def _kept(compiled: Any) -> Any:
    """Keep the code of a kernel; a function from elsewhere has no place in this folder."""
    of_kernels = isinstance(compiled, CPUDispatcher) and (
        Path(compiled.py_func.__code__.co_filename).parent == Path(__file__).parent
    )
    if of_kernels:
        compiled._cache = _KeptCode(compiled.py_func)
    return compiled


class _Compiling(event.Listener):
    """Counts the time of compiling functions, those that they call among them."""

    depth = 0

    def on_start(self, event: Any) -> None:
        """Start the clock with the outermost function."""
        compiling[0] -= (self.depth == 0) * time.process_time()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        """Stop it with the same."""
        self.depth -= 1
        compiling[0] += (self.depth == 0) * time.process_time()


event.register("numba:compile", _Compiling())
set_threads(asked_for())
