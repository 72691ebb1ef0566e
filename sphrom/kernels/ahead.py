"""Kernels that other processes compile while the first stages of a case run.

The list has the kernels of a case with models from operators that take longest to compile, in the
order in which its stages call them, with the types of their arguments. A kernel that is called with
other types is compiled at the call. Each process ends when its standard input is closed, and
therefore with the process that started it.
"""

from __future__ import annotations

import os
import sys
import threading
from typing import Any

from numba.types import BaseTuple, boolean, float64, int64

from sphrom.kernels.blocks import Blocks
from sphrom.kernels.cells import Grid, Search
from sphrom.kernels.exponential import integrate
from sphrom.kernels.fields import FluidConstants, RegularityConstants
from sphrom.kernels.interpolation import moving_least_squares
from sphrom.kernels.polyharmonic import Systems, combine, evaluate, evaluate_with_gradients
from sphrom.kernels.projection import gram, leave_out, products
from sphrom.kernels.sweeps import rates, regularity

LINE = float64[::1]
TABLE = float64[:, ::1]
STACK = float64[:, :, ::1]
INDICES = int64[::1]


def _record(kind: type, fields: tuple[Any, ...]) -> BaseTuple:
    return BaseTuple.from_types(fields, kind)


COUNTS = (int64,) * 3
SCALARS = (float64,) * 4 + (int64,) * 2
GRID = _record(Grid, SCALARS)
SEARCH = _record(Search, (*SCALARS, INDICES, float64, float64))
BLOCKS = _record(Blocks, (INDICES, INDICES, INDICES, STACK))
FLUID = _record(FluidConstants, (float64,) * 6)
SHIFTING = _record(RegularityConstants, (float64,) * 7)
POLYHARMONIC = _record(Systems, (TABLE, INDICES, TABLE, STACK))
CELLS = LINE, LINE, INDICES, INDICES, GRID, float64, int64, int64, POLYHARMONIC, STACK
KERNELS: tuple[tuple[Any, tuple[Any, ...]], ...] = (
    (rates, (BLOCKS, SEARCH, TABLE, TABLE, FLUID, TABLE)),
    (moving_least_squares, (TABLE, LINE, TABLE, SEARCH, TABLE, TABLE)),
    (evaluate_with_gradients, (*CELLS, TABLE, STACK)),
    (integrate, (STACK, INDICES, LINE, STACK, STACK, STACK, *COUNTS, float64, LINE, LINE, TABLE)),
    (combine, (TABLE, TABLE, TABLE)),
    (evaluate, (*CELLS, TABLE)),
    (gram, (STACK, LINE, boolean, STACK, STACK)),
    (products, (STACK, LINE, boolean, TABLE, TABLE)),
    (leave_out, (STACK, boolean, LINE, TABLE, TABLE)),
    (regularity, (BLOCKS, SEARCH, TABLE, SHIFTING, TABLE, TABLE, BaseTuple.from_types((STACK,)))),
)


def compile_share(number: int, share: int) -> None:
    """Compile one of `number` shares of these kernels, unless they are stored, and store them."""
    for kernel, types in KERNELS[share::number]:
        kernel.compile(types)


def _end_with_input() -> None:
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    compile_share(*map(int, sys.argv[1:]))
