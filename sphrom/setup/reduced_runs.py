"""What runs of models on the reference points take from a case: their snapshots, and the drive."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.plan import TimeSteps
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.polynomial_model import Amplitude, OutputTimes
from sphrom.reduction.reduced_rates import memory_length
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.setup import assembly

Array = NDArray[np.float64]


def amplitude_of(case: Case, point: ParameterPoint) -> Amplitude | None:
    """Return how strongly a flow is driven, at times; None where that doesn't change."""
    amplitude = assembly.scene(case, point).amplitude
    if amplitude is None:
        return None
    return lambda times: np.array([amplitude(float(t)) for t in times])


def memory_length_of(
    case: Case, model: ReducedModelSection, jacobian: Callable[[], Array]
) -> float:
    """Return the memory length [s] of a model with the closure of Eq. 3.22.

    `jacobian` returns that of the rates without closure, at the start of the run [1/s].
    """
    if model.memory_length == "auto":
        return memory_length(jacobian(), case.smoothing_length, case.sound_speed)
    return model.memory_length


def drives(case: Case, point: ParameterPoint, time: Array) -> tuple[Array, Array]:
    """Return the walls' speed over the given one, and the body force's amplitude (n_times,)."""
    flow = assembly.scene(case, point)
    speed, amplitude = np.ones(len(time)), np.zeros(len(time))
    if flow.wall_amplitude is not None:
        speed = np.array([flow.wall_amplitude(t) for t in time.tolist()])
    if flow.amplitude is not None:
        amplitude = np.array([flow.amplitude(t) for t in time.tolist()])
    return speed, amplitude


def output_times_of(case: Case, plan: TimeSteps, basis: TrialBasis) -> OutputTimes:
    """Return the snapshots of a plan's runs.

    Coordinates diverge beyond the norm of a flow as fast as sound at twice its density: its
    compression is no longer weak.
    """
    density = float(basis.inner_product.first_field(np.array(case.fluid.reference_density)))
    largest = math.sqrt(float(basis.weights.sum())) * math.hypot(case.sound_speed, density)
    return OutputTimes(plan.snapshot_interval, plan.n_snapshots, plan.start_time, largest)
