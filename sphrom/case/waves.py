"""Whether training runs of a shaken tank have waves as steep as the runs of models."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array
from sphrom.case.custom_sections import SurfaceForce
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.sloshing import instants, largest_slope
from sphrom.reduction.surface_basis import SLOPE_BEYOND_TRAINING
from sphrom.text import exact

MOST_POINTS = 100
"""Largest number of points to check, evenly chosen, because each takes some milliseconds."""


def steeper_than_training(
    case: Case,
    key: str,
    points: Iterable[ParameterPoint],
    model: ReducedModelSection | None = None,
) -> Iterator[str]:
    """Yield a warning if linear theory expects a surface much steeper than in training runs.

    It names the steepest of the points, and a strength that makes training runs as steep.
    """
    asked = list(points)
    asked = asked[:: math.ceil(len(asked) / MOST_POINTS)] if asked else []
    if not (case.scene.has_surface and case.rom and asked):
        return
    end = (case.plan.steps if model is None else case.plan.model_steps(model)).end_time
    trained = {p: slope_at(case, p, case.plan.steps.end_time) for p in case.plan.train_points}
    slopes = {point: slope_at(case, point, end) for point in asked}
    worst, steepest = (max(each, key=each.__getitem__) for each in (slopes, trained))
    factor = slopes[worst] / trained[steepest] if trained[steepest] else math.inf
    if not factor > SLOPE_BEYOND_TRAINING or math.isinf(factor):
        return
    shaken = f"a body force {factor:.2g} times as strong"
    if (name := strength_of(case, steepest)) is not None:
        shaken = f"{name}: {exact(float(f'{factor * steepest.factors[name]:.2g}'))}"
    yield (
        f"{key}: at {worst.label} linear theory expects a surface {factor:.2g} times as steep as "
        f"in any training run (a slope of {slopes[worst]:.2g}), so models extrapolate; add a "
        f"training run there, or with {shaken} at {steepest.label}"
    )


def slope_at(case: Case, point: ParameterPoint, end: float) -> float:
    """Return the largest slope of the surface until a time [s], by linear theory."""
    plan = case.plan
    scene = case.scene
    width = scene.domain.lengths[0]
    depth = plan.depth(point)
    times = instants(end, width, depth, scene.gravity, plan.longest_step(point))
    return largest_slope(
        times,
        _force(case, point, times)[0],
        width=width,
        depth=depth,
        gravity=scene.gravity,
        viscosity=plan.kinematic_viscosity(point),
        slips=scene.free_slip,
    )


def strength_of(case: Case, point: ParameterPoint) -> str | None:
    """Return the name of a parameter to which the body force is proportional, if there is one."""
    times = np.linspace(0.0, case.plan.steps.end_time, 99)
    force = _force(case, point, times)
    for name, value in point.others:
        doubled = tuple((n, v * (2.0 if n == name else 1.0)) for n, v in point.others)
        twice = _force(case, replace(point, others=doubled), times)
        if value and np.allclose(twice, 2.0 * force, rtol=1e-9, atol=0.0):
            return name
    return None


def _force(case: Case, point: ParameterPoint, times: Array) -> Array:
    """Return the body force (2, n_times) [m/s2]."""
    force = case.plan.flow(point).body_force
    assert isinstance(force, SurfaceForce)
    return force.over(times)
