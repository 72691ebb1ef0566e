"""Warnings about a valid case."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from sphrom.case.checks import beyond_limits
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint, outside
from sphrom.case.sections import AUTO
from sphrom.case.studies import Region, sweep_model, sweep_points
from sphrom.sph.fluid import ROUNDING

SNAPSHOTS_PER_MODE = 2
"""Least number of snapshots per mode without a warning."""
MOST_MISSED = 0.02
"""Largest difference of the areas of particles and their shape without a warning, over the area."""
LEAST_STRIP = 20.0
"""Least width of a strip, over the spacing; its rate then falls within two spacings."""


def case_warnings(case: Case) -> list[str]:
    """Return the warnings about a valid case."""
    return [
        *(f"scene.{key}: {reason}" for key, reason in case.scene.warnings()),
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
        *_of_strip(case),
        *_of_filling(case),
        *_extrapolations(case, "parameters.test", case.plan.test_points),
        *_of_models(case),
        *_of_numerics(case),
    ]


def _of_strip(case: Case) -> Iterator[str]:
    strip, least = case.plan.strip, LEAST_STRIP * case.plan.particle_spacing
    if strip is not None and (width := strip.end - strip.start) < least * (1.0 - ROUNDING):
        resolution = math.ceil(case.discretization.resolution * least / width)
        yield (
            f"scene.inflow.strip: is {width:.3g} m wide, so its forcing is too steep for the "
            f"particles; use {least:.3g} m, or discretization.resolution: {resolution}"
        )


def _of_filling(case: Case) -> Iterator[str]:
    """Warn if the particles of a fluid with a shape have another area than the shape."""
    fluid = getattr(case.scene, "fluid", None)
    if fluid is None or fluid.level is not None:
        return
    area, filled = fluid.geometry().area, case.plan.n_particles * case.plan.particle_spacing**2
    if abs(filled / area - 1.0) > MOST_MISSED:
        yield (
            f"scene.fluid: its particles have an area of {filled:.4g} m2, and its shape "
            f"{area:.4g} m2; choose a discretization.resolution whose spacing divides its sides"
        )


def _extrapolations(case: Case, key: str, points: Iterable[ParameterPoint]) -> Iterator[str]:
    # Within its region, `train` chooses the training runs.
    trained = Region(case).contains if case.training.ranges else case.plan.train_points.__contains__
    reasons = (extrapolation(case, point) for point in points if not trained(point))
    yield from (f"{key}: {reason}" for reason in reasons if reason)


def _of_models(case: Case) -> Iterator[str]:
    trained = case.plan.steps.end_time
    for i, model in enumerate(case.rom):
        if case.plan.model_steps(model).end_time > trained:
            yield f"rom.{i}.until: {beyond_training(trained)}"
        unseen = [point for point in case.plan.rom_points(model) if point not in case.plan.points]
        yield from _extrapolations(case, f"rom.{i}.parameters", unseen)
        for point in unseen:
            if (start := case.plan.start_point(point)) != point:
                yield (
                    f"rom.{i}.parameters: {point.label} has no spin-up of its own, so its run "
                    f"starts from the spin-up of the nearest training run, {start.label}"
                )


def beyond_training(trained_until: float) -> str:
    """Return a warning for a run that continues after the trained time [s]."""
    return f"after {trained_until:g} s the run is beyond the trained time"


def extrapolation(case: Case, point: ParameterPoint) -> str | None:
    """Return a warning if a point is outside of the trained range, else None."""
    beyond = outside(point, case.plan.train_points)
    if not beyond:
        return None
    ranges = " and ".join(f"{each} of {name}" for name, each in beyond.items())
    where = f"{point.label} is outside of the trained range, {ranges}"
    return f"{where}: a reduced model extrapolates there"


def _of_numerics(case: Case) -> Iterator[str]:
    plan, steps, psi = case.plan, case.plan.steps, case.psi
    if plan.reference_bases and case.basis.inner_product == "raw":
        yield (
            "basis.inner_product: with the raw product, sound may grow in models on the reference "
            "points; with the acoustic product it can't"
        )
    if steps.n_steps % steps.every:
        last = f"the last snapshot is at {steps.end_time:g} s"
        yield f"snapshots.every: {last}, before time.final_time"
    least = (psi.order - 1) // 2 if psi.order % 2 else psi.order // 2
    if psi.polynomial_degree < least and not plan.lattice_splines:
        yield (
            f"psi.polynomial_degree: splines of order {psi.order} need degree {least} or more to "
            f"exist for all points; got {psi.polynomial_degree}"
        )


def few_snapshots(case: Case) -> Iterator[str]:
    """Yield warnings of bases with few snapshots per mode, whose last modes fit noise."""
    how = "with a lower snapshots.every" if case.plan.steps.every > 1 else "with more training runs"
    needed = max((model.size for model in case.rom if model.n_modes != AUTO), default=0)
    for name in dict.fromkeys(name for m in case.rom for name in case.plan.bases_for(m)):
        number = case.plan.n_basis_snapshots(name)
        if number < SNAPSHOTS_PER_MODE * needed:
            yield (
                f"snapshots.every: basis {name} has {needed} modes from {number} snapshots, so its "
                f"last modes fit noise; store at least {SNAPSHOTS_PER_MODE} snapshots per mode "
                f"{how}, or use fewer modes"
            )


def slow_sweep(case: Case) -> str | None:
    """Return a warning if a sweep makes full runs because the case has no faster model."""
    if case.sweep.model is not None or sweep_model(case) is not None:
        return None
    return (
        "sweep.model: the case has no model on the reference points, so all runs of the sweep are "
        "full runs; add {name: fast, evaluation: operators} to rom for runs of milliseconds, or "
        "set sweep.model: full"
    )


def sweep_beyond_training(case: Case) -> str | None:
    """Return a warning with the number of points of a reduced sweep beyond the trained range."""
    model, points = sweep_model(case), sweep_points(case)
    beyond = [point for point in points if outside(point, case.plan.train_points)]
    if model is None or not beyond:
        return None
    return (
        f"sweep: {len(beyond)} of {len(points)} points, such as {beyond[0].label}, are outside of "
        f"the trained range: {model.name} extrapolates there"
    )
