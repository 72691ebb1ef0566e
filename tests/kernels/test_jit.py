"""How kernels are compiled: where they are kept, on how many threads they run."""

from __future__ import annotations

import errno
import math
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest

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


@pytest.mark.parametrize(("asked", "least"), [(1, 1), (0, 1), (-3, 1), (10**6, 1), (None, 1)])
def test_threads_are_as_many_as_there_can_be(asked: int | None, least: int) -> None:
    used = jit.set_threads(asked)
    assert least <= used <= numba.config.NUMBA_NUM_THREADS
    assert used == numba.get_num_threads()
    if asked is None or asked > 10**3:
        assert used == numba.config.NUMBA_NUM_THREADS


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
    """A folder of its own for compiled kernels, and an empty one for temporary files."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    for variable in code_cache.VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("SPHROM_CACHE", str(tmp_path / "cache"))
    jit.code_cache.cache_clear()
    yield tmp_path / "cache" / "sphrom" / jit.source_hash()
    jit.code_cache.cache_clear()


def rows_within_reach() -> tuple[int, int]:
    """Call a kernel that this process has neither compiled nor loaded."""
    again = jit.term(cells.rows_within.py_func)
    return again(0.31, 0.52, 0.1, cells.Grid(0.0, 0.0, 0.1, 0.1, 10, 10))


def emptied(content: bytes) -> bytes:
    return b""


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flipped(content: bytes) -> bytes:
    changed = bytearray(content)
    for at in range(0, len(changed), 97):
        changed[at] ^= 0x10
    return bytes(changed)


@pytest.mark.parametrize("damage", [emptied, cut, flipped])
def test_a_damaged_file_is_compiled_again(cache: Path, damage) -> None:
    expected = rows_within_reach()
    (kept,) = cache.iterdir()
    kept.write_bytes(damage(kept.read_bytes()))
    assert rows_within_reach() == expected == (2, 7)
    (again,) = cache.iterdir()
    assert again == kept
    assert code_cache.CodeCache((cache,)).read(again.name) is not None
    changed = kept.stat().st_mtime_ns
    assert rows_within_reach() == expected
    assert kept.stat().st_mtime_ns == changed  # loaded


def test_no_flipped_bit_is_run(tmp_path: Path) -> None:
    cache = code_cache.CodeCache((tmp_path,))
    assert cache.write("kernel", b"code") is None
    whole = (tmp_path / "kernel").read_bytes()
    assert cache.read("kernel") == b"code"
    for at in range(len(whole)):
        for bit in range(8):
            changed = bytearray(whole)
            changed[at] ^= 1 << bit
            (tmp_path / "kernel").write_bytes(changed)
            assert cache.read("kernel") is None
    for end in range(len(whole)):
        (tmp_path / "kernel").write_bytes(whole[:end])
        assert cache.read("kernel") is None


def no_home() -> Path:
    raise RuntimeError("Could not determine home directory.")


@pytest.mark.parametrize("place", ["a file", "no home"])
def test_a_folder_that_cannot_be_written_gives_way(
    cache: Path, tmp_path: Path, monkeypatch, place: str
) -> None:
    if place == "a file":
        (tmp_path / "cache").write_text("in the way")
    else:
        monkeypatch.delenv("SPHROM_CACHE")
        monkeypatch.setattr(Path, "home", no_home)
    temporary = tmp_path / "temporary" / f"sphrom-{os.getuid()}"
    with pytest.warns(code_cache.CodeCacheWarning, match=f"they are kept in {temporary}; "):
        assert rows_within_reach() == (2, 7)
    assert list(temporary.rglob("*.nbc"))
    assert stat.S_IMODE(temporary.stat().st_mode) == 0o700


def test_nothing_is_loaded_that_somebody_else_may_have_put_there(
    cache: Path, tmp_path: Path
) -> None:
    (tmp_path / "cache").write_text("in the way")
    temporary = tmp_path / "temporary" / f"sphrom-{os.getuid()}"
    temporary.mkdir()
    temporary.chmod(0o777)
    with pytest.warns(code_cache.CodeCacheWarning, match="every command compiles them anew"):
        assert rows_within_reach() == (2, 7)
    assert not list(temporary.iterdir())


def test_a_full_disk_is_told_of(cache: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(code_cache, "_write_whole", full)
    with pytest.warns(code_cache.CodeCacheWarning, match="No space left on device"):
        assert rows_within_reach() == (2, 7)


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


def printed(code: str, **variables: str) -> str:
    """Return what a process prints that runs some code."""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **variables},
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return done.stdout


def test_what_is_kept_is_loaded_without_the_compiler(tmp_path: Path) -> None:
    code = (
        "import sys; from sphrom.kernels.cells import Grid, rows_within; "
        "rows = rows_within(0.31, 0.52, 0.1, Grid(0.0, 0.0, 0.1, 0.1, 10, 10)); "
        "print(*rows, 'numba.np.arraymath' in sys.modules)"
    )
    for compiles in (True, False):
        assert printed(code, SPHROM_CACHE=str(tmp_path)) == f"2 7 {compiles}\n"


def test_threads_may_be_asked_for_before_kernels_are_loaded() -> None:
    code = (
        "from sphrom.kernels.threads import ask_for_threads; ask_for_threads(1); "
        "from sphrom.kernels import jit; import numba; before = numba.get_num_threads(); "
        "ask_for_threads(2); print(before, numba.get_num_threads())"
    )
    assert printed(code, NUMBA_NUM_THREADS="3") == "1 2\n"
