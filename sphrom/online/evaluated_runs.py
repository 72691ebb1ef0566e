"""Runs whose rates are evaluated anew at all points of the reference space."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.offline.operators import fixed_points
from sphrom.reduction.evaluated_run import Drive, Rates, integrate
from sphrom.reduction.operators import UnprojectedModel
from sphrom.reduction.polynomial_model import Amplitude, Runs, Schedule
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.store.splines import read_model_splines
from sphrom.store.workspace import Workspace

SHORT, MOST_TIMED = 1.0, 5
"""Runs are repeated for their timing within so many seconds, so many times at most."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """How the rates of a run are evaluated."""

    rates: Rates
    drive: Drive


def evaluation(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    basis: TrialBasis,
    amplitude: Amplitude | None,
) -> Evaluation | None:
    """Return the rates at all points for a model that asks for them, else None.

    Parameters
    ----------
    basis : of the model's modes alone.
    amplitude : of what drives the flow over time, where that changes.
    """
    if model.evaluation != "points":
        return None
    case, splines = workspace.case, None
    if case.operators.advection == "spline":
        splines = read_model_splines(workspace, case.basis_for(model, point), model.n_modes)
    drive = Drive(case.kinematic_viscosity(point))
    if amplitude is not None:
        drive = Drive(drive.kinematic_viscosity, lambda at: float(amplitude(np.array([at]))[0]))
    return Evaluation(UnprojectedModel(fixed_points(workspace), basis, splines), drive)


def timed(
    evaluated: Evaluation,
    start: Array,
    schedule: Schedule,
    steps_per_snapshot: int,
    advance: Callable[[int], None],
) -> tuple[Runs, float]:
    """Run from coordinates (n_modes,), and return what it took [s].

    A short run is repeated, and the least counts: other programs disturb some.
    """
    rates, drive = evaluated.rates, evaluated.drive
    seconds: list[float] = []
    while not seconds or (sum(seconds) < SHORT and len(seconds) < MOST_TIMED):
        began = time.perf_counter()
        tell = (lambda done: None) if seconds else advance
        runs = integrate(rates, start, schedule, steps_per_snapshot, drive, tell)
        seconds.append(time.perf_counter() - began)
    return runs, min(seconds)
