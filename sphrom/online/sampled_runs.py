"""Runs on the reference points whose rates are evaluated there, at all points or at samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection, SampleSection
from sphrom.errors import CaseError
from sphrom.offline.operators import fixed_points
from sphrom.reduction.operators import UnprojectedModel
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.polynomial_model import Amplitude, Runs, Schedule
from sphrom.reduction.sampled_model import (
    Drive,
    Rates,
    SampledModel,
    SampledRemainder,
    integrate,
    remainder_modes,
)
from sphrom.reduction.sampling import choose_points, weighted_modes
from sphrom.reduction.trial_basis import TrialBasis, kept_modes
from sphrom.sph.fixed_points import FixedPoints, Order, Surroundings
from sphrom.store.basis import read_basis
from sphrom.store.splines import read_model_splines
from sphrom.store.workspace import Workspace

SHORT, MOST_TIMED = 1.0, 5
"""Runs are repeated for their timing within so many seconds, so many times at most."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Evaluation:
    """How the rates of a run are had, where its operators alone don't give them."""

    rates: Rates
    drive: Drive
    samples: Indices | None = None
    """(n_samples,) the points that are sampled, if not all."""
    sampling_error: float | None = None
    """Of rates between training states, relative to those of all points."""


def evaluation(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    basis: TrialBasis,
    polynomial: Polynomial,
    amplitude: Amplitude | None,
) -> Evaluation | None:
    """Return the evaluation that a model asks for, None where its operators are all of it.

    Parameters
    ----------
    basis : of the model's modes alone.
    polynomial : what operators give, at the parameter point.
    amplitude : of what drives the flow over time, where that changes.

    Raises
    ------
    CaseError
        When the samples don't tell the modes apart.
    """
    if model.evaluation == "polynomial":
        return None
    case, points = workspace.case, fixed_points(workspace)
    name, splines = case.basis_for(model, point), None
    if case.operators.advection == "spline":
        splines = read_model_splines(workspace, name, model.n_modes)
    drive = _drive(case, point, amplitude)
    exact = UnprojectedModel(points, basis, splines)
    if model.evaluation == "full":
        return Evaluation(exact, drive)
    states = _training_states(workspace, name, model.n_modes)
    try:
        if model.samples.terms == "all":
            samples = _samples(model.samples, weighted_modes(basis), basis)
            sampled: Rates = SampledModel(points, basis, splines, samples)
        else:
            around = _surroundings(case, drive)
            samples, sampled = _completed(
                case, model.samples, points, basis, polynomial, states, around
            )
    except ValueError as error:
        raise CaseError(
            f"rom: {model.name}: {error}; raise samples.oversampling, or choose another "
            "samples.method"
        ) from error
    error_there = _error(sampled, exact, _between(states), drive.at(step_plan(case).start_time))
    return Evaluation(sampled, drive, samples, error_there)


def _drive(case: Case, point: ParameterPoint, amplitude: Amplitude | None) -> Drive:
    viscosity = case.kinematic_viscosity(point)
    if amplitude is None:
        return Drive(viscosity)
    return Drive(viscosity, lambda at: float(amplitude(np.array([at]))[0]))


def _training_states(workspace: Workspace, name: str, n_modes: int) -> Array:
    modes = kept_modes(read_basis(workspace, name), n_modes)
    with workspace.open(workspace.operators()) as artifact:
        return artifact.read(f"bases/{name}/states")[:, modes]


def _between(states: Array) -> Array:
    """Return states half-way between each and the next: no samples were chosen for these."""
    return 0.5 * (states[:-1] + states[1:]) if len(states) > 1 else states


def _samples(section: SampleSection, modes: Array, basis: TrialBasis) -> Indices:
    n_samples = round(section.oversampling * basis.n_modes)
    return choose_points(modes, n_samples, section.method, section.seed)


def _surroundings(case: Case, drive: Drive) -> list[Surroundings]:
    """Return what a remainder has to be taken in: it is linear in the amplitude."""
    none = replace(drive.at(0.0), amplitude=0.0)
    return [none, replace(none, amplitude=1.0)] if case.scene.drive_changes else [none]


def _completed(
    case: Case,
    section: SampleSection,
    points: FixedPoints,
    basis: TrialBasis,
    polynomial: Polynomial,
    states: Array,
    surroundings: Sequence[Surroundings],
) -> tuple[Indices, Rates]:
    """Return samples, and the operators' rates completed with what they leave out."""
    order: Order = 1 if case.operators.density_order else 0
    modes = remainder_modes(points, basis, order, states, surroundings, basis.n_modes)
    samples = _samples(section, modes, basis)
    remainder = SampledRemainder(points, basis, order, modes, samples)

    def rates(coordinates: Array, around: Surroundings) -> Array:
        return polynomial(coordinates, around.amplitude) + remainder(coordinates, around)

    return samples, rates


def _error(sampled: Rates, exact: Rates, states: Array, around: Surroundings) -> float:
    expected = np.array([exact(state, around) for state in states])
    found = np.array([sampled(state, around) for state in states])
    size = float(np.linalg.norm(expected))
    return float(np.linalg.norm(found - expected)) / size if size > 0.0 else 0.0


def timed(
    evaluated: Evaluation,
    start: Array,
    schedule: Schedule,
    steps_per_snapshot: int,
    advance: Callable[[int], None],
) -> tuple[Runs, float]:
    """Run from coordinates (n_modes,), and return what it took [s].

    A short run is repeated, and the least counts: other programs disturb some.
    """
    rates, drive = evaluated.rates, evaluated.drive
    seconds: list[float] = []
    while not seconds or (sum(seconds) < SHORT and len(seconds) < MOST_TIMED):
        began = time.perf_counter()
        tell = (lambda done: None) if seconds else advance
        runs = integrate(rates, start, schedule, steps_per_snapshot, drive, tell)
        seconds.append(time.perf_counter() - began)
    return runs, min(seconds)


def write_samples(artifact: ArtifactWriter, evaluated: Evaluation) -> None:
    """Write which points were sampled, and how well they tell rates; nothing if all were."""
    if evaluated.samples is None:
        return
    artifact.write("samples", evaluated.samples)
    artifact.annotate("sampling_error", evaluated.sampling_error)
