"""Histories: functions of time that follow values at some times, the knots."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.errors import CaseError
from sphrom.scenes.expressions import Expression
from sphrom.sph.fluid import ROUNDING

FAR_BEYOND = 0.25
"""Share of a history's duration beyond which it has no values."""


@dataclass(frozen=True, eq=False)
class History:
    """A piecewise linear function of time, or a cubic spline with ends of the kind not-a-knot.

    Both are linear in the values at the knots.
    """

    source: str
    """The owner of the knots, for messages."""
    rows: Array
    """Times [s] and values (2, n_knots + 2) of `beyond_ends`."""
    scale: float = 1.0
    """Factor of the values."""
    cubic: bool = False
    values: tuple[Expression, ...] = ()
    """The values at the knots as functions of constants, if they are given so."""

    @cached_property
    def _curve(self) -> Callable[[Array], Array]:
        if not self.cubic:
            return lambda time: np.interp(time, *self.rows)
        from scipy.interpolate import make_interp_spline  # late, because few cases need it

        times, values = self.rows[:, 1:-1]
        return make_interp_spline(times, values, k=min(3, len(times) - 1))

    def __call__(self, time: Array) -> Array:
        """Return the values at times [s]. Raises CaseError far beyond the knots."""
        if (problem := self.lacks(time, FAR_BEYOND)) is not None:
            raise CaseError(f"scene.histories: {problem}")
        return self.scale * self._curve(time)

    def lacks(self, times: Array, tolerated: float = ROUNDING) -> str | None:
        """Return a problem if times [s] are beyond the knots by a share of their duration."""
        first, last = self.rows[0, [1, -2]]
        margin = tolerated * (last - first)
        for time in (times.min(), times.max()):
            if not first - margin <= time <= last + margin:
                given = f"{self.source} has times from {first:g} to {last:g} s"
                return f"{given}, but {time:g} s is needed"
        return None

    def degree_in(self, names: Collection[str]) -> float:
        """Return the degree of the values as polynomials in some names."""
        return max((value.degree_in(names) for value in self.values), default=0.0)


def beyond_ends(rows: Array) -> Array:
    """Return times and values (2, n_knots) with a row before the first and after the last.

    Both continue the lines at the ends: the last step of a fast model may end beyond the run.
    """
    ends = 2.0 * rows[:, [0, -1]] - rows[:, [1, -2]]
    return np.concatenate((ends[:, :1], rows, ends[:, 1:]), axis=1)
