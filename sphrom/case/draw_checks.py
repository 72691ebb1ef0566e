"""Checks of a sweep's draws: distributions that exist and can be drawn from, and enough draws."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from sphrom.case.fields import LARGEST, SMALLEST
from sphrom.case.points import REYNOLDS
from sphrom.case.schema import Path
from sphrom.case.sweep import MOST_VALUES, DistributionSection, DrawnSection, SweepSection
from sphrom.case.yaml_reader import Problem
from sphrom.metrics import distributions
from sphrom.metrics.uncertainty import fewest_runs
from sphrom.text import exact

_SAMPLE: Path = ("sweep", "sample")
NEVER = 1e-9
"""Probability of impossible values below which no draw is ever among them."""


def check_draws(section: SweepSection) -> Iterator[Problem]:
    """Check what a sweep draws its points from, before anything draws."""
    if any(low >= high for low, high in pairwise(section.quantiles)):
        yield Problem(("sweep", "quantiles"), "must rise")
    sample = section.sample
    if sample is None:
        return
    if not sample.entries:
        reason = "names no parameter: give one, such as reynolds: [50, 200]"
        yield Problem(_SAMPLE, reason)
        return
    for name, entry in sample.entries.items():
        if isinstance(entry, DistributionSection):
            yield from _check_distribution(name, entry)
        elif not entry[0] < entry[1]:
            low, high = map(exact, entry)
            reason = f"must go from the lower to the higher value; got {low}, {high}"
            yield Problem((*_SAMPLE, name), reason)
    yield from _check_count(section, sample)


def _check_distribution(parameter: str, section: DistributionSection) -> Iterator[Problem]:
    path: Path = (*_SAMPLE, parameter)
    name, arguments = section.distribution, section.arguments
    if (found := distributions.problem(name, arguments)) is not None:
        where, reason = found
        yield Problem((*path, where) if where else path, reason)
        return
    low = SMALLEST if parameter == REYNOLDS else -LARGEST
    share = distributions.share_outside(name, arguments, low, LARGEST)
    if share > NEVER:
        yield Problem(path, f"{_impossible(parameter, name, share)}; {_remedy(section, low)}")


def _impossible(parameter: str, name: str, share: float) -> str:
    words = f"{name} has {100.0 * share:.2g} % of its values where none is possible"
    if parameter == REYNOLDS:
        return f"{words}, as reynolds and with it the viscosity must be above zero"
    return f"{words}, beyond {LARGEST:g} in size"


def _remedy(section: DistributionSection, low: float) -> str:
    """Return how to truncate a distribution, or what to replace it with."""
    loc, scale = section.arguments.get("loc", 0.0), section.arguments.get("scale", 1.0)
    if section.distribution == "norm" and loc > low:
        least = math.floor(100.0 * 0.99 * loc / scale) / 100.0
        return (
            f"truncate it: {{distribution: truncnorm, a: {-least:g}, b: {least:g}, "
            f"loc: {loc:g}, scale: {scale:g}}}"
        )
    return "truncate it (truncnorm, truncexpon), or choose one above zero (uniform, lognorm, beta)"


def _check_count(section: SweepSection, sample: DrawnSection) -> Iterator[Problem]:
    path: Path = (*_SAMPLE, "count")
    n_drawn = sample.count
    if sample.method == "saltelli":
        n_drawn *= 2
        if len(sample.entries) < 2:
            reason = "compares parameters: name two or more, or choose another method"
            yield Problem((*_SAMPLE, "method"), f"saltelli {reason}")
        elif sample.count & (sample.count - 1):
            below = 2 ** (sample.count.bit_length() - 1)
            reason = f"must be a power of two for method: saltelli, such as {below} or {2 * below}"
            yield Problem(path, f"{reason}; got {sample.count}")
        elif sample.n_points > MOST_VALUES:
            reason = f"makes {sample.n_points} runs; at most {MOST_VALUES} are allowed"
            yield Problem(path, reason)
    if section.levels and n_drawn < (fewest := fewest_runs(section.levels)):
        least = fewest if sample.method != "saltelli" else 2 ** math.ceil(math.log2(fewest / 2))
        reason = f"is too small for intervals of sweep.quantiles: at least {least} are needed"
        yield Problem(path, f"{reason}; got {sample.count}")
