"""Flow rates and fields at places in generalized coordinates, projected once.

An interpolation from the reference points is linear in the state, and so is what is measured: the
product of a constant array with the terms z = (1, mean of the density fluctuation that is carried
apart, coordinates). No field is rebuilt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.metrics.measures import Quantities
from sphrom.reduction.forces import N_OTHER_TERMS
from sphrom.reduction.trial_basis import TrialBasis, reconstruct

Array = NDArray[np.float64]
Measuring = Callable[[Array, Array], Mapping[str, Quantities]]
"""From density fluctuation (n_points,) and velocity (n_points, 2), what is measured, by name."""


@dataclass(frozen=True)
class ReducedMeasure:
    """What is multiplied with the terms, by quantity (..., n_terms)."""

    quantities: Quantities

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedMeasure:
        """Return the measurement in the coordinates of some modes, the others zero."""
        kept = np.concatenate((np.arange(N_OTHER_TERMS), N_OTHER_TERMS + modes))
        return ReducedMeasure({name: q[..., kept] for name, q in self.quantities.items()})

    def at(self, coordinates: Array, mean_density_fluctuation: Array | float) -> Quantities:
        """Return what is measured in states, by quantity (n_states, ...).

        Parameters
        ----------
        coordinates : (n_states, n_modes).
        mean_density_fluctuation : (n_states,) or one for all [kg/m3].
        """
        n_states = len(coordinates)
        mean = np.broadcast_to(mean_density_fluctuation, n_states)
        terms = np.column_stack((np.ones(n_states), mean, coordinates))
        return {name: np.tensordot(terms, q, (1, -1)) for name, q in self.quantities.items()}


def project_measures(basis: TrialBasis, measured: Measuring) -> dict[str, ReducedMeasure]:
    """Project what is measured onto a basis; `measured` is linear in its fields."""
    found = [measured(*fields) for fields in _fields(basis)]
    return {
        name: ReducedMeasure(
            {quantity: np.stack([each[name][quantity] for each in found], -1) for quantity in first}
        )
        for name, first in found[0].items()
    }


def _fields(basis: TrialBasis) -> Iterator[tuple[Array, Array]]:
    """Yield density fluctuation [kg/m3] and velocity [m/s] of each term."""
    constant = reconstruct(basis, np.zeros(basis.n_modes))
    yield constant
    yield np.ones_like(constant[0]), np.zeros_like(constant[1])
    scale = basis.inner_product.density_scale
    for density, velocity in zip(basis.density_modes, basis.velocity_modes, strict=True):
        yield density / scale, velocity
