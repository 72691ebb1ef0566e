"""How many equal steps a run on the reference points takes: stable ones that are fine enough.

Stability is not accuracy. Sound is what limits the steps of Runge-Kutta's scheme, and at 0.9 of the
limit it halves the amplitude of the fastest sound in every step: pressure is then off by as much as
the model itself, or twice that. Exponential steps have no limit, but are off by what the flow does
meanwhile. Runs are therefore repeated with twice the steps, and steps made smaller until that
changes coordinates by little beside what the basis leaves out of snapshots, which is known from its
singular values and about what models are off by.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial_model import Amplitude, PolynomialModel, Schedule
from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]

STEP_SHARE = 0.05
"""Of what a basis leaves out of snapshots, that steps may be off by. It is a tenth or less of the
error of pressure in all three scenes (M = 5 to 20), and less of velocity's, as sound has as much
energy in one as in the other while velocity's error is the larger."""
LEAST_ERROR = 1e-5
"""Of coordinates, relative to their norm, that is asked for: a basis may leave out nothing."""
ORDER = 4
"""Of Eq. 2.18, and of exponential steps."""
MARGIN = 1.05
"""Over the steps that the order calls for."""
MOST = 1.4
"""Over the steps before, as errors of large steps fall faster than the order says."""
FINEST = 16
"""How much finer than stable steps become at most: what needs more is not for steps to cure."""
LONGER = 6
"""Exponential steps that are tried first, over stable ones: they turn out 1 to 6 times as long."""


def step_tolerance(basis: TrialBasis) -> float:
    """Return how far steps may take coordinates off, in root mean squares over their norm's."""
    n_modes = basis.n_modes // len(basis.singular_values)
    squares = [values**2 for values in basis.singular_values.values()]
    left_out = sum(float(part[n_modes:].sum()) for part in squares)
    share = math.sqrt(left_out / sum(float(part.sum()) for part in squares))
    return max(LEAST_ERROR, STEP_SHARE * share)


def first_exponential(n_stable: int, schedule: Schedule) -> int:
    """Return the exponential steps of a whole run to begin a search with.

    One from snapshot to snapshot is enough where it is something other than sound that is stiff.
    """
    return max(1, min(math.ceil(n_stable / LONGER), schedule.n_snapshots - 1))


def accurate_steps(
    system: PolynomialModel,
    start: Array,
    schedule: Schedule,
    tolerance: float,
    n_first: int,
    amplitude: Amplitude | None = None,
    *,
    n_stable: int = 0,
) -> int:
    """Return the steps of whole runs that are accurate, about the least that are enough.

    Parameters
    ----------
    system : one system, or some that are to take the same steps.
    start : (n_runs, n_modes) coordinates.
    tolerance : see `step_tolerance`; of the run that is off most.
    n_first : the least that are tried.
    n_stable : steps from which divergence isn't theirs.

    Returns
    -------
    For a run that diverges at any step, the first of these numbers; and `FINEST` times `n_first` at
    most.
    """

    def taken(n_steps: int) -> int:
        return system.steps_taken(n_steps, schedule)

    def excess(n_steps: int) -> float:
        """Return the error over what it may be; zero where steps don't cure what diverges."""
        coarse, fine = (
            system.run_in([n] * system.n_runs, start, schedule, amplitude).coordinates
            for n in (n_steps, 2 * n_steps)
        )
        if not np.isfinite(fine).all():
            return 0.0 if n_steps >= n_stable else math.inf
        return max(map(_change, coarse, fine)) / tolerance

    most = taken(FINEST * n_first)
    n_steps, too_few = taken(n_first), 0
    while n_steps < most:
        found = excess(n_steps)
        called_for = taken(math.ceil(n_steps * min(MARGIN * found ** (1.0 / ORDER), MOST)))
        if found <= 1.0:
            # Far from small steps the order calls for more than it takes.
            fewer = taken(max(called_for, too_few + 1, n_first))
            return fewer if fewer < n_steps and 0.0 < excess(fewer) <= 1.0 else n_steps
        n_steps, too_few = called_for, n_steps
    return most


def _change(coarse: Array, fine: Array) -> float:
    """Return what a run is off a finer one, over its norm; infinite if it diverged."""
    if not np.isfinite(coarse).all():
        return math.inf
    size = float(np.linalg.norm(fine))
    return float(np.linalg.norm(fine - coarse)) / size if size > 0.0 else 0.0
