"""The model of one stage of training: its errors, estimated anywhere and true at full runs.

Errors are root mean squares over the reference points and the instants that count, over those of
the field [%]: of the velocity, and of the pressure less its mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import trained_at
from sphrom.errors import CaseError
from sphrom.metrics.histories import TIME_TOLERANCE
from sphrom.offline import fit_psi, operators, pod
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    reconstruct,
    weighted_mean,
)
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

MADE_HERE = ("basis", "spline", "b-spline", "operators")
"""Kinds of artifacts that every stage makes anew, in a folder of its own."""
N_BLOCK_SNAPSHOTS = 16
"""Snapshots that are read at once."""
NONE = np.full(2, np.inf)
"""The errors of a run that diverged, and estimates where there are none."""


@dataclass(frozen=True)
class TrueErrors:
    """What a model's run differs from a full run by."""

    error: Array
    """(2,) [%], infinite where the model's run diverged."""
    floor: Array
    """(2,) [%] of the best approximation in the model's basis."""


class StageModel:
    """A model that was trained at some points, whose full runs are mapped."""

    def __init__(
        self,
        context: StageContext,
        model: ReducedModelSection,
        points: Sequence[ParameterPoint],
        folder: Path,
    ) -> None:
        """Make bases, splines and operators where they aren't those of the points."""
        context = replace(
            context,
            case=trained_at(context.case, points),
            force=True,
            keep_valid=True,
            known=KnownArtifacts(),
            folders=dict.fromkeys(MADE_HERE, folder),
            report=context.report.brief(progress=True),
        )
        for stage in (pod, fit_psi, operators):
            stage.run(context)
        self.workspace = Workspace(context)
        self._points = tuple(points)
        self._fast = FastModel(self.workspace, model)

    def estimate(self, point: ParameterPoint) -> Array:
        """Return the estimated errors (2,) of the model at a point, infinite if there are none."""
        run = self._run(point)
        found = None if run is None else run.estimate
        if run is None or found is None or found.errors is None:
            return NONE
        late = self._counted(run.time)
        squares = np.sum(found.errors[late] ** 2, axis=0), np.sum(found.sizes[late] ** 2, axis=0)
        return _percent(*squares)

    def compared(self, point: ParameterPoint) -> TrueErrors:
        """Return the errors of the model at a point whose full run is mapped."""
        run, basis = self._run(point), self._fast.trial_basis(point)
        error, floor, size = np.zeros((3, 2))
        for some, density, velocity in self._snapshots(point):
            mapped = _Fields.of(basis, density, velocity)
            size += mapped.squares
            floor += (_best(basis, density, velocity) - mapped).squares
            if run is not None:
                mean = np.full(len(density), run.reduced.mean_density_fluctuation)
                state = reconstruct(basis, run.coordinates[some], mean)
                error += (_Fields.of(basis, *state) - mapped).squares
        return TrueErrors(NONE if run is None else _percent(error, size), _percent(floor, size))

    def _run(self, point: ParameterPoint) -> FastRun | None:
        """Return the run at a point; None where it diverges or takes steps without end."""
        try:
            run = self._fast.run(point)
        except CaseError:
            return None
        return None if run.failure is not None else run

    def floor(self) -> Array:
        """Return the largest errors (2,) of the best approximations of the training runs."""
        found = []
        for point in self._points:
            basis, floor, size = self._fast.trial_basis(point), np.zeros(2), np.zeros(2)
            for _, density, velocity in self._snapshots(point):
                mapped = _Fields.of(basis, density, velocity)
                size += mapped.squares
                floor += (_best(basis, density, velocity) - mapped).squares
            found.append(_percent(floor, size))
        return np.asarray(np.max(found, axis=0))

    def _counted(self, time: Array) -> NDArray[np.bool_]:
        """Return which instants count, as in a comparison."""
        return time >= self.workspace.case.compare.from_time - TIME_TOLERANCE

    def _snapshots(self, point: ParameterPoint) -> Iterator[tuple[slice, Array, Array]]:
        """Yield the mapped fields of a full run that count, some snapshots at a time."""
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            time = mapped.read("time")
            first = int(np.argmax(self._counted(time)))
            density, velocity = mapped.dataset("density_fluctuation"), mapped.dataset("velocity")
            for begin in range(first, len(time), N_BLOCK_SNAPSHOTS):
                some = slice(begin, min(begin + N_BLOCK_SNAPSHOTS, len(time)))
                yield some, density[some], velocity[some]


@dataclass(frozen=True)
class _Fields:
    """Fields of some snapshots, and the weights of their points."""

    velocity: Array
    """(n_snapshots, n_points, 2)."""
    density: Array
    """(n_snapshots, n_points), less its mean."""
    weights: Array
    """(n_points,)."""

    @classmethod
    def of(cls, basis: TrialBasis, density: Array, velocity: Array) -> _Fields:
        return cls(
            velocity, density - weighted_mean(density, basis.weights)[:, None], basis.weights
        )

    def __sub__(self, other: _Fields) -> _Fields:
        return _Fields(self.velocity - other.velocity, self.density - other.density, self.weights)

    @property
    def squares(self) -> Array:
        """Sums of squares (2,) over points and snapshots."""
        velocity = np.sum(np.sum(self.velocity**2, axis=2) @ self.weights)
        return np.array([velocity, np.sum(self.density**2 @ self.weights)])


def _best(basis: TrialBasis, density: Array, velocity: Array) -> _Fields:
    """Return the best approximation of snapshots in a basis."""
    mean = mean_density_fluctuation(basis, density)
    return _Fields.of(basis, *reconstruct(basis, project(basis, density, velocity), mean))


def _percent(squares: Array, sizes: Array) -> Array:
    """Return roots of sums of squares over those of the fields [%]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = 100.0 * np.sqrt(squares / sizes)
    return np.where(np.isfinite(shares), shares, np.inf)
