"""How kernels are compiled: where they are kept, on how many threads they run."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest

from sphrom.kernels import jit


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


@pytest.mark.parametrize("first", ["", "import numba; "])
@pytest.mark.parametrize("given", ["", "elsewhere"])
def test_the_cache_stays_where_it_is_when_the_settings_are_read_again(
    tmp_path: Path, first: str, given: str
) -> None:
    """The compiler reads all of its settings again when one of its variables has changed."""
    code = (
        f"{first}from sphrom.kernels import jit; import numba; print(numba.config.CACHE_DIR); "
        "numba.config.reload_config(); print(numba.config.CACHE_DIR, jit.source_hash(), sep='\\n')"
    )
    settings = os.environ | {"SPHROM_CACHE": str(tmp_path), "NUMBA_CACHE_DIR": given}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env=settings,
    )
    before, after, source_hash = done.stdout.splitlines()
    assert before == after == (given or str(tmp_path / "sphrom" / source_hash))


def test_a_serial_loop_keeps_the_order_of_its_sums() -> None:
    @jit.serial
    def total(values: np.ndarray) -> float:
        out = 0.0
        for k in range(values.size):
            out += values[k]
        return out

    values = np.array([1e16, 1.0, -1e16, 1.0] * 50)
    assert total(values) == total.py_func(values)
