"""What a user should know about a valid case, though nothing refuses it."""

from __future__ import annotations

from collections.abc import Iterator

from sphrom.case.checks import beyond_limits
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint, outside
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.text import exact

SNAPSHOTS_PER_MODE = 2
"""Fewer snapshots are few for so many modes."""


def case_warnings(case: Case) -> list[str]:
    """Return what a user should know about a valid case."""
    return [
        *(f"scene.{key}: {reason}" for key, reason in case.scene.warnings()),
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
        *_outside_training(case),
        *_beyond_training(case),
        *_without_spin_up(case),
        *_sound_not_skew(case),
        *_end_not_kept(case),
        *_polynomial_too_low(case),
    ]


def _outside_training(case: Case) -> Iterator[str]:
    for point in case.plan.test_points:
        if (warning := extrapolation(case, point)) is not None:
            yield f"parameters.test: {warning}"
    for i, model in enumerate(case.rom):
        for point in _unseen(case, model):
            if (warning := extrapolation(case, point)) is not None:
                yield f"rom.{i}.parameters: {warning}"


def _beyond_training(case: Case) -> Iterator[str]:
    trained = case.plan.steps.end_time
    for i, model in enumerate(case.rom):
        if case.plan.model_steps(model).end_time > trained:
            yield f"rom.{i}.until: {beyond_training(trained)}"


def beyond_training(trained_until: float) -> str:
    """Return a warning for a run that goes on after the trained time [s]."""
    return f"after {trained_until:g} s the run is beyond the trained time"


def extrapolation(case: Case, point: ParameterPoint) -> str | None:
    """Return a warning where a point is outside of the trained range, else None."""
    beyond = outside(point, case.plan.train_points)
    if not beyond:
        return None
    ranges = " and ".join(
        each if name == REYNOLDS and not point.others else f"{each} of {name}"
        for name, each in beyond.items()
    )
    return (
        f"{point.label} is outside of the trained range, {ranges}: a reduced model extrapolates "
        "there"
    )


def _unseen(case: Case, model: ReducedModelSection) -> list[ParameterPoint]:
    """Return the points of a model at which there is no full run."""
    return [point for point in case.plan.rom_points(model) if point not in case.plan.points]


def _without_spin_up(case: Case) -> Iterator[str]:
    for i, model in enumerate(case.rom):
        for point in _unseen(case, model):
            start = case.plan.start_point(point)
            if start != point:
                yield (
                    f"rom.{i}.parameters: {point.label} has no spin-up: its run starts from the "
                    f"end of that at {start.label}, the nearest trained"
                )


def _sound_not_skew(case: Case) -> Iterator[str]:
    if case.plan.reference_bases and case.basis.inner_product == "raw":
        yield (
            "basis.inner_product: in the raw product operators on the reference points let sound "
            "grow; in the acoustic one they can't"
        )


def _end_not_kept(case: Case) -> Iterator[str]:
    steps = case.plan.steps
    if steps.n_steps % steps.every:
        last = f"the last snapshot is at {steps.end_time:g} s"
        yield f"snapshots.every: {last}, before time.final_time"


def few_snapshots(case: Case) -> Iterator[str]:
    """Warn where a basis keeps most of what its snapshots hold: the last modes are their noise."""
    needed = max((model.size for model in case.rom if model.n_modes != AUTO), default=0)
    for name in dict.fromkeys(name for m in case.rom for name in case.plan.bases_for(m)):
        number = case.plan.n_basis_snapshots(name)
        if number < SNAPSHOTS_PER_MODE * needed:
            yield (
                f"snapshots.every: {needed} modes from {number} snapshots (basis {name}): the last "
                f"modes fit what is particular to these snapshots; keep {SNAPSHOTS_PER_MODE} a "
                "mode or more, with a lower snapshots.every, or ask for fewer modes"
            )


def _polynomial_too_low(case: Case) -> Iterator[str]:
    if case.plan.lattice_splines:
        return
    order, degree = case.psi.order, case.psi.polynomial_degree
    least = (order - 1) // 2 if order % 2 else order // 2
    if degree < least:
        yield (
            f"psi.polynomial_degree: splines of order {order} are sure to exist from degree "
            f"{least} on; got {degree}"
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
    """Return which points of a reduced sweep lie outside of the trained range, in words."""
    model = sweep_model(case)
    if model is None:
        return None
    points, trained = sweep_points(case), case.plan.train_points
    beyond = [point for point in points if outside(point, trained)]
    if not beyond:
        return None
    if len(case.plan.parameter_names) > 1:
        return (
            f"sweep: {len(beyond)} of {len(points)} points, such as {beyond[0].label}, are outside "
            f"of the trained ranges: {model.name} extrapolates there"
        )
    low, high = min(trained).reynolds, max(trained).reynolds
    first, last = min(beyond).label, max(beyond).label
    which = first if first == last else f"from {first} to {last}"
    return (
        f"sweep.reynolds: {len(beyond)} of {len(points)} values ({which}) are outside of the "
        f"trained range, {exact(low)} to {exact(high)}: {model.name} extrapolates there"
    )
