"""From a case to numerics: the one place where configuration becomes plain records and arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case, ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.trial_basis import InnerProduct
from sphrom.scenes.taylor_green import TaylorGreen
from sphrom.sph import state_equation
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

Array = NDArray[np.float64]


def domain(case: Case) -> Domain:
    """Return the box of the scene."""
    length = case.scene.length
    return Domain((0.0, 0.0), (length, length), (True, True))


def fluid(case: Case, point: ParameterPoint) -> Fluid:
    """Return the fluid at a parameter point."""
    return Fluid(
        reference_density=case.fluid.reference_density,
        sound_speed=case.sound_speed,
        kinematic_viscosity=case.kinematic_viscosity(point),
        max_speed=case.fluid.reference_speed,
    )


def discretization(case: Case) -> Discretization:
    """Return how the fluid is cut into particles."""
    section = case.discretization
    return Discretization(
        particle_spacing=case.particle_spacing,
        smoothing_length=case.smoothing_length,
        diffusion_coefficient=section.diffusion_coefficient,
        viscosity="pair" if section.viscosity == "paper" else "laplacian",
        shifting=section.shifting.enabled,
        shifting_amplitude=section.shifting.amplitude,
        shifting_as_printed=section.shifting.form == "paper",
    )


def functional(case: Case, point: ParameterPoint) -> Functional:
    """Return the full-order functional at a parameter point."""
    return Functional(fluid(case, point), discretization(case), domain(case))


def scene(case: Case, point: ParameterPoint) -> TaylorGreen:
    """Return the flow at a parameter point."""
    return TaylorGreen(
        length=case.scene.length,
        speed=case.fluid.reference_speed,
        reference_density=case.fluid.reference_density,
        kinematic_viscosity=case.kinematic_viscosity(point),
        pressure_sign=-1.0 if case.scene.pressure_sign == "paper" else 1.0,
    )


def exact_flow(case: Case, point: ParameterPoint) -> TaylorGreen:
    """Return the exact solution at a parameter point, whatever sign the run was started with."""
    return replace(scene(case, point), pressure_sign=1.0)


def initial_fields(case: Case, point: ParameterPoint, position: Array) -> tuple[Array, Array]:
    """Return the density fluctuation (N,) and the velocity (N, 2) at positions (N, 2)."""
    flow = scene(case, point)
    fluctuation = state_equation.density_fluctuation(flow.pressure(position, 0.0), case.sound_speed)
    return fluctuation, flow.velocity(position, 0.0)


def map_onto(case: Case, points: Array) -> ReferenceMap:
    """Return the case's map of particle fields onto points (n_points, 2)."""
    return ReferenceMap(
        points,
        domain(case),
        particle_spacing=case.particle_spacing,
        smoothing_length=case.reference_smoothing_length,
        method=case.reference.method,
    )


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
        "mass": case.fluid.reference_density * case.particle_spacing**2,
        "box_length": domain(case).lengths,
    }


def reduced_time_step(model: ReducedModelSection, full_step: float) -> float:
    """Return the time step of a reduced model [s]."""
    return full_step if model.time_step == "fom" else float(model.time_step)
