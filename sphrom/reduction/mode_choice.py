"""How many modes a model has, and how many of them it integrates, by errors of runs held out.

From some number of modes on, the coordinates that a model integrates may be as wrong as they are
large, and more of them make the others worse. A model of M modes can therefore integrate its first
m alone; training runs predict the others, and correct the first (`sphrom.reduction.correction`).

Each training run is predicted with corrections from the others. Its error counts as a share of its
own size, in velocity and in c0 rho'/rho0 less its mean; the mean square over the runs gives two
errors, and the least product of both decides. The basis stays that of all runs.

- For each M the number m is chosen with the model as it is, calibrated on all runs.
- M is chosen with models that are calibrated without the run that they predict. Otherwise more
  modes would seem better the more closely they can be fitted. A single run can't be held out: its
  own errors count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.correction import learn_correction
from sphrom.reduction.error_calibration import FieldProducts
from sphrom.reduction.trial_basis import first_of_parts

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DIVERGED = 1e6
"""Error over the size of a run that has none, because a run diverged."""


@dataclass(frozen=True)
class TrainedSizes:
    """Training runs, in all modes, and what their errors follow from."""

    places: Array
    """(n_runs, n_parameters), in which distances count alike."""
    projected: Array
    """(n_runs, n_snapshots, n_all_modes) the full runs' coordinates."""
    products: FieldProducts
    compared: Indices
    """(n_compared,) the snapshots of the products."""
    n_parts: int = 1
    """Parts of the basis, of as many modes each."""

    @property
    def largest(self) -> int:
        """The largest number of modes, of each part."""
        return self.projected.shape[2] // self.n_parts

    def modes(self, n_modes: int) -> Indices:
        """Return which modes are the first of each part."""
        return first_of_parts(self.n_parts, self.largest, n_modes)

    def errors(self, n_modes: int, integrated: Array) -> Array:
        """Return root mean squares (2,) over the runs of `error_squares`."""
        return np.asarray(np.sqrt(np.mean(self.error_squares(n_modes, integrated), axis=0)))

    def error_squares(self, n_modes: int, integrated: Array) -> Array:
        """Return mean square errors (n_runs, 2) of runs held out, over those of their sizes.

        Parameters
        ----------
        n_modes : of the model.
        integrated : (n_runs, n_snapshots, n_integrated) the model's runs, in its first modes.
        """
        n_runs, projected = len(self.places), self.projected[..., self.modes(n_modes)]
        n_first = integrated.shape[2] // self.n_parts
        first = first_of_parts(self.n_parts, n_modes, n_first)
        if not np.isfinite(integrated).all():
            return np.full((n_runs, 2), DIVERGED**2)
        runs = np.zeros_like(projected)
        runs[..., first] = integrated
        groups = (first, np.setdiff1d(np.arange(projected.shape[2]), first))
        correction = learn_correction(self.places, projected - runs, groups)
        if correction is not None:
            runs = runs + [correction.held_out(place) for place in self.places]
        products = self.products.only(self.modes(n_modes), self.projected.shape[2])
        errors = [products.errors(k, run[self.compared]) for k, run in enumerate(runs)]
        squares = np.mean(np.square(errors), axis=1) / np.mean(self.products.squares, axis=1)
        return np.asarray(np.minimum(squares, DIVERGED**2))


def best_size(errors: Array) -> int:
    """Return which of some errors (n, 2) have the least product over the fields, from 1.

    The last of those that are equal.
    """
    products = np.prod(errors, axis=1)
    return len(products) - int(np.argmin(products[::-1]))


def choose_integrated(sizes: TrainedSizes, runs: Sequence[Array]) -> Indices:
    """Return how many modes (n_sizes,) to integrate of models with 1, 2, ... modes.

    Parameters
    ----------
    runs : of models that integrate 1, 2, ... modes (n_runs, n_snapshots, n_integrated), at the
        training points.
    """
    if len(sizes.places) < 2:
        return np.arange(1, sizes.largest + 1)
    chosen = [
        best_size(np.array([sizes.errors(n_modes, run) for run in runs[:n_modes]]))
        for n_modes in range(1, sizes.largest + 1)
    ]
    return np.array(chosen)


def held_out_errors(sizes: TrainedSizes, n_modes: int, runs: Sequence[Array]) -> Array:
    """Return errors (2,) of models whose rates know nothing of the runs they predict.

    Parameters
    ----------
    runs : for each training run those of a model calibrated without it, at all training points.
    """
    squares = [sizes.error_squares(n_modes, run)[k] for k, run in enumerate(runs)]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))
