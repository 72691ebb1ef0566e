"""Warnings about a valid case."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from sphrom.case.custom_sections import ShapedFluid
from sphrom.case.discretization_checks import beyond_limits
from sphrom.case.model_sections import AUTO
from sphrom.case.models import Case
from sphrom.case.plan_times import moved_end
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Region, sweep_model, sweep_points
from sphrom.case.tables import MeasuredSection
from sphrom.case.waves import steeper_than_training
from sphrom.metrics.series import shortest_period
from sphrom.sph.fluid import ROUNDING
from sphrom.sph.walls.kinds import KINDS

SNAPSHOTS_PER_MODE = 2
"""Smallest number of snapshots per mode without a warning."""
SNAPSHOTS_PER_PERIOD = 4
"""Least number of snapshots in a period of the driving without a warning."""
ROWS_PER_PERIOD = 4
"""Rows of a measured history in its shortest period, below which this period is noise."""
THICKENED = 4
"""Width in spacings that is recommended for a thin porous body, so that it is resolved."""
MOST_MISSED = 0.02
"""Largest difference of the areas of particles and their shape without a warning, relative to the
area."""
LEAST_STRIP = 20.0
"""Least width of a strip, relative to the spacing; its rate then falls within two spacings."""

NARROW, USUAL, WIDE = 1.8, 2.5, 0.13
"""h/dx below which fluid with a free surface is noisy, above which a kernel is wider than the usual
ones, and h over the flow's length above which such a kernel is too wide. At 20 across, h/dx of 1.2,
1.5, 2, 2.5, 3 and 4 give errors of the pressure of 13, 12, 21, 31, 43 and 84 % (Taylor-Green, Re
100, exact), and of 23, 12, 21, 25, 51 and 85 % (lid, without sound, against 64 across). In a tank
half full, driven at its side (against 50 across), velocities are off by 79, 22, 4.0, 3.7, 5.5 and
9.2 %, pressures without sound by 145, 13, 7.2, 7.1, 11 and 22 %."""


def case_warnings(case: Case) -> list[str]:
    """Return the warnings about a valid case."""
    return [
        *(f"scene.{key}: {reason}" for key, reason in case.scene.warnings()),
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
        *_of_strip(case),
        *_of_discretization(case),
        *_of_porous(case),
        *_of_fields(case),
        *_of_driving(case),
        *_of_histories(case),
        *_of_filling(case),
        *_extrapolations(case, "parameters.test", case.plan.test_points),
        *steeper_than_training(case, "parameters.test", case.plan.test_points),
        *_of_models(case),
        *_of_numerics(case),
    ]


def _of_strip(case: Case) -> Iterator[str]:
    strip = case.plan.strip
    least = LEAST_STRIP * case.plan.particle_spacing
    if strip is not None and (width := strip.end - strip.start) < least * (1.0 - ROUNDING):
        resolution = math.ceil(case.discretization.resolution * least / width)
        yield (
            f"scene.inflow.strip: is {width:.3g} m wide, so its forcing is too steep for the "
            f"particles; use {least:.3g} m, or discretization.resolution: {resolution}"
        )


def _of_discretization(case: Case) -> Iterator[str]:
    plan = case.plan
    ratio = case.discretization.smoothing_length_ratio
    key = "discretization.smoothing_length_ratio"
    scene = case.scene
    length = min(scene.length_scale, *scene.domain.lengths)
    if scene.has_surface and ratio < NARROW:
        yield (
            f"{key}: at h = {ratio:g} dx particles below a free surface are noisy; "
            "velocities of a tank had errors of 79 % at 1.2, 22 % at 1.5 and 4 % at 2 and "
            "2.5; use 2.5"
        )
    if ratio > USUAL and (width := plan.smoothing_length / length) > WIDE:
        resolution = math.ceil(case.discretization.resolution * width / WIDE)
        yield (
            f"{key}: h is {width:.2g} of the flow's length, too wide for an accurate "
            f"pressure: its error was 43 to 52 % at 0.15 and 84 % at 0.2; use {USUAL:g} or "
            "less, or "
            f"discretization.resolution: {resolution}"
        )
    kind = case.discretization.walls.kind
    if scene.free_slip and KINDS[kind].drives_slip:
        yield (
            f"discretization.walls.kind: with slip: free, {kind} leaves the flow along a "
            "wall out of the continuity equation but keeps its pressure, so the fluid gains "
            "energy: water at rest began to move "
            "within ten periods; use adjoint"
        )


def _of_porous(case: Case) -> Iterator[str]:
    spacing = case.plan.particle_spacing
    for name, width in case.scene.porous_widths.items():
        if width < spacing * (1.0 - ROUNDING):
            resolution = math.ceil(case.discretization.resolution * spacing / width)
            yield (
                f"scene.porous.{name}: is {width:.3g} m wide, less than the particle spacing of "
                f"{spacing:.3g} m, so fluid is hardly slowed; make it {THICKENED} spacings wide "
                "and raise its permeability in proportion, or set discretization.resolution: "
                f"{resolution} or more"
            )


def _of_fields(case: Case) -> Iterator[str]:
    spacing = case.plan.particle_spacing
    for key in case.plan.scene.unresolved(spacing):
        yield (
            f"scene.{key}: changes within a particle spacing of {spacing:.3g} m, so "
            "particles miss its peaks or show its waves as longer ones; make it smoother, or raise "
            "discretization.resolution"
        )


def _of_driving(case: Case) -> Iterator[str]:
    period = case.plan.shortest_period
    interval = case.plan.steps.snapshot_interval
    if interval > period / SNAPSHOTS_PER_PERIOD * (1.0 + ROUNDING):
        most = int(period / SNAPSHOTS_PER_PERIOD / case.plan.steps.time_step * (1.0 + ROUNDING))
        yield (
            f"snapshots.every: snapshots {interval:.4g} s apart show the driving, whose period is "
            f"{period:.4g} s, as a slower oscillation; set {max(1, most)}"
        )


def _of_histories(case: Case) -> Iterator[str]:
    plan = case.plan
    histories = getattr(case.scene, "histories", {})
    tables = {name: one for name, one in histories.items() if isinstance(one, MeasuredSection)}
    for name, history in tables.items():
        times = history.rows[0, 1:-1]
        interval = float(np.median(np.diff(times)))
        first, last = times[[0, -1]]
        # The driving may oscillate by other expressions.
        own = shortest_period(lambda t: np.interp(first + t, *history.rows), last - first)  # noqa: B023
        rows = f"scene.histories.{name}: has a row every {interval:.3g} s"
        if ROWS_PER_PERIOD * interval > max(own, plan.shortest_period):
            yield (
                f"{rows}, and changes from row to row like noise, which steps of "
                f"{plan.steps.time_step:.3g} s resolve; filter or average it for longer steps"
            )
        elif interval < plan.steps.time_step * (1.0 - ROUNDING):
            yield (
                f"{rows}, but runs read values only every {plan.steps.time_step:.3g} s; "
                "average its rows, or set time.step"
            )


def _of_filling(case: Case) -> Iterator[str]:
    """Warn if the particles of a fluid with a shape have another area than the shape."""
    fluid = getattr(case.scene, "fluid", None)
    if not isinstance(fluid, ShapedFluid):
        return
    area = fluid.geometry().area
    filled = case.plan.n_particles * case.plan.particle_spacing**2
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
        steps = case.plan.model_steps(model)
        if model.until is not None and (moved := moved_end(steps, model.until)) is not None:
            yield f"rom.{i}.until: {moved}"
        if steps.end_time > trained:
            yield f"rom.{i}.until: {beyond_training(trained)}"
        unseen = [point for point in case.plan.rom_points(model) if point not in case.plan.points]
        yield from _extrapolations(case, f"rom.{i}.parameters", unseen)
        yield from steeper_than_training(case, f"rom.{i}.parameters", unseen, model)
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
    """Return a warning if a point is outside of the training points, else None."""
    where = case.plan.beyond_training(point)
    return where and f"{point.rounded.label} is {where}: a reduced model extrapolates there"


def _of_numerics(case: Case) -> Iterator[str]:
    plan = case.plan
    steps = case.plan.steps
    psi = case.psi
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


def sweep_beyond_training(case: Case) -> Iterator[str]:
    """Yield warnings of a reduced sweep: of points beyond the trained range, and of high waves."""
    model = sweep_model(case)
    points = sweep_points(case)
    if model is not None:
        yield from steeper_than_training(case, "sweep", points, model)
    if model is None:
        return
    where = {point: case.plan.beyond_training(point) for point in points}
    beyond = [point for point in points if where[point] is not None]
    if beyond:
        yield (
            f"sweep: {len(beyond)} of {len(points)} points, such as {beyond[0].rounded.label}, are "
            f"{where[beyond[0]]}: {model.name} extrapolates there"
        )
