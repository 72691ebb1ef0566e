"""From a case to numerics: the one place where configuration becomes plain records and arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.case.measures import MeasureSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.measures import FieldMeasure
from sphrom.reduction.trial_basis import InnerProduct
from sphrom.scenes.scene import ExactFlow, Scales, Scene
from sphrom.sph import state_equation
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid

Array = NDArray[np.float64]


def domain(case: Case) -> Domain:
    """Return where the fluid of the scene is."""
    return case.scene.domain


def longest_sound_period(case: Case) -> float:
    """Return the period of the longest standing wave in the scene's box [s]."""
    return 2.0 * max(domain(case).lengths) / case.sound_speed


def fluid(case: Case, point: ParameterPoint) -> Fluid:
    """Return the fluid at a parameter point."""
    return Fluid(
        reference_density=case.fluid.reference_density,
        sound_speed=case.sound_speed,
        kinematic_viscosity=case.kinematic_viscosity(point),
        max_speed=case.max_speed,
    )


def discretization(case: Case) -> Discretization:
    """Return how the fluid is cut into particles."""
    section = case.discretization
    return Discretization(
        particle_spacing=case.particle_spacing,
        smoothing_length=case.smoothing_length,
        diffusion_coefficient=section.diffusion_coefficient,
        acoustic_damping=section.acoustic_damping,
        viscosity="pair" if section.viscosity == "paper" else "laplacian",
        shifting=section.shifting.enabled,
        shifting_amplitude=section.shifting.amplitude,
        shifting_as_printed=section.shifting.form == "paper",
        shifting_transport=section.shifting.transport,
        fixed_volume=section.fixed_volume,
        no_slip=section.walls.no_slip,
        wall_continuity=section.walls.continuity,
    )


def scene(case: Case, point: ParameterPoint) -> Scene:
    """Return the flow at a parameter point."""
    fluid = case.fluid
    viscosity = case.kinematic_viscosity(point)
    scales = Scales(fluid.reference_speed, fluid.reference_density, viscosity, point.factors)
    return case.scene.flow(scales)


def exact_flow(case: Case, point: ParameterPoint) -> ExactFlow | None:
    """Return the exact solution at a parameter point, or None where none is known."""
    return scene(case, point).exact


def initial_fields(case: Case, point: ParameterPoint, position: Array) -> tuple[Array, Array]:
    """Return the density fluctuation (N,) and the velocity (N, 2) at positions (N, 2)."""
    flow = scene(case, point)
    fluctuation = state_equation.density_fluctuation(
        flow.initial_pressure(position), case.sound_speed
    )
    return fluctuation, flow.initial_velocity(position)


def inner_product(case: Case) -> InnerProduct:
    """Return the inner product of the trial basis."""
    if case.basis.inner_product == "acoustic":
        return InnerProduct.acoustic(case.fluid.reference_density, case.sound_speed)
    return InnerProduct.raw(case.fluid.reference_density)


def run_attributes(case: Case, point: ParameterPoint, time_step: float) -> dict[str, object]:
    """Return the physical constants that a trajectory is stored with."""
    return {
        **{f"parameters/{name}": value for name, value in point.as_dict().items()},
        "reference_density": case.fluid.reference_density,
        "sound_speed": case.sound_speed,
        "kinematic_viscosity": case.kinematic_viscosity(point),
        "particle_spacing": case.particle_spacing,
        "smoothing_length": case.smoothing_length,
        "time_step": time_step,
        "mass": mass(case),
        "box_length": domain(case).lengths,
    }


def mass(case: Case) -> float:
    """Return the mass of a particle, per metre of depth [kg/m]."""
    return case.fluid.reference_density * case.particle_spacing**2


def reduced_time_step(model: ReducedModelSection, full_step: float) -> float:
    """Return the time step of a reduced model [s]."""
    return full_step if isinstance(model.time_step, str) else model.time_step


def largest_viscosity(case: Case) -> float:
    """Return the largest kinematic viscosity that is trained on [m2/s]."""
    return max(case.kinematic_viscosity(point) for point in case.train_points)


def field_measures(case: Case) -> dict[str, FieldMeasure]:
    """Return where a case measures fields, by the names of the measurements."""
    spacing = case.particle_spacing
    return {name: _measure(m, spacing) for name, m in case.scene.measured_fields.items()}


def _measure(section: MeasureSection, spacing: float) -> FieldMeasure:
    if section.flow_rate is not None:
        ends = np.array(section.flow_rate.start), np.array(section.flow_rate.end)
        return FieldMeasure.section(*ends, longest=spacing)
    if section.line is not None:
        ends = np.array(section.line.start), np.array(section.line.end)
        return FieldMeasure.line(*ends, section.line.points)
    return FieldMeasure(np.array([section.probe]))
