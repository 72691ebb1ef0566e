"""Reduced models on the reference points, built: what runs there start from, and their rates.

What doesn't depend on the parameter point is read and made once, however many points there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.memory_operators import MemoryOperators, with_memory
from sphrom.reduction.operators import ReducedOperators
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.polynomial_model import Amplitude, Schedule, step_limit
from sphrom.reduction.projection import memory_length
from sphrom.reduction.trial_basis import (
    TrialBasis,
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.setup import assembly
from sphrom.store import calibration
from sphrom.store.basis import read_basis
from sphrom.store.operators import read_memory, read_operators
from sphrom.store.start import Start, start
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    mean_density_fluctuation: float
    """[kg/m3], carried apart."""
    step_limit: float
    """[s], of the start and of some training states."""
    largest_norm: float
    """Of coordinates, beyond which a run has diverged."""
    amplitude: Amplitude | None = None
    """Of what drives the flow, where that changes."""
    memory_length: float | None = None
    """tau of Eq. 3.22 [s], of a model with the closure."""
    linear: Array | None = None
    """(n_modes, n_modes) [1/s] what exponential steps carry: the Jacobian at the mean of training
    states. None where there are none such: automatic steps are then Runge-Kutta's as well."""


def build_reference_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReferenceModel:
    """Return a model on the reference points at a parameter point, which need not be trained."""
    return ReferenceModels(workspace, model).at(point)


class ReferenceModels:
    """One model on the reference points, at any parameter points.

    The initial condition is the scene's at that point, or the end of the spin-up, that of the
    nearest trained value where there is none; mapped onto the reference space and projected.
    """

    def __init__(self, workspace: Workspace, model: ReducedModelSection) -> None:
        self._workspace = workspace
        self.model = model
        self._shared: dict[str, _Shared] = {}
        self._starts = _Starts(workspace)

    def at(self, point: ParameterPoint, basis: str | None = None) -> ReferenceModel:
        """Return the model at a parameter point, by default with the basis that it has there."""
        case, model = self._workspace.case, self.model
        shared = self._of(basis or case.basis_for(model, point))
        viscosity = case.kinematic_viscosity(point)
        coordinates, mean = shared.initial_state(self._starts.mapped(point))
        amplitude = _amplitude(self._workspace, point)
        strongest = 0.0 if amplitude is None else float(np.max(np.abs(amplitude(_times(case)))))
        polynomial = shared.operators.at(viscosity)
        memory_length = None
        if shared.closure is not None:
            jacobian = polynomial.jacobian(coordinates, strongest)
            memory_length = _memory_length(case, model, jacobian)
            polynomial = with_memory(polynomial, shared.closure.at(viscosity), memory_length)
        if shared.learnt is not None:
            polynomial = shared.learnt.at(viscosity).added_to(polynomial)
        return ReferenceModel(
            polynomial=polynomial,
            basis=shared.basis,
            start=coordinates,
            mean_density_fluctuation=mean,
            step_limit=step_limit(polynomial, np.vstack((coordinates, shared.states)), strongest),
            largest_norm=_largest_norm(case, shared.basis),
            amplitude=amplitude,
            memory_length=memory_length,
            linear=polynomial.jacobian(shared.states.mean(axis=0), strongest),
        )

    def training_states(self, point: ParameterPoint) -> Array:
        """Return coordinates (n_states, n_modes) of training states of the basis at a point."""
        return self._of(self._workspace.case.basis_for(self.model, point)).states

    def _of(self, name: str) -> _Shared:
        if name not in self._shared:
            self._shared[name] = _read_shared(self._workspace, self.model, name)
        return self._shared[name]


@dataclass(frozen=True)
class _Shared:
    """What a model has in common at all points at which it uses one basis."""

    basis: TrialBasis
    operators: ReducedOperators
    states: Array
    """(n_states, n_modes) around which steps have to be stable."""
    closure: MemoryOperators | None
    learnt: calibration.Calibration | None

    def initial_state(self, fields: tuple[Array, Array]) -> tuple[Array, float]:
        """Return coordinates (n_modes,) of mapped fields, and the mean that is carried apart."""
        mean = float(mean_density_fluctuation(self.basis, fields[0]))
        return project(self.basis, *fields), mean


def _read_shared(workspace: Workspace, model: ReducedModelSection, name: str) -> _Shared:
    whole = read_basis(workspace, name)
    modes = kept_modes(whole, model.n_modes)
    with workspace.open(workspace.operators()) as artifact:
        operators = read_operators(artifact, name, modes)
        closure = learnt = None
        if model.projection == "apg":
            closure = read_memory(artifact, name, model.n_modes)
        if model.calibrated:
            learnt = calibration.read_calibration(workspace.case, artifact, name, operators, modes)
        states = artifact.read(f"bases/{name}/states")[:, modes]
    return _Shared(truncate(whole, model.n_modes), operators, states, closure, learnt)


class _Starts:
    """What runs start from, mapped onto the reference space; kept while it stays the same."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        with workspace.open(workspace.basis()) as artifact:
            self._map = assembly.map_onto(workspace.case, artifact.read("reference_position"))
        self._read: dict[ParameterPoint, Start] = {}
        self._last: tuple[Start, tuple[Array, Array]] | None = None

    def mapped(self, point: ParameterPoint) -> tuple[Array, Array]:
        """Return density fluctuation (n_points,) and velocity (n_points, 2) at the start."""
        begin = self._start(self._workspace.case.start_point(point))
        if self._last is None or not _same(self._last[0], begin):
            fields = self._map(begin.position, begin.density_fluctuation, begin.velocity)
            self._last = begin, fields
        return self._last[1]

    def _start(self, point: ParameterPoint) -> Start:
        """Return what a run starts from; particles, and the end of a spin-up, are read once."""
        case = self._workspace.case
        spun_up = case.time.spin_up > 0.0
        if point not in self._read and (spun_up or not self._read):
            self._read[point] = start(self._workspace, point)
        if point in self._read:
            return self._read[point]
        position = next(iter(self._read.values())).position
        return Start(position, *assembly.initial_fields(case, point, position))


def _same(one: Start, other: Start) -> bool:
    return one is other or all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("position", "density_fluctuation", "velocity")
    )


def _amplitude(workspace: Workspace, point: ParameterPoint) -> Amplitude | None:
    amplitude = assembly.scene(workspace.case, point).amplitude
    if amplitude is None:
        return None
    return lambda times: np.array([amplitude(float(t)) for t in times])


def _times(case: Case) -> Array:
    """Return the times of snapshots (n_snapshots,) [s]."""
    plan = step_plan(case)
    return Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time).time


def _memory_length(case: Case, model: ReducedModelSection, jacobian: Array) -> float:
    if model.memory_length == "auto":
        return memory_length(jacobian, case.smoothing_length, case.sound_speed)
    return model.memory_length


def _largest_norm(case: Case, basis: TrialBasis) -> float:
    """Return the norm of a flow as fast as sound at twice its density: no weak compression."""
    density = float(basis.inner_product.first_field(np.array(case.fluid.reference_density)))
    return math.sqrt(float(basis.weights.sum())) * math.hypot(case.sound_speed, density)
