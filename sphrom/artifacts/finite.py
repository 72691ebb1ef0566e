"""Find values that are not finite or absurdly large, and say where they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.ranges import LARGEST


def index_not_finite(values: NDArray[Any]) -> tuple[int, ...] | None:
    """Return the index of the first value that is NaN, infinite or too large, if there is one."""
    if values.dtype.kind != "f":
        return None
    most = min(LARGEST, float(np.finfo(values.dtype).max))
    finite = (values >= -most) & (values <= most)
    if finite.all():
        return None
    return tuple(int(index) for index in np.unravel_index(np.argmin(finite), values.shape))


def describe_index(axes: tuple[str, ...], index: tuple[int, ...]) -> str:
    """Return an index in words: ` at snapshot 3, particle 17`."""
    words = ", ".join(f"{axis} {at}" for axis, at in zip(axes, index, strict=True))
    return f" at {words}" if words else ""
