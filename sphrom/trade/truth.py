"""References of runs at extremes: full runs, and the nearest states in a basis."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.case.discretization_checks import coarser_resolution
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import changed
from sphrom.errors import CaseError, ResourceError
from sphrom.metrics.histories import relative_l2, without_mean
from sphrom.metrics.measures import Samples
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.stored_run import StoredRun
from sphrom.setup.context import StageContext
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.candidates import extreme, make_runs, of_full_model, variant_of
from sphrom.trade.stability import Errors, ExtremeRun

SPARSER = 10
"""A longer full run keeps one in at most so many snapshots, and at least so many per part."""


@dataclass(frozen=True)
class Truth:
    """A full run to compare with."""

    samples: Samples
    """Fields at the points where runs are compared."""
    snapshots: Indices
    """Indices of the same snapshots in a reduced run."""

    def within(self, first: float, last: float) -> Truth:
        """Return the part between two snapshots of a reduced run."""
        kept = np.flatnonzero((self.snapshots >= first) & (self.snapshots <= last))
        return Truth(self.samples.at(kept), self.snapshots[kept])


class Truths:
    """The full runs to compare with; missing ones are made."""

    def __init__(self, context: StageContext, grid: Array) -> None:
        self._context = context
        self._case = context.case
        self._grid = grid
        self.notes: list[str] = []
        """Reasons why there are no runs."""
        self.at = cache(self._at)

    def _at(
        self, point: ParameterPoint, until: float = 1.0, *, coarse: bool = False
    ) -> Truth | None:
        """Return a full run `until` times as long, if `coarse` at half resolution, or None."""
        case = self._case
        if point in case.plan.points and until == 1.0 and not coarse:
            return self.of(Workspace(self._context), point)
        resolution = coarser_resolution(case) if coarse else case.discretization.resolution
        if not case.trade.full_runs or resolution is None:
            return None
        other = of_full_model(case, (point,))
        steps = case.plan.steps
        stride = 1
        if until > 1.0:
            stride = max(1, min(SPARSER, (steps.n_snapshots - 1) // SPARSER))
            end = case.time.spin_up + until * case.plan.recorded_time
            other = changed(other, time={"final_time": end})
            steps = replace(steps, every=stride * steps.every)
        other = extreme(other, f"{point.file_label}-{exact(until)}", resolution, steps)
        variant = variant_of(self._context, other)
        try:
            unstable = make_runs(variant, other.name, [point])
        except (CaseError, ResourceError) as error:
            self.notes.append(f"{other.name}, refused: {error}")
            return None
        return None if unstable else self.of(variant.workspace, point, stride)

    def of(self, workspace: Workspace, point: ParameterPoint, stride: int = 1) -> Truth:
        """Return an existing full run, with one in `stride` snapshots of reduced runs."""
        with StoredRun.opened(workspace, point) as stored:
            samples = stored.sampled(self._grid)
        truth = Truth(samples, stride * np.arange(len(samples.time), dtype=np.int64))
        steps = self._case.plan.steps
        since = (self._case.compare.from_time - steps.start_time) / steps.snapshot_interval
        return truth.within(since - 1e-6, np.inf)


class GridModes:
    """The modes of a model at the points where runs are compared."""

    def __init__(self, basis: BasisModel, grid: Array) -> None:
        self._values = basis.values(grid).reshape(len(grid), -1, 3)
        self._product = basis.basis.inner_product
        self._sound_speed = basis.workspace.case.plan.sound_speed
        # Pressures are compared without their means.
        constant = np.tile([1.0, 0.0, 0.0], len(grid))[:, None]
        columns = self._values.transpose(0, 2, 1).reshape(len(constant), -1)
        self._inverse = np.linalg.pinv(np.hstack((columns, constant)))[:-1]

    def samples(self, coordinates: Array) -> Samples:
        """Return the fields of states (n_snapshots, n_modes), with placeholder times."""
        fields = np.tensordot(coordinates, self._values, (1, 1))
        density = self._product.density_fluctuation(fields[..., 0])
        times = np.arange(len(fields), dtype=np.float64)
        return Samples(times, fields[..., 1:], pressure_of(density, self._sound_speed))

    def nearest(self, full: Samples) -> Samples:
        """Return the states in the basis that are nearest to those of a full run at the points."""
        first = self._product.first_field(fluctuation_of(full.pressure, self._sound_speed))
        states = np.concatenate((first[..., None], full.velocity), axis=2)
        return self.samples(states.reshape(len(states), -1) @ self._inverse.T)


def compared(
    row: ExtremeRun, samples: Samples, full: Samples, best: Samples | None = None
) -> ExtremeRun:
    """Set the errors of a run, and of the nearest states in its basis; none for fluid at rest."""
    with suppress(ValueError):
        row.velocity_error, row.pressure_error = _errors_of(samples, full)
        if best is not None:
            row.velocity_best, row.pressure_best = _errors_of(best, full)
    return row


def _errors_of(run: Samples, full: Samples) -> Errors:
    """Return the relative L2 errors [%] of the velocity, and of the pressure minus its mean."""
    pressures = (without_mean(samples.pressure)[..., None] for samples in (run, full))
    velocity = float(relative_l2(run.velocity, full.velocity, field_axes=3))
    return velocity, float(relative_l2(*pressures, field_axes=3))
