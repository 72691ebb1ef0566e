"""Distributions of independent parameters, by their names in scipy.stats, and designs of draws.

A distribution is a name with its arguments: its shape parameters, `loc` and `scale`. Draws are its
quantile function at points of a unit cube, so that any design of such points can be had: sequences
that fill the cube, or Saltelli's for Sobol indices (`sphrom.metrics.sobol`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAREST_SHARE = 2.0**-33
"""How near to zero and one shares come: quantiles there may be infinite."""
USUAL = ("uniform", "norm", "truncnorm", "lognorm", "triang", "beta", "gamma", "loguniform")
"""Names for messages."""
COMMON = ("loc", "scale")
"""Arguments of every distribution, 0 and 1 where they are not given."""


@cache
def _known(name: str) -> Any:
    """Return scipy's distribution of a name, None where it has none with a quantile function."""
    from scipy import stats  # it takes long to load

    found = getattr(stats, name, None)
    if not isinstance(found, stats.rv_continuous):
        return None
    # Without one of its own scipy inverts numerically, which takes minutes for many draws.
    own = type(found)._ppf is not stats.rv_continuous._ppf
    return found if own else None


def arguments_of(name: str) -> tuple[str, ...]:
    """Return the names of a known distribution's shape parameters."""
    shapes = _known(name).shapes
    return tuple(shapes.replace(" ", "").split(",")) if shapes else ()


def problem(name: str, arguments: Mapping[str, float]) -> tuple[str, str] | None:
    """Return what is wrong with a distribution: the argument, or an empty name, and the reason."""
    if _known(name) is None:
        near = get_close_matches(name, USUAL, 1)
        hint = f"did you mean {near[0]}?" if near else f"such as {', '.join(USUAL)}"
        reason = f"scipy.stats has no continuous distribution {name} with a quantile function"
        return "distribution", f"{reason}; {hint}"
    shapes = arguments_of(name)
    takes = ", ".join((*shapes, *COMMON))
    for argument in arguments:
        if argument not in (*shapes, *COMMON):
            return argument, f"is no argument of {name}, which takes {takes}"
    for shape in shapes:
        if shape not in arguments:
            return "", f"{name} needs {shape}: it takes {takes}"
    if not arguments.get("scale", 1.0) > 0.0:
        return "scale", f"must be above zero; got {arguments['scale']:g}"
    if not np.all(np.isfinite(quantiles(name, arguments, np.array([0.01, 0.5, 0.99])))):
        given = ", ".join(f"{shape}: {arguments[shape]:g}" for shape in shapes)
        return "", f"{name} has no values with {given}"
    return None


def quantiles(name: str, arguments: Mapping[str, float], shares: Array) -> Array:
    """Return the values of a distribution below which some shares (...) of all lie."""
    inside = np.clip(shares, NEAREST_SHARE, 1.0 - NEAREST_SHARE)
    return np.asarray(_known(name).ppf(inside, **arguments), dtype=np.float64)


def share_outside(name: str, arguments: Mapping[str, float], low: float, high: float) -> float:
    """Return the probability of values below one bound or above another."""
    distribution = _known(name)
    below = distribution.cdf(np.nextafter(low, -math.inf), **arguments)
    return float(below + distribution.sf(high, **arguments))
