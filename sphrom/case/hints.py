"""Warnings of a valid case, which nothing refuses."""

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
"""Fewer snapshots are few for so many modes."""
LEAST_STRIP = 20.0
"""Least width of a strip, over the spacing: its rate falls within two spacings then."""


def case_warnings(case: Case) -> list[str]:
    """Return what a user should know about a valid case."""
    return [
        *(f"scene.{key}: {reason}" for key, reason in case.scene.warnings()),
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
        *_of_strip(case),
        *_extrapolations(case, "parameters.test", case.plan.test_points),
        *_of_models(case),
        *_of_numerics(case),
    ]


def _of_strip(case: Case) -> Iterator[str]:
    strip, least = case.plan.strip, LEAST_STRIP * case.plan.particle_spacing
    if strip is not None and (width := strip.end - strip.start) < least * (1.0 - ROUNDING):
        resolution = math.ceil(case.discretization.resolution * least / width)
        yield (
            f"scene.inflow.strip: is {width:.3g} m wide, and its forcing is too steep for the "
            f"particles; {least:.3g} m or discretization.resolution: {resolution} would do"
        )


def _extrapolations(case: Case, key: str, points: Iterable[ParameterPoint]) -> Iterator[str]:
    # In its region `train` chooses what is learnt from.
    known = Region(case).contains if case.training.ranges else case.plan.train_points.__contains__
    found = (extrapolation(case, point) for point in points if not known(point))
    yield from (f"{key}: {warning}" for warning in found if warning)


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
                    f"rom.{i}.parameters: {point.label} has no spin-up: its run starts from the "
                    f"end of that at {start.label}, the nearest trained"
                )


def beyond_training(trained_until: float) -> str:
    """Return a warning for a run that goes on after the trained time [s]."""
    return f"after {trained_until:g} s the run is beyond the trained time"


def extrapolation(case: Case, point: ParameterPoint) -> str | None:
    """Return a warning where a point is outside of the trained range, else None."""
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
            "basis.inner_product: in the raw product operators on the reference points let sound "
            "grow; in the acoustic one they can't"
        )
    if steps.n_steps % steps.every:
        last = f"the last snapshot is at {steps.end_time:g} s"
        yield f"snapshots.every: {last}, before time.final_time"
    least = (psi.order - 1) // 2 if psi.order % 2 else psi.order // 2
    if psi.polynomial_degree < least and not plan.lattice_splines:
        yield (
            f"psi.polynomial_degree: splines of order {psi.order} are sure to exist from degree "
            f"{least} on; got {psi.polynomial_degree}"
        )


def few_snapshots(case: Case) -> Iterator[str]:
    """Warn where a basis keeps most of what its snapshots hold: the last modes are their noise."""
    how = "with a lower snapshots.every" if case.plan.steps.every > 1 else "of more training runs"
    needed = max((model.size for model in case.rom if model.n_modes != AUTO), default=0)
    for name in dict.fromkeys(name for m in case.rom for name in case.plan.bases_for(m)):
        number = case.plan.n_basis_snapshots(name)
        if number < SNAPSHOTS_PER_MODE * needed:
            yield (
                f"snapshots.every: {needed} modes from {number} snapshots (basis {name}): the last "
                f"modes fit what is particular to these snapshots; keep {SNAPSHOTS_PER_MODE} a "
                f"mode or more, {how}, or ask for fewer modes"
            )


def slow_sweep(case: Case) -> str | None:
    """Return a warning where a sweep makes full runs because the case has no faster model."""
    if case.sweep.model is not None or sweep_model(case) is not None:
        return None
    return (
        "sweep.model: no model of the case is on the reference points, so that every run of the "
        "sweep is a full one; add {name: fast, evaluation: operators} to rom for runs of "
        "milliseconds, or say model: full"
    )


def sweep_beyond_training(case: Case) -> str | None:
    """Return how many points of a reduced sweep lie outside of the trained range, in words."""
    model, points = sweep_model(case), sweep_points(case)
    beyond = [point for point in points if outside(point, case.plan.train_points)]
    if model is None or not beyond:
        return None
    return (
        f"sweep: {len(beyond)} of {len(points)} points, such as {beyond[0].label}, are outside of "
        f"the trained range: {model.name} extrapolates there"
    )
