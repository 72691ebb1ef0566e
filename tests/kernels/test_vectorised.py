"""The compiler makes vectors of the loops over pairs: seen in the machine code that it writes.

A process of its own compiles for one processor, whatever this machine's is, and runs nothing.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys

import numba
import pytest

from sphrom.kernels import fields, jit, printed, sums

TARGET = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_JIT": "0"}
NUMBER = numba.float64
LISTS = (numba.float64[:, ::1], numba.int64)
FLUID = numba.typeof(fields.FluidConstants(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
REGULARITY = numba.typeof(fields.RegularityConstants(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
PLACE = numba.typeof((1.0, 1.0))
FLOW = numba.typeof(fields.Flow((1.0, 1.0), 1.0, (1.0, 1.0), 1.0))
DERIVED = numba.typeof(fields.Derived(1.0, 1.0, (1.0, 1.0)))
SLOPES = [numba.types.UniTuple(NUMBER, n) for n in (0, 3)]
RATES = (PLACE, FLOW, DERIVED, PLACE, *LISTS, FLUID, NUMBER)
KERNELS = [
    *((sums.regularity_sums, (PLACE, FLOW, *LISTS, s, REGULARITY, NUMBER)) for s in SLOPES),
    (sums.rate_sums, RATES),
    (printed.printed_sums, RATES),
]
# A square root of a whole register of 256 bits; every distance takes one.
PACKED_ROOT = re.compile(r"\bvsqrtpd\s[^\n]*%ymm")


def has_packed_roots(function, signature: tuple, fast_math: set[str]) -> bool:
    compiled = numba.njit(fastmath=fast_math, error_model="numpy")(function.py_func)
    compiled.compile(signature)
    return PACKED_ROOT.search(compiled.inspect_asm(signature)) is not None


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="the compiler has no target of x86-64"
)
def test_loops_over_pairs_are_vectorised() -> None:
    found = subprocess.run(
        [sys.executable, __file__],
        env=os.environ | TARGET,
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )
    # What makes it so is that sums may be reassociated.
    assert json.loads(found.stdout) == [[True, False]] * len(KERNELS)


if __name__ == "__main__":
    kinds = (set(jit.FAST_MATH), set(jit.FAST_MATH) - {"reassoc"})
    print(json.dumps([[has_packed_roots(*kernel, kind) for kind in kinds] for kernel in KERNELS]))
