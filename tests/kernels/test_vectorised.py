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
import numpy as np
import pytest

from sphrom.kernels import fields, jit, printed, sums

TARGET = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_JIT": "0"}


def pair_loops(precision: type) -> list[tuple]:
    """Return the loops with default terms, and the types of their arguments."""
    one = precision(1.0)
    number = numba.typeof(one)
    lists = (number[:, ::1], numba.int64)
    place = numba.typeof((one, one))
    flow = numba.typeof(fields.Flow((one, one), one, (one, one), one))
    derived = numba.typeof(fields.Derived(one, one, (one, one)))
    fluid = numba.typeof(fields.FluidConstants._make([one] * 6))
    regularity = numba.typeof(fields.RegularityConstants._make([one] * 7))
    slopes = [numba.types.UniTuple(number, n) for n in (0, 3)]
    rates = (place, flow, derived, place, *lists, fluid, number)
    return [
        *((sums.regularity_sums, (place, flow, *lists, s, regularity, number)) for s in slopes),
        (sums.rate_sums, rates),
    ]


DOUBLE = pair_loops(np.float64)
KERNELS = [*DOUBLE, (printed.printed_sums, DOUBLE[-1][1]), *pair_loops(np.float32)]
# A square root of a whole register of 256 bits; every distance takes one.
PACKED_ROOT = re.compile(r"\bvsqrtp[ds]\s[^\n]*%ymm")


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
