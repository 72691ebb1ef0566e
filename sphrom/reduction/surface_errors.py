"""Estimates of the errors of models with a free surface, from errors in training runs.

Errors grow with the waves. With A the amplitude of the waves (`amplitude`), the error of a quantity
at the time t of a run is estimated as

    error(t) = s max(A(t), A_0) max(1, t/T),    s^2 = r^2 + (d/D)^2 max(0, h^2 - r^2)

where T is the length of training runs, and A_0 the least root mean square of A in one of them, as
the noise of particles does not vanish with the waves. r is the error over the amplitude, both root
mean squares, in repeated training runs, and h that in training runs which models of the others
predict. Amplitudes of runs nearly at rest count as a tenth of the largest one. d is the distance of
the parameters from the nearest training run, and D the mean distance of training runs from their
nearest ones. Beyond the trained time phases drift.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Record, dataset, labelled, part
from sphrom.metrics.quantities import IN_FLUID, OF_WALLS, stored
from sphrom.reduction.correction import PLACES

LEAST_AMPLITUDE = 0.1
"""Least amplitude that is divided by, relative to the largest one of the training runs."""


class RunMeasure(Record):
    """The errors of a measurement in training runs."""

    quantities: Mapping[str, Array] = stored(
        (*OF_WALLS, *IN_FLUID), "run snapshot", meaning="full run minus the model: {}"
    )


class RunErrors(Record):
    """The errors of models in completed training runs."""

    places: Array = labelled("run parameter", PLACES)
    amplitude: Array = dataset("run snapshot", "m", "amplitude of the model's waves", "A")
    fields: Array = dataset(
        "run snapshot field", "m/s, Pa", "root mean square errors of velocity and pressure"
    )
    sizes: Array = dataset(
        "run snapshot field", "m/s, Pa", "root mean squares of the fields in full runs"
    )
    measure: Mapping[str, RunMeasure] = part(default_factory=dict)


class SurfaceErrors(Record):
    """The errors of a model, and of models of all training runs but one."""

    repeated: RunErrors = part()
    held_out: RunErrors = part()

    def at(self, place: Array) -> Callable[[Callable[[RunErrors], Array]], Array]:
        """Return a function that gives errors over the amplitude (...) at a place (n_parameters,).

        Its argument is a function that selects errors (n_runs, n_snapshots, ...) of the runs.
        """
        places = self.repeated.places
        between = np.linalg.norm(places[:, None] - places, axis=2)
        apart = float(np.min(between + np.diag(np.full(len(places), np.inf)), axis=1).mean())
        share = (float(np.linalg.norm(places - place, axis=1).min()) / apart) ** 2

        def over_amplitude(of: Callable[[RunErrors], Array]) -> Array:
            squares = []
            for runs in (self.repeated, self.held_out):
                errors = np.sum(of(runs) ** 2, axis=1)
                sizes = _floored(np.sum(runs.amplitude**2, axis=1))
                squares.append(np.mean((errors.T / sizes).T, axis=0))
            near, far = squares
            return np.asarray(np.sqrt(near + share * np.maximum(far - near, 0.0)))

        return over_amplitude

    def waves(self, amplitude: Array) -> Array:
        """Return the amplitude (n_snapshots,) [m] of a run, or the least one in training."""
        trained = _floored(np.mean(self.repeated.amplitude**2, axis=1))
        return np.asarray(np.maximum(amplitude, np.sqrt(trained.min())))

    def scale(self, amplitude: Array) -> Array:
        """Return the factor (n_snapshots,) [m] of errors over the amplitude along a run."""
        n_trained = self.repeated.amplitude.shape[1]
        elapsed = np.arange(len(amplitude)) / (n_trained - 1)
        return self.waves(amplitude) * np.maximum(1.0, elapsed)


def _floored(squares: Array) -> Array:
    """Return mean squares of amplitudes (n_runs,) without those nearly at rest."""
    return np.asarray(np.maximum(squares, LEAST_AMPLITUDE**2 * squares.max()))
