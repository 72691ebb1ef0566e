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

from sphrom.kernels import advection, jit, sweeps

TARGET = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_JIT": "0"}
NUMBER = numba.float64
FIELD = numba.float64[::1]
FLUID = numba.typeof(sweeps.FluidConstants(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
SIGNATURES = {
    sweeps._regularity_pairs: (*[NUMBER] * 5, *[FIELD] * 6, *[NUMBER] * 4),
    sweeps._rate_pairs: (*[NUMBER] * 11, *[FIELD] * 10, NUMBER, FLUID),
    sweeps._printed_pairs: (*[NUMBER] * 11, *[FIELD] * 12, *[NUMBER] * 2, FLUID),
    advection._gradient_pairs: (*[NUMBER] * 8, *[FIELD] * 9, *[NUMBER] * 4),
}
# A square root of a whole register of 256 bits; every distance takes one.
PACKED_ROOT = re.compile(r"\bvsqrtpd\s[^\n]*%ymm")


def has_packed_roots(function, fast_math: set[str]) -> bool:
    signature = SIGNATURES[function]
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
        timeout=120,
    )
    # What makes it so is that sums may be reassociated.
    assert json.loads(found.stdout) == {each.__name__: [True, False] for each in SIGNATURES}


if __name__ == "__main__":
    kinds = (set(jit.FAST_MATH), set(jit.FAST_MATH) - {"reassoc"})
    found = {f.__name__: [has_packed_roots(f, kind) for kind in kinds] for f in SIGNATURES}
    print(json.dumps(found))
