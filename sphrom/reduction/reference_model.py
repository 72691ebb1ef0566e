"""A reduced model on the reference points: its rates as a polynomial, and where its runs start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.correction import faded
from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.measures import ReducedMeasure
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.polynomial_model import Amplitude, OutputTimes
from sphrom.reduction.trial_basis import TrialBasis, kept_modes

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
    leading: ReferenceModel | None = None
    """The model of the first modes that alone is integrated as long as training runs are; the
    correction is the whole of the others' coordinates. None where all modes are integrated."""
    forces: Mapping[str, ReducedForce] = field(default_factory=dict)
    """By the names of the measurements, the forces on walls."""
    measures: Mapping[str, ReducedMeasure] = field(default_factory=dict)
    """By the names of the measurements, flow rates and fields at places."""

    @property
    def n_integrated(self) -> int:
        """Number of modes that are integrated, as long as training runs are."""
        return len(self.start) if self.leading is None else len(self.leading.start)

    def with_leading(self, leading: ReferenceModel | None) -> ReferenceModel:
        """Return the model that integrates the leading modes alone, all of them with None.

        Its steps are as fine as the basis of all modes calls for.
        """
        leading = None if leading is None else replace(leading, basis=self.basis)
        return replace(self, leading=leading)

    @property
    def linear_parts(self) -> tuple[Array | None, Array | None]:
        """The linear parts of exponential steps: of all modes, and of the leading ones."""
        return self.linear, None if self.leading is None else self.leading.linear

    def with_linear_parts(self, parts: Sequence[Array | None]) -> ReferenceModel:
        """Return the model with other such parts."""
        leading = None if self.leading is None else replace(self.leading, linear=parts[1])
        return replace(self, linear=parts[0], leading=leading)

    def in_training(self, n_snapshots: int) -> int:
        """Return how many snapshots of a run are not after the training runs' last."""
        return n_snapshots if self.correction is None else min(n_snapshots, len(self.correction))

    def spread(self, leading: Array) -> Array:
        """Return coordinates (..., n_modes) of which the leading ones alone are not zero."""
        n_parts = len(self.basis.singular_values)
        out = np.zeros((*leading.shape[:-1], self.basis.n_modes))
        out[..., kept_modes(self.basis, leading.shape[-1] // n_parts)] = leading
        return out

    def completed(
        self, leading: Array | None, whole: Array | None, correction: Array | None
    ) -> tuple[Array, Array | None]:
        """Return coordinates (..., n_snapshots, n_modes), and what of them is the correction.

        Linear in all of them: derivatives by a parameter follow from their own.

        Parameters
        ----------
        leading : those integrated in the leading modes, as long as training runs are.
        whole : those integrated in all modes; None where the leading modes are enough.
        correction : (n_trained_snapshots, n_modes).
        """
        if correction is not None and leading is not None:
            spread = self.spread(leading)
            if whole is None:
                added = correction[..., : spread.shape[-2], :]
                return spread + added, added
            n_trained = correction.shape[-2]
            correction = spread + correction - whole[..., :n_trained, :]
        assert whole is not None
        if correction is None:
            return whole, None
        added = faded(correction, whole.shape[-2])
        return whole + added, added
