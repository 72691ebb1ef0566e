"""A reduced model on the reference points: its rates as a polynomial, and where its runs start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.correction import faded
from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.measures import ReducedMeasure
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.polynomial_model import Amplitude, OutputTimes, Runs
from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    output_times: OutputTimes
    """The snapshots of a run, and when it counts as divergent."""
    mean_density_fluctuation: float
    """[kg/m3], carried apart."""
    step_limit: float
    """The largest stable Runge-Kutta step [s] around the start and some training states."""
    amplitude: Amplitude | None = None
    """Of the body force or of driven walls, where it changes."""
    memory_length: float | None = None
    """tau of Eq. 3.22 [s], of a model with the closure."""
    linear: Array | None = None
    """(n_modes, n_modes) [1/s] the linear part of exponential steps: the Jacobian at the mean of
    the training states. Without training states it is None, and automatic steps are Runge-Kutta's.
    """
    correction: Array | None = None
    """(n_trained_snapshots, n_modes) added to the coordinates of runs, where the model has one."""
    forces: Mapping[str, ReducedForce] = field(default_factory=dict)
    """By the names of the measurements, the forces on walls."""
    measures: Mapping[str, ReducedMeasure] = field(default_factory=dict)
    """By the names of the measurements, flow rates and fields at places."""

    def corrected(self, runs: Runs) -> Runs:
        """Return its runs with their correction added."""
        added = self.added(len(runs.time))
        return runs if added is None else replace(runs, coordinates=runs.coordinates + added)

    def added(self, n_snapshots: int) -> Array | None:
        """Return what is added to a run's coordinates (n_snapshots, n_modes), if anything is."""
        return None if self.correction is None else faded(self.correction, n_snapshots)
