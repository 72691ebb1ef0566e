"""The closures of a case's reduced models: set up on particles, or read with the operators."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.model_kinds import ProjectionName
from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.closures import AdjointPetrovGalerkin, Galerkin, memory_length
from sphrom.reduction.polynomial import Polynomial
from sphrom.store.operators import read_memory

Array = NDArray[np.float64]
Jacobian = Callable[[], Array]
"""Computes the Jacobian [1/s] of the rates without closure, at the start of a run."""
Close = Callable[[Polynomial, float, Jacobian], tuple[Polynomial, float | None]]
"""From rates, a viscosity [m2/s] and a Jacobian, the rates with the closure, and its memory length
[s], None if it has none."""


class NoClosure:
    """How a case sets up Galerkin projection; the setups of closures derive from it."""

    def on_particles(self, case: Case, model: ReducedModelSection, jacobian: Jacobian) -> Galerkin:
        """Return the closure of a model on particles."""
        return Galerkin()

    def of_operators(
        self, case: Case, model: ReducedModelSection, artifact: Artifact, basis: str
    ) -> Close:
        """Return how the rates of projected operators are closed."""
        return lambda rates, kinematic_viscosity, jacobian: (rates, None)


class Memory(NoClosure):
    """Adjoint Petrov-Galerkin projection."""

    def on_particles(self, case: Case, model: ReducedModelSection, jacobian: Jacobian) -> Galerkin:
        """Return the closure with the memory length that the case asks for."""
        return AdjointPetrovGalerkin(_length(case, model, jacobian), model.jacobian_step)

    def of_operators(
        self, case: Case, model: ReducedModelSection, artifact: Artifact, basis: str
    ) -> Close:
        """Return a function that adds the projected operators times the memory length."""
        operators = read_memory(artifact, basis, model.size)

        def close(
            rates: Polynomial, kinematic_viscosity: float, jacobian: Jacobian
        ) -> tuple[Polynomial, float]:
            length = _length(case, model, jacobian)
            return rates.plus(operators.at(kinematic_viscosity), length), length

        return close


def _length(case: Case, model: ReducedModelSection, jacobian: Jacobian) -> float:
    if model.memory_length == "auto":
        return memory_length(jacobian(), case.plan.smoothing_length, case.plan.sound_speed)
    return model.memory_length


CLOSURES: dict[ProjectionName, NoClosure] = {"galerkin": NoClosure(), "apg": Memory()}
