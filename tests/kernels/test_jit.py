"""How kernels are compiled: where they are kept, on how many threads they run."""

from __future__ import annotations

import errno
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Never

import numba
import numpy as np
import pytest
from numba.core import event

from sphrom.kernels import cells, code_cache, jit


@pytest.fixture(autouse=True)
def threads_as_before() -> Iterator[None]:
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def test_the_cache_is_named_after_every_source(tmp_path: Path, monkeypatch) -> None:
    for source in Path(jit.__file__).parent.glob("*.py"):
        (tmp_path / source.name).write_bytes(source.read_bytes())
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "jit.py"))
    before = jit.source_hash()
    assert before == jit.source_hash()
    with (tmp_path / "wendland.py").open("a", encoding="utf-8") as file:
        file.write("# another\n")
    assert jit.source_hash() != before


@pytest.mark.parametrize("asked", [1, 0, -3, 10**6, None])
def test_threads_are_as_many_as_there_can_be(asked: int | None) -> None:
    most = numba.config.NUMBA_NUM_THREADS
    used = jit.set_threads(asked)
    assert used == numba.get_num_threads() == (most if asked in (None, 10**6) else 1)


def test_fast_arithmetic_keeps_nan_infinities_and_divisions_by_zero() -> None:
    @numba.njit(fastmath=jit.FAST_MATH, error_model="numpy")
    def total(values: np.ndarray) -> float:
        out = 0.0
        for k in range(values.size):
            out += 1.0 / values[k]
        return out

    assert math.isnan(total(np.array([1.0] * 40 + [math.nan])))
    assert total(np.array([1.0] * 40 + [0.0])) == math.inf


@pytest.fixture
def cache(tmp_path: Path, monkeypatch) -> Iterator[Path]:
    """A folder of its own for compiled kernels."""
    for variable in code_cache.VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("SPHROM_CACHE", str(tmp_path / "cache"))
    jit.code_cache.cache_clear()
    yield tmp_path / "cache" / "sphrom" / jit.source_hash()
    jit.code_cache.cache_clear()


def rows_within_reach() -> tuple[int, int]:
    """Call a kernel that this process has neither compiled nor loaded."""
    again = jit.term(cells.rows_within.py_func)
    return again(0.31, 0.52, cells.Search(0.0, 0.0, 0.1, 0.1, 10, 10, np.zeros(1, int), 0.1, 1.0))


def damaged(content: bytes) -> Iterator[bytes]:
    """Yield a file emptied, cut, and with one bit flipped at some places, its digest's included."""
    for end in (0, 16, 32, len(content) // 2, len(content) - 1):
        yield content[:end]
    for at in (0, 31, 32, len(content) // 3, len(content) - 1):
        yield content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]


def test_a_damaged_file_is_compiled_again(cache: Path) -> None:
    expected = rows_within_reach()
    (kept,) = cache.iterdir()
    whole = kept.read_bytes()
    for content in damaged(whole):
        kept.write_bytes(content)
        assert code_cache.CodeCache(cache).read(kept.name) is None
    assert rows_within_reach() == expected == (2, 7)
    assert list(cache.iterdir()) == [kept]
    assert code_cache.CodeCache(cache).read(kept.name) is not None
    changed = kept.stat().st_mtime_ns
    assert rows_within_reach() == expected
    assert kept.stat().st_mtime_ns == changed  # loaded


CLAIMING = (
    "import sys, time, pathlib; from sphrom.kernels.code_cache import CodeCache; "
    "CodeCache(pathlib.Path(sys.argv[1])).claim('some'); print(flush=True); time.sleep(60)"
)


def test_code_that_another_process_compiles_is_waited_for(tmp_path: Path, monkeypatch) -> None:
    found = code_cache.CodeCache(tmp_path / "cache")
    command = [sys.executable, "-c", CLAIMING, found.folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        started = time.monotonic()
        found.claim("another")
        with monkeypatch.context() as patch:
            patch.setattr(code_cache, "PATIENCE", 0.2)
            waited = time.monotonic()
            found.claim("some")
            assert time.monotonic() - waited >= 0.2
        other.kill()
        other.wait(30.0)
        found.claim("some")  # a claim ends with its process
    assert time.monotonic() - started < 50.0


def fails(error: Exception) -> Callable[..., Never]:
    def fail(*_: object) -> Never:
        raise error

    return fail


def test_nothing_is_waited_for_where_nothing_can_be_claimed(tmp_path: Path, monkeypatch) -> None:
    denied = PermissionError(errno.EACCES, "the file is another user's")
    monkeypatch.setattr(code_cache, "_lock_file", fails(denied))
    monkeypatch.setattr(code_cache.time, "sleep", fails(AssertionError("it waits")))
    code_cache.CodeCache(tmp_path).claim("some")


def test_a_wait_for_another_process_counts_as_compiling(cache: Path, monkeypatch) -> None:
    begun = []
    seen = []
    monkeypatch.setattr(code_cache.CodeCache, "claim", lambda *_: seen.append(begun[-1:]))

    class Listener(event.Listener):
        def on_start(self, event):
            begun.append(event.data["dispatcher"].py_func.__name__)

        def on_end(self, event):
            begun.pop()

    with event.install_listener("numba:compile", Listener()):
        rows_within_reach()
    assert seen == [["rows_within"]]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("file", "Not a directory"),
        ("home", "kept: Could not determine home"),
        ("disk", "No space left on device"),
    ],
)
def test_without_a_folder_that_can_be_written_code_is_not_kept(
    cache: Path, tmp_path: Path, monkeypatch, place: str, words: str
) -> None:
    if place == "file":
        (tmp_path / "cache").write_text("in the way")
    elif place == "home":
        monkeypatch.delenv("SPHROM_CACHE")
        error: Exception = RuntimeError("Could not determine home directory.")
        monkeypatch.setattr(Path, "home", fails(error))
    else:
        error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        monkeypatch.setattr(Path, "write_bytes", fails(error))
    with pytest.warns(code_cache.CodeCacheWarning, match=f"{words}.*; every command") as seen:
        assert rows_within_reach() == (2, 7)
    assert [each.category for each in seen].count(code_cache.CodeCacheWarning) == 1
    assert not list(tmp_path.rglob("*.nbc*"))


def test_code_whose_object_got_lost_is_used_and_not_kept(cache: Path, monkeypatch) -> None:
    """As when a signal arrives in LLVM's callback, which Python can only print."""

    def lost(library: object) -> None:
        raise RuntimeError(f"no compiled object yet for {library}")

    monkeypatch.setattr("numba.core.codegen.CPUCodeLibrary._get_compiled_object", lost)
    assert rows_within_reach() == (2, 7)
    assert not cache.exists() or not list(cache.iterdir())


def test_compiled_code_calls_its_own_copies_alone() -> None:
    """Otherwise what it computes depends on what was compiled or loaded before it."""

    @jit.term
    def total(values: np.ndarray) -> float:
        out = 0.0
        for k in range(values.size):
            for n in range(k):
                out += math.sqrt(values[k] + n) / (1.0 + values[n])
        return out

    @jit.parallel
    def totals(values: np.ndarray, out: np.ndarray) -> None:
        for i in numba.prange(out.size):
            out[i] = total(values[i]) + total(values[i - 1])

    totals(np.ones((2, 3)), np.empty(2))
    (compiled,) = totals.overloads.values()
    defined = [f for f in compiled.library._final_module.functions if not f.is_declaration]
    own = {compiled.fndesc.llvm_func_name, compiled.fndesc.llvm_cpython_wrapper_name}
    visible = {f.name for f in defined if f.linkage.name not in ("internal", "private")}
    assert visible - {compiled.fndesc.llvm_cfunc_wrapper_name} == own


def test_a_serial_loop_keeps_the_order_of_its_sums() -> None:
    @jit.serial
    def total(values: np.ndarray) -> float:
        out = 0.0
        for k in range(values.size):
            out += values[k]
        return out

    values = np.array([1e16, 1.0, -1e16, 1.0] * 50)
    assert total(values) == total.py_func(values)


def test_what_is_kept_is_loaded_without_the_compiler(tmp_path: Path, printed) -> None:
    code = (
        "import sys, numpy; from sphrom.kernels.cells import Search, rows_within; "
        "search = Search(0.0, 0.0, 0.1, 0.1, 10, 10, numpy.zeros(1, int), 0.1, 1.0); "
        "rows = rows_within(0.31, 0.52, search); "
        "print(*rows, 'numba.np.arraymath' in sys.modules)"
    )
    for compiles in (True, False):
        assert printed(code, SPHROM_CACHE=str(tmp_path)) == f"2 7 {compiles}\n"


def test_threads_may_be_asked_for_before_kernels_are_loaded(printed) -> None:
    code = (
        "from sphrom.kernels import ask_for_threads; ask_for_threads(1); "
        "from sphrom.kernels import jit; import numba; before = numba.get_num_threads(); "
        "ask_for_threads(2); print(before, numba.get_num_threads())"
    )
    assert printed(code, NUMBA_NUM_THREADS="3") == "1 2\n"
