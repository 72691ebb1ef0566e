"""Causes of instability of fast models, from eigenvalues of their Jacobians."""

from __future__ import annotations

import math

import numpy as np

from sphrom.arrays import Array
from sphrom.models.points.fast_model import FastRun
from sphrom.reduction.polynomial_model import RUNGE_KUTTA
from sphrom.reduction.reduced_operators import stability_limits
from sphrom.reduction.reference_model import Integrator, ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.setup.assembly import MOST_GROWTH

SOUND = 0.1
"""Share of pressure in the energy of an eigenvector above which it is sound."""
PER_DECADE, DECADES = 20, 3
"""Memory lengths to try in the search for a growing eigenvector."""


def limiting_step(reduced: ReferenceModel) -> tuple[str, float]:
    """Return the mechanism that limits Runge-Kutta steps of a model, and the largest step [s].

    The limit comes from an eigenvector of the Jacobian around the start or a training state. The
    mechanism is sound if pressure has more than a share SOUND of its energy, else viscosity if it
    decays faster than it oscillates, else convection.
    """
    values, vectors = _spectrum(reduced, _around_which(reduced))
    limits = stability_limits(values.astype(np.complex128))
    worst = int(limits.argmin())
    return kind_of(reduced.basis, values[worst], vectors[worst]), float(limits[worst])


def _around_which(reduced: ReferenceModel) -> Array:
    """Return the states (n_states, n_modes) around which the model must be stable."""
    start = reduced.start[None]
    return start if reduced.states is None else np.vstack((start, reduced.states))


def _spectrum(reduced: ReferenceModel, states: Array) -> tuple[Array, Array]:
    """Return the eigenvalues (n,) and eigenvectors (n, n_modes) of Jacobians around states."""
    values, vectors = np.linalg.eig(reduced.polynomial.jacobians(states, reduced.strongest))
    return values.ravel(), vectors.transpose(0, 2, 1).reshape(values.size, -1)


def kind_of(basis: TrialBasis, value: complex, vector: Array) -> str:
    """Return the mechanism of an eigenvalue [1/s] of a Jacobian and its eigenvector (n_modes,)."""
    modes = basis.density_modes[: len(vector)]  # a model may integrate only the leading modes
    pressure = (modes * basis.weights) @ modes.T
    if (vector.conj() @ pressure @ vector).real > SOUND * np.linalg.norm(vector) ** 2:
        return "sound"
    return "viscosity" if abs(value.real) > abs(value.imag) else "convection"


def growth(reduced: ReferenceModel, states: Array) -> tuple[float, str]:
    """Return the fastest growth rate [1/s] around states (n_states, n_modes), and its cause.

    Growth mainly in the last half of the modes is due to their noise. Growth in the first half is
    due to energy that would go to the truncated modes.
    """
    values, vectors = _spectrum(reduced, states)
    worst = int(values.real.argmax())
    energy = np.abs(vectors[worst]) ** 2
    last = float(energy[len(energy) // 2 :].sum() / energy.sum())
    return float(values.real[worst]), "noise modes" if last > 0.5 else "aliasing"


def longest_memory(near: ReferenceModel, far: ReferenceModel) -> float | None:
    """Return the longest memory at which no state grows, over the memory of the model `near`.

    `far` is the same model with twice the memory, because the closure's part of a Jacobian is
    proportional to the memory. Jacobians are those around the states of `near`. Returns None if
    nothing grows in the range that is tried.
    """
    states = _around_which(near)
    bare, longer = (m.polynomial.jacobians(states, m.strongest) for m in (near, far))
    # If perturbations of the flow itself grow, only faster growth counts.
    without = max(0.0, float(np.linalg.eigvals(2.0 * bare - longer).real.max()))
    for power in range(-DECADES * PER_DECADE, DECADES * PER_DECADE + 1):
        factor = 10.0 ** (power / PER_DECADE)
        jacobians = bare + (factor - 1.0) * (longer - bare)
        fastest = float(np.linalg.eigvals(jacobians).real.max()) - without
        if fastest * near.output_times.duration > math.log(MOST_GROWTH):
            return factor
    return None


def cause_of_divergence(run: FastRun, integrator: Integrator) -> str:
    """Return the cause of a diverged run, from its steps and the eigenvalues along its path."""
    reduced = run.reduced
    if integrator.steps.system.integrator == RUNGE_KUTTA:
        name, limit = limiting_step(reduced)
        if run.time_step > limit:
            return name
    if reduced.memory_length is not None:
        return "closure"
    fastest, where = growth(reduced, _around_which(reduced))
    if fastest * reduced.output_times.duration > math.log(MOST_GROWTH):
        return where
    if run.outside:
        return "extrapolated rates"
    return growth(reduced, run.done.coordinates[-1:])[1]
