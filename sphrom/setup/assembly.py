"""From a case to the records and arrays of the numerics, without the kernels of SPH.

`case.plan` has the records that follow from the keys alone; `sphrom.setup.particles` makes the
functional, walls and maps, which import the kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sphrom.arrays import Array
from sphrom.case.custom_sections import SurfaceForce
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import FieldMeasure, Samples
from sphrom.metrics.series import hat
from sphrom.reduction.correction import interpolation_weights
from sphrom.reduction.polynomial_model import Amplitude, OutputTimes
from sphrom.reduction.reduced_operators import memory_length
from sphrom.reduction.trial_basis import InnerProduct
from sphrom.sph.time_loop import TimeSteps

MOST_GROWTH = 3.0
"""Largest growth of a model's coordinates over training. Flows that start from rest grow 1.7 times
at up to ten times the trained Reynolds numbers, and 5.4 times in five times the trained time."""


def inner_product(case: Case) -> InnerProduct:
    """Return the product in which the modes of the case are orthonormal."""
    product = InnerProduct.raw(case.fluid.reference_density)
    if case.basis.inner_product == "acoustic":
        product = InnerProduct.acoustic(case.fluid.reference_density, case.plan.sound_speed)
    return product.without_mean() if case.plan.separate_mean_density else product


def medium(case: Case, point: ParameterPoint | None = None) -> dict[str, object]:
    """Return the reference density, the speed of sound, and the parameters at a point, if any."""
    values = {} if point is None else point.as_dict()
    return {
        **{f"parameters/{name}": value for name, value in values.items()},
        "reference_density": case.fluid.reference_density,
        "sound_speed": case.plan.sound_speed,
    }


def run_attributes(case: Case, point: ParameterPoint, time_step: float) -> dict[str, object]:
    """Return the physical constants stored with a trajectory."""
    return {
        **medium(case, point),
        "kinematic_viscosity": case.plan.kinematic_viscosity(point),
        "particle_spacing": case.plan.particle_spacing,
        "smoothing_length": case.plan.smoothing_length,
        "time_step": time_step,
        "mass": case.plan.mass,
        "box_length": case.scene.domain.lengths,
    }


def field_measures(case: Case) -> dict[str, FieldMeasure]:
    """Return the places and sections of measured fields, by name of the measurement."""
    spacing = case.plan.particle_spacing
    return {name: m.fields(spacing) for name, m in case.scene.measured_fields.items()}


def amplitude_of(case: Case, point: ParameterPoint) -> Amplitude | None:
    """Return the amplitude of a flow's driving at times; None if it does not change."""
    flow = case.plan.flow(point)
    return None if flow.amplitude is None else lambda times: flow.driving(times)[0]


def memory_length_of(
    case: Case, model: ReducedModelSection, jacobian: Callable[[], Array]
) -> float:
    """Return the memory length [s] of a model with the closure of Eq. 3.22.

    `jacobian` returns that of the rates without closure at the start of the run [1/s].
    """
    if model.memory_length == "auto":
        return memory_length(jacobian(), case.plan.smoothing_length, case.plan.sound_speed)
    return model.memory_length


def uniform_force(case: Case, point: ParameterPoint) -> Callable[[Array], Array]:
    """Return the body force (2, n_times) [m/s2] at times, gravity aside, the same everywhere."""
    force = case.plan.flow(point).body_force
    assert isinstance(force, SurfaceForce)
    return force.over


def sound_averages(case: Case) -> Array:
    """Return the weights of averages over snapshots in which sound cancels."""
    return hat(max(1, round(case.plan.longest_sound_period / case.plan.steps.snapshot_interval)))


def output_times_of(
    case: Case, steps: TimeSteps, states: Array, point: ParameterPoint
) -> OutputTimes:
    """Return the snapshot times of a reduced run on the reference points, and its largest norm.

    The norm is MOST_GROWTH times the largest of the training states (n_states, n_modes). It is
    increased in proportion if a parameter or the time exceeds its largest trained value.
    """
    values = np.abs([*point.as_dict().values()])
    largest = case.plan.largest_values
    beyond = np.divide(values, largest, out=np.ones_like(largest), where=largest > 0.0)
    norm = np.linalg.norm(states, axis=1).max() * max(1.0, beyond.max())
    return OutputTimes(
        interval=steps.snapshot_interval,
        n_snapshots=steps.n_snapshots,
        start_time=steps.start_time,
        largest_norm=MOST_GROWTH * float(norm),
        trained=case.plan.recorded_time,
    )


def scaled_parameters(case: Case, points: Sequence[ParameterPoint]) -> Array:
    """Return the scaled parameters of points (n_points, n_parameters), used for distances."""
    return case.plan.scaled(np.array([[*point.as_dict().values()] for point in points]))


def role_of(case: Case, basis: str, point: ParameterPoint) -> str:
    """Return `trained` for a training point of a basis, else `predicted`.

    Outside the range of the training points it is `extrapolated`.
    """
    trained = case.plan.bases[basis]
    if point in trained:
        return "trained"
    place = scaled_parameters(case, [point])[0]
    _, distance = interpolation_weights(scaled_parameters(case, trained), place)
    return "extrapolated" if distance > 0.0 else "predicted"


def has_air(case: Case) -> bool:
    """Return whether parts of the scene without fluid are air."""
    return case.scene.has_surface


def without_air(case: Case, samples: Samples) -> Samples:
    """Return samples with NaN above a free surface, where samples of runs are zero."""
    if not has_air(case):
        return samples
    air = (samples.speed == 0.0) & (samples.pressure == 0.0)
    velocity = np.where(air[..., None], np.nan, samples.velocity)
    return Samples(samples.time, velocity, np.where(air, np.nan, samples.pressure))
