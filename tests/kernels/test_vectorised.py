"""The compiler makes vectors of the loops over pairs: seen in the machine code that it wrote."""

from __future__ import annotations

import platform
import re
from collections.abc import Collection

import llvmlite.binding as llvm
import numba
import pytest

from sphrom.kernels import advection, jit, sweeps

NUMBER = numba.float64
FIELD = numba.float64[::1]
FLUID = numba.typeof(sweeps.FluidConstants(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
SIGNATURES = {
    sweeps._regularity_pairs: (*[NUMBER] * 5, *[FIELD] * 6, *[NUMBER] * 4),
    sweeps._rate_pairs: (*[NUMBER] * 11, *[FIELD] * 10, NUMBER, FLUID),
    sweeps._printed_pairs: (*[NUMBER] * 11, *[FIELD] * 12, *[NUMBER] * 2, FLUID),
    advection._gradient_pairs: (*[NUMBER] * 8, *[FIELD] * 9, *[NUMBER] * 4),
}
# A square root of a whole register of 256 or 512 bits; every distance takes one.
PACKED_ROOT = re.compile(r"\bvsqrtpd\s[^\n]*%[yz]mm")


def machine_code(function, fast_math: Collection[str]) -> str:
    signature = SIGNATURES[function]
    compiled = numba.njit(fastmath=set(fast_math), error_model="numpy")(function.py_func)
    compiled.compile(signature)
    return compiled.inspect_asm(signature)


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64") or not llvm.get_host_cpu_features().get("avx"),
    reason="the processor has no AVX",
)
@pytest.mark.parametrize("function", SIGNATURES, ids=lambda function: function.__name__)
def test_loops_over_pairs_are_vectorised(function) -> None:
    assert PACKED_ROOT.search(machine_code(function, jit.FAST_MATH))
    # What makes it so is that sums may be reassociated.
    assert not PACKED_ROOT.search(machine_code(function, jit.FAST_MATH - {"reassoc"}))
