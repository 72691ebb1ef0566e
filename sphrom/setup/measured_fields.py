"""Fields of particles at places: by moving least squares, as accurate as can be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.errors import UnstableError
from sphrom.metrics.measures import FieldMeasure, Quantities
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.setup.assembly import field_measures
from sphrom.sph import state_equation

Array = NDArray[np.float64]

SAMPLING_RATIO = 2.0
"""Smoothing length of the moving least squares that sample particles, over the spacing."""


def sampler(case: Case, points: Array) -> ReferenceMap:
    """Return the interpolation that samples particles at points (n_points, 2) [m].

    It is the accurate one, whatever the case maps with.
    """
    return ReferenceMap(
        points,
        case.scene.domain,
        particle_spacing=case.plan.particle_spacing,
        smoothing_length=SAMPLING_RATIO * case.plan.particle_spacing,
    )


class MeasuredFields:
    """Fields of particles, interpolated to where they are measured."""

    def __init__(
        self, measures: Mapping[str, FieldMeasure], sample: ReferenceMap, sound_speed: float
    ) -> None:
        self.measures = measures
        self._sample = sample
        self._sound_speed = sound_speed

    @classmethod
    def of(cls, case: Case) -> MeasuredFields | None:
        """Return the measured fields of a case, None where it measures none."""
        measures = field_measures(case)
        if not measures:
            return None
        places = np.concatenate([measure.position for measure in measures.values()])
        return cls(measures, sampler(case, places), case.plan.sound_speed)

    def __call__(
        self, position: Array, density_fluctuation: Array, velocity: Array
    ) -> dict[str, Quantities]:
        """Return by name what is measured of particles (n_particles[, 2]).

        Raises UnstableError where too few particles are near a place.
        """
        try:
            density, found = self._sample(position, density_fluctuation, velocity)
        except ValueError as error:
            raise UnstableError(f"unstable where fields are measured: {error}") from error
        return self._split(found, state_equation.pressure(density, self._sound_speed))

    def _split(self, velocity: Array, pressure: Array) -> dict[str, Quantities]:
        """Return by name what is measured of fields (n_places[, 2]) at all places."""
        ends = np.cumsum([len(measure.position) for measure in self.measures.values()])
        parts = zip(*(np.split(each, ends[:-1]) for each in (velocity, pressure)), strict=True)
        return {
            name: measure.of(*part)
            for (name, measure), part in zip(self.measures.items(), parts, strict=True)
        }
