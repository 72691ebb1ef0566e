"""How many equal steps a run on the reference points takes: stable ones that are fine enough.

Stability is not accuracy. Sound is what limits the steps of Runge-Kutta's scheme, and at 0.9 of the
limit it halves the amplitude of the fastest sound in every step: pressure is then off by as much as
the model itself, or twice that. Exponential steps have no limit, but an error from the change of
the flow within a step. Runs are therefore repeated with twice the steps, and steps made smaller
until coordinates change by little beside the truncation error of the basis, which its singular
values give and which is about the error of models.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial_model import Amplitude, OutputTimes, PolynomialModel
from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]

STEP_SHARE = 0.05
"""Largest error of steps over the truncation error of the basis. It is a tenth or less of the
error of pressure in all three scenes (M = 5 to 20), and less of velocity's, as sound has as much
energy in one as in the other while velocity's error is the larger."""
LEAST_ERROR = 1e-5
"""Of coordinates, relative to their norm, that is asked for: a basis may leave out nothing."""
ORDER = 4
"""Of Eq. 2.18, and of exponential steps."""
MARGIN = 1.05
"""Factor over the number of steps that the order predicts."""
MOST = 1.4
"""Largest factor between two trials: errors of large steps fall faster than the order predicts."""
FINEST = 16
"""Largest refinement of stable steps: finer ones don't help."""
LONGER = 6
"""Exponential steps that are tried first, over stable ones: they turn out 1 to 6 times as long."""


def step_tolerance(basis: TrialBasis) -> float:
    """Return the largest error of coordinates by steps, in root mean squares over their norm."""
    n_modes = basis.n_modes // len(basis.singular_values)
    squares = [values**2 for values in basis.singular_values.values()]
    left_out = sum(float(part[n_modes:].sum()) for part in squares)
    share = math.sqrt(left_out / sum(float(part.sum()) for part in squares))
    return max(LEAST_ERROR, STEP_SHARE * share)


def first_exponential(n_stable: int, output_times: OutputTimes) -> int:
    """Return the exponential steps of a whole run to begin a search with.

    One from snapshot to snapshot is enough where it is something other than sound that is stiff.
    """
    return max(1, min(math.ceil(n_stable / LONGER), output_times.n_snapshots - 1))


def accurate_steps(
    system: PolynomialModel,
    start: Array,
    output_times: OutputTimes,
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
    n_first : the least number that is tried.
    n_stable : number of steps from which a divergence is the model's, not the integrator's.

    Returns
    -------
    For a run that diverges at any step, the first of these numbers; and `FINEST` times `n_first` at
    most.
    """

    def taken(n_steps: int) -> int:
        return system.steps_taken(n_steps, output_times)

    def excess(n_steps: int) -> float:
        """Return the error over the tolerance; zero if the divergence is not the steps' fault."""
        coarse, fine = (
            system.run_in([n] * system.n_runs, start, output_times, amplitude).coordinates
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
    """Return the distance of a run from a finer one, over its norm; infinite if it diverged."""
    if not np.isfinite(coarse).all():
        return math.inf
    size = float(np.linalg.norm(fine))
    return float(np.linalg.norm(fine - coarse)) / size if size > 0.0 else 0.0
