"""The closures of a case's reduced models: set up on particles, or read with the operators."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.model_kinds import ProjectionName
from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.closures import AdjointPetrovGalerkin, Closure, Galerkin, memory_length
from sphrom.reduction.polynomial import Polynomial
from sphrom.store.operators import read_memory

Array = NDArray[np.float64]
Jacobian = Callable[[], Array]
"""Computes the Jacobian [1/s] of the rates without closure, at the start of a run."""
Close = Callable[[Polynomial, float, Jacobian], tuple[Polynomial, float | None]]
"""From rates, a viscosity [m2/s] and a Jacobian, the rates with the closure, and its memory length
[s], None if it has none."""


class ClosureSetup(Protocol):
    """How a case sets a closure up."""

    def on_particles(self, case: Case, model: ReducedModelSection, jacobian: Jacobian) -> Closure:
        """Return the closure of a model on particles."""

    def of_operators(
        self, case: Case, model: ReducedModelSection, artifact: Artifact, basis: str
    ) -> Close:
        """Return how the rates of projected operators are closed."""


class NoClosure:
    """Galerkin projection."""

    def on_particles(self, case: Case, model: ReducedModelSection, jacobian: Jacobian) -> Closure:
        """Return the closure that leaves rates as they are."""
        return Galerkin()

    def of_operators(
        self, case: Case, model: ReducedModelSection, artifact: Artifact, basis: str
    ) -> Close:
        """Return a function that leaves rates as they are."""
        return lambda rates, kinematic_viscosity, jacobian: (rates, None)


class Memory:
    """Adjoint Petrov-Galerkin projection."""

    def on_particles(self, case: Case, model: ReducedModelSection, jacobian: Jacobian) -> Closure:
        """Return the closure with the memory length that the case asks for."""
        return AdjointPetrovGalerkin(_length(case, model, jacobian), model.jacobian_step)

    def of_operators(
        self, case: Case, model: ReducedModelSection, artifact: Artifact, basis: str
    ) -> Close:
        """Return a function that adds the projected operators times the memory length."""
        operators = read_memory(artifact, basis, model.n_modes)

        def close(
            rates: Polynomial, kinematic_viscosity: float, jacobian: Jacobian
        ) -> tuple[Polynomial, float]:
            length = _length(case, model, jacobian)
            return rates.plus(operators.at(kinematic_viscosity), length), length

        return close


def _length(case: Case, model: ReducedModelSection, jacobian: Jacobian) -> float:
    if model.memory_length == "auto":
        return memory_length(jacobian(), case.smoothing_length, case.sound_speed)
    return model.memory_length


CLOSURES: dict[ProjectionName, ClosureSetup] = {"galerkin": NoClosure(), "apg": Memory()}
