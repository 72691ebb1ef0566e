"""How much is held at once, for those who compute with it and those who estimate memory."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK_VALUES = 2**21
"""Values of a field at a block of points."""
N_FIELD_VALUES = 3
"""Values of a state at one point: the first field and two components of the velocity."""
CELL_WIDTH_RATIO = 3.0
"""Cell width over the spacing of points, 81 points a system. At 2 (36 points) the error of a cubic
spline is six times larger and evaluation 1.5 times faster; at 4 (144 points) three times smaller
and 1.5 times slower."""
BLOCK_COPIES = 5
"""Copies of a block of snapshots alive at once: as read, weighted, as rows, stacked on R, in QR."""
BYTES = 8
"""Of a number."""


def blocks(n_points: int, size: int) -> Iterator[slice]:
    """Yield blocks of points, none of which is larger than a size, or than one point."""
    for first in range(0, n_points, max(1, size)):
        yield slice(first, min(first + max(1, size), n_points))


def polynomial_terms(degree: int) -> int:
    """Return how many monomials in two dimensions have at most a degree."""
    return (degree + 1) * (degree + 2) // 2


def decomposition_bytes(n_snapshots: int, n_parts: int, n_points: int) -> int:
    """Return the memory [bytes] of a decomposition that reads blocks of points (Eq. 3.14).

    It is made of the triangular factors of each part, and the copies of one block.
    """
    factors = (n_parts + 2) * n_snapshots**2
    return BYTES * (factors + BLOCK_COPIES * N_FIELD_VALUES * n_snapshots * n_points)


def smallest_block(n_snapshots: int) -> int:
    """Return the least points of a block in a decomposition: enough for a square matrix."""
    return -(-n_snapshots // N_FIELD_VALUES)
