"""The model of one stage of training: its errors, estimated anywhere and true at full runs.

Errors are root mean squares over the reference points and the instants that count, over those of
the field [%]: of the velocity, and of the pressure less its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
        self._points, self._fast = points, FastModel(self.workspace, model)

    def estimate(self, point: ParameterPoint) -> Array:
        """Return the estimated errors (2,) of the model at a point, infinite if there are none."""
        run = self._run(point)
        found = None if run is None else run.estimate
        if run is None or found is None:
            return NONE
        late = self._counted(run.time)
        squares = np.sum(found.errors[late] ** 2, axis=0), np.sum(found.sizes[late] ** 2, axis=0)
        return _percent(*squares)

    def compared(self, point: ParameterPoint) -> tuple[Array, Array]:
        """Return the errors of the model at a point whose full run is mapped.

        They are (2,) [%]: of the model's run, infinite where it diverged, and of the best
        approximation in its basis.
        """
        return self._errors(point, self._run(point))

    def floor(self) -> Array:
        """Return the largest errors (2,) of the best approximations of the training runs."""
        return np.asarray(np.max([self._errors(p, None)[1] for p in self._points], axis=0))

    def _errors(self, point: ParameterPoint, run: FastRun | None) -> tuple[Array, Array]:
        basis = self._fast.at_point(point).basis
        error, floor, size = np.zeros((3, 2))
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            counted = np.flatnonzero(self._counted(mapped.read("time")))
            densities, velocities = (
                mapped.dataset("density_fluctuation"),
                mapped.dataset("velocity"),
            )
            for begin in range(counted[0], counted[-1] + 1, N_BLOCK_SNAPSHOTS):
                some = slice(begin, min(begin + N_BLOCK_SNAPSHOTS, counted[-1] + 1))
                density, velocity = densities[some], velocities[some]
                fields = _fields(basis, density, velocity)
                size += _squares(basis, *fields)
                mean = mean_density_fluctuation(basis, density)
                best = reconstruct(basis, project(basis, density, velocity), mean)
                floor += _distance(basis, _fields(basis, *best), fields)
                if run is not None:
                    mean = np.full(len(density), run.reduced.mean_density_fluctuation)
                    state = reconstruct(basis, run.coordinates[some], mean)
                    error += _distance(basis, _fields(basis, *state), fields)
        return NONE if run is None else _percent(error, size), _percent(floor, size)

    def _run(self, point: ParameterPoint) -> FastRun | None:
        """Return the run at a point; None where it diverges or takes steps without end."""
        try:
            run = self._fast.run(point)
        except CaseError:
            return None
        return None if run.failure is not None else run

    def _counted(self, time: Array) -> NDArray[np.bool_]:
        """Return which instants count, as in a comparison."""
        return time >= self.workspace.case.compare.from_time - TIME_TOLERANCE


def _fields(basis: TrialBasis, density: Array, velocity: Array) -> tuple[Array, Array]:
    """Return velocities (n_snapshots, n_points, 2), and densities less their means."""
    return velocity, density - weighted_mean(density, basis.weights)[:, None]


def _squares(basis: TrialBasis, velocity: Array, density: Array) -> Array:
    """Return sums of squares (2,) over points and snapshots."""
    of_velocity = np.sum(np.sum(velocity**2, axis=2) @ basis.weights)
    return np.array([of_velocity, np.sum(density**2 @ basis.weights)])


def _distance(basis: TrialBasis, fields: tuple[Array, Array], others: tuple[Array, Array]) -> Array:
    """Return sums of squares (2,) of how far fields are from others."""
    return _squares(basis, *(a - b for a, b in zip(fields, others, strict=True)))


def _percent(squares: Array, sizes: Array) -> Array:
    """Return roots of sums of squares over those of the fields [%]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = 100.0 * np.sqrt(squares / sizes)
    return np.where(np.isfinite(shares), shares, np.inf)
