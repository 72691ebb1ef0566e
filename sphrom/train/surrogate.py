"""The model that a training improves: full runs, the model trained on them, and its errors.

Full runs and maps belong to the case and are kept. Bases, splines and operators are made again for
each set of training points, in a folder of their own, at a small part of the cost of a full run.

Errors are root mean squares over the reference points and the compared times, over those of the
field [%], for the velocity and for the pressure minus its mean. The third error is the largest of
the frequencies and amplitudes of measured oscillations, over their values [%].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import trained_at
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.measures import items, since
from sphrom.metrics.series import OSCILLATION, STEADY
from sphrom.models import fom
from sphrom.models.contract import Measured, ModelRun, model_of
from sphrom.models.stages import OPERATORS, map_runs
from sphrom.setup.context import StageContext
from sphrom.setup.cost import runs_that_fit
from sphrom.store.trajectory import measured_of
from sphrom.store.variants import Variant
from sphrom.store.workers import start_workers
from sphrom.train.outcome import FOLDER, LIMITED, OSCILLATING, HeldOut

MADE_HERE = ("basis", "spline", "b-spline", "operators")
"""Kinds of artifacts that these stages make."""
FIGURES = OSCILLATION[:2]
"""Figures of oscillations with relative errors."""
FIRST = "first full runs"
"""The first part of a training."""
NONE = np.full(len(LIMITED), np.inf)
"""The errors of a diverged run, and missing estimates."""


def part(n_points: int) -> str:
    """Return the name of the part of a training that begins with so many full runs."""
    return f"model of {n_points} full runs"


class Surrogate:
    """A model that is trained on full runs, and on further ones on request."""

    def __init__(
        self,
        context: StageContext,
        section: ReducedModelSection,
        starts: Sequence[ParameterPoint],
    ) -> None:
        """Make the first full runs. Raises UnstableError if one becomes unstable."""
        self._context = context
        self._section = section
        self.points = tuple(starts)
        """The training points."""
        with context.report.stage(FIRST):
            problems = self._full_runs(starts)
        for point, reason in problems.items():
            raise UnstableError(
                f"{point.label}, a corner of the region: the full run became unstable: {reason}; "
                "try a smaller region"
            )

    @property
    def at_once(self) -> int:
        """The number of full runs that can be made at once."""
        context = self._context
        with start_workers(context.workers or 1, context.scheduler, context.report) as workers:
            return workers.number

    def part(self) -> AbstractContextManager[None]:
        """Show in a block that the next part of the training begins."""
        return self._context.report.stage(part(len(self.points)))

    def evaluate(self, candidates: Sequence[ParameterPoint]) -> tuple[Array, Array]:
        """Train the model, and return its errors [%].

        They are the estimates (n_candidates, 3) for the model, and the largest errors (3,) of the
        best approximations of the training runs.
        """
        self._model = StageModel(self._context, self._section, self.points)
        name = f"error of {self._section.name}, {len(self.points)} full runs"
        estimates = []
        with self._context.report.progress(name, len(candidates)) as advance:
            for point in candidates:
                estimates.append(self._model.estimate(point))
                advance(1)
        return np.array(estimates), self._model.floor()

    def extend(self, chosen: Mapping[ParameterPoint, Array]) -> tuple[HeldOut, ...]:
        """Make full runs at points, compare them with the model, and add the stable ones to it.

        `chosen` are the estimates (3,) by point.
        """
        problems = self._full_runs(tuple(chosen))
        held_out = []
        for point, estimate in chosen.items():
            if (problem := problems.get(point)) is None:
                held_out.append(HeldOut(point, estimate, *self._model.compared(point)))
                self.points += (point,)
            else:
                held_out.append(HeldOut(point, estimate, NONE, NONE, problem))
                self._context.report.warn(
                    f"{point.label}: left out, as its full run became unstable: {problem}"
                )
        return tuple(held_out)

    def _full_runs(self, points: Sequence[ParameterPoint]) -> dict[ParameterPoint, str]:
        # The time steps of a full run depend on all points of the case.
        every = tuple(dict.fromkeys((*self.points, *points)))
        variant = Variant(self._context, trained_at(self._context.case, every))
        return make_full_runs(variant, points)

    def share(self) -> list[str]:
        """Make the case's bases, splines and operators for the points, unless some exist.

        Artifacts of other points are kept, and their names are returned, so that the user decides.
        """
        variant = Variant(self._context, trained_at(self._context.case, self.points))
        here = variant.workspace
        existing = (t for t in (here.basis(), here.splines(), here.operators()) if t.path.exists())
        kept = [target.path.name for target in existing if here.reason_to_make(target) is not None]
        if not kept:
            variant.made(OPERATORS)
        return kept


def _largest(errors: Sequence[float], default: float) -> float:
    """Return the largest error; infinite if one is unknown, as of a run of too few periods."""
    return float(np.nan_to_num([*errors] or [default], nan=np.inf, posinf=np.inf).max())


def make_full_runs(variant: Variant, points: Sequence[ParameterPoint]) -> dict[ParameterPoint, str]:
    """Make and map missing full runs at points; return reasons of unstable ones, by point.

    Stopped runs continue from their checkpoints. Without a number of workers, runs use all cores.

    Raises SphromError if a run fails for another reason than instability.
    """
    context = variant.context
    number = context.workers or runs_that_fit(variant.case, "fom")
    problems = fom.run_each(replace(context, workers=number), points)
    stable = tuple(point for point in points if point not in problems)
    map_runs(replace(context, only=stable, workers=None, scheduler=None))
    return problems


class StageModel:
    """A model that is trained at some points with mapped full runs."""

    def __init__(
        self, context: StageContext, model: ReducedModelSection, points: Sequence[ParameterPoint]
    ) -> None:
        """Make the bases, splines and operators for the points, unless they are up to date."""
        case = trained_at(context.case, points)
        variant = Variant(replace(context, force=False), case, FOLDER, only=MADE_HERE)
        self.workspace = variant.made(OPERATORS)
        self._points = points
        self._fast = model_of(self.workspace, model)

    def estimate(self, point: ParameterPoint) -> Array:
        """Return the estimated errors (3,) of the model at a point, infinite if there are none."""
        if (run := self._run(point)) is None or (estimate := run.estimate) is None:
            return NONE
        late = self._counted(run.time)
        of_fields = _percent(
            np.sum(estimate.errors[late] ** 2, axis=0), np.sum(estimate.sizes[late] ** 2, axis=0)
        )
        errors = run.oscillation_errors
        shares = [
            errors[name][figure] / float(figures[figure][0])
            for name, figures in run.oscillations.items()
            for figure in FIGURES
            if name in errors and figure in errors[name]
        ]
        missing = 0.0 if run.regime == STEADY else np.inf
        return np.append(of_fields, 100.0 * _largest(shares, missing))

    def floor(self) -> Array:
        """Return the largest errors (3,) of the best approximations of the training runs."""
        floors = [self.compared(point, approximation=True)[1] for point in self._points]
        return np.asarray(np.max(floors, axis=0))

    def compared(
        self, point: ParameterPoint, *, approximation: bool = False
    ) -> tuple[Array, Array]:
        """Return the errors at a point with a mapped full run, of the model and of its basis.

        The errors (3,) [%] of the model's run are infinite if it diverged. Those of the basis are
        of the best approximation; with `approximation`, only these are computed.
        """
        run = None if approximation else self._run(point)
        compared = self._fast.family.part("compared")
        error, floor, size, nearest = compared(self._fast, point, run, self._counted)
        found = NONE if run is None else np.append(_percent(error, size), np.inf)
        least = np.append(_percent(floor, size), np.inf)
        if self.workspace.case.training.quantity != OSCILLATING:
            return found, least
        with self.workspace.open(self.workspace.full_run(point)) as full:
            time = full.read("time")
            recorded = measured_of(self.workspace.case, full)
        counted = np.flatnonzero(self._counted(time))
        least[-1] = self._oscillation_error(time[counted], nearest(), items(recorded, counted))
        if run is not None:
            found[-1] = self._oscillation_error(time, run.measured, recorded)
        return found, least

    def _oscillation_error(self, time: Array, own: Measured, full: Measured) -> float:
        """Return the largest relative error of frequencies and amplitudes [%]."""
        errors = [
            each.of(time, own[each.measure], full[each.measure]).get(f"{figure}_error", np.inf)
            for each in self.workspace.case.plan.oscillations.values()
            for figure in FIGURES
        ]
        return _largest(errors, np.inf)

    def _run(self, point: ParameterPoint) -> ModelRun | None:
        """Return the run at a point; None if it diverges or needs too many steps."""
        try:
            run = self._fast.run(point)
        except CaseError:
            return None
        return None if run.failure is not None else run

    def _counted(self, time: Array) -> Mask:
        """Return the mask of the compared times."""
        return since(time, self.workspace.case.compare.from_time)


def _percent(squares: Array, sizes: Array) -> Array:
    """Return the relative errors [%] from sums of squares of errors and of fields."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = 100.0 * np.sqrt(squares / sizes)
    return np.where(np.isfinite(shares), shares, np.inf)
