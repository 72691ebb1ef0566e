"""Cost against error: the Pareto front, and after how many runs a model has paid off."""

from __future__ import annotations

import math
from collections.abc import Sequence


def pareto_front(costs: Sequence[tuple[float, float] | None]) -> list[bool]:
    """Return which points no other dominates, given two costs of each, to be minimised.

    A point dominates another when it is no worse in both and better in one. None is a point whose
    costs are unknown: it neither dominates nor is on the front.
    """
    return [
        cost is not None
        and not any(
            other is not None and other != cost and other[0] <= cost[0] and other[1] <= cost[1]
            for other in costs
        )
        for cost in costs
    ]


def break_even(once: float | None, full_seconds: float | None, online_seconds: float) -> int | None:
    """Return the least number of runs at which a model that costs `once` [s] to make is cheaper.

    None when it never is, or a cost is unknown.
    """
    if once is None or full_seconds is None:
        return None
    gain = full_seconds - online_seconds
    if gain <= 0.0:
        return None
    return max(1, math.ceil(once / gain))
