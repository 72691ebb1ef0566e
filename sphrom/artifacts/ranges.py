"""What values and lengths a sound artifact can have, whoever signed it.

A digest shows that values are those that were written, not that they can be: another program may
have written them. Ranges go by the last part of a field's path, its type and its units, lengths by
the axes' names.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sphrom.artifacts.schema import AttributeField, DatasetField

LARGEST = 1e100
"""Magnitude that no value exceeds: sums of squares of larger ones may overflow."""
FAR = 2.0
"""Distance from the origin that no position has, over the box's longest edge. Boxes begin at the
origin; ghosts lie beyond them."""
POSITIVE = {
    "box_length", "cell_shape", "lattice_shape", "mass", "particle_spacing", "reference_density",
    "smoothing_length", "sound_speed", "spline_order", "threads", "time_step", "volume",
}  # fmt: skip
"""Fields whose values are above zero."""
NOT_NEGATIVE = {
    "condition_number", "gram_error", "kinematic_viscosity", "memory_length", "residual",
    "wall_seconds",
}  # fmt: skip
"""Fields whose values are zero or above; whole numbers are so too, but for the next ones."""
LEAST = {"polynomial_degree": -1}
COUNTED = {"cell_start": "point", "complete": "run", "run": "run"}
"""Fields whose values count entries along an axis."""
LENGTHS = {"component": 2, "field": 2}
"""Axes of one length."""
NEVER_EMPTY = {
    "cell", "column", "compared_snapshot", "direction", "mode", "node", "node_row", "parameter",
    "particle", "point", "run", "singular_value", "training_run",
}  # fmt: skip


@dataclass(frozen=True)
class Range:
    """The values that a field can have."""

    least: float
    most: float
    beyond: str = ""
    """What to say of a larger magnitude than `most`."""

    def problem(self, values: ArrayLike) -> str | None:
        """Return what is wrong with values, in words, or None."""
        array = np.asarray(values)
        extremes = (array.min(), array.max()) if array.size and array.dtype.kind in "fiu" else ()
        for value in extremes:
            if not self.least <= value <= self.most:
                return f"holds {value:g}{self._reason(float(value))}"
        return None

    def _reason(self, value: float) -> str:
        if self.beyond and math.isfinite(value):
            return f", {self.beyond}"
        if not abs(value) <= LARGEST:
            return ""
        if value > self.most:
            return f", above {self.most:g}"
        return ", which is not positive" if self.least > 0.0 else f", below {self.least:g}"


def range_of(field: DatasetField | AttributeField) -> Range:
    """Return the range of a field's values, as far as its declaration tells."""
    name = field.name.rpartition("/")[2]
    stored_as = field.dtype if isinstance(field, DatasetField) else field.kind
    counts = stored_as.startswith("int")
    if name in POSITIVE:
        return Range(1 if counts else math.ulp(0.0), LARGEST)
    least = 0 if counts or name in NOT_NEGATIVE else -LARGEST
    return Range(LEAST.get(name, least), LARGEST)


def length_problem(lengths: Mapping[str, int]) -> str | None:
    """Return which axis of a group has a length that it can't have, in words, or None."""
    for axis, expected in _expected(lengths):
        if lengths.get(axis, expected) != expected:
            return f"has {lengths[axis]} along {axis}, not {expected}"
    empty = sorted(axis for axis in NEVER_EMPTY & lengths.keys() if not lengths[axis])
    return f"has none along {empty[0]}" if empty else None


def _expected(lengths: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """Give the axes whose lengths are known, and those lengths."""
    yield from LENGTHS.items()
    if "cell" in lengths:
        yield "cell_boundary", lengths["cell"] + 1
    if "mode" in lengths:
        n_modes = lengths["mode"]
        yield "linear_monomial", 1 + n_modes
        yield "monomial", 1 + n_modes + n_modes * (n_modes + 1) // 2
