"""Models whose rates are evaluated at all reference points, which checks their operators.

The sums over points load the kernels of SPH.
"""

from __future__ import annotations

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.online.integration import given_steps
from sphrom.reduction import integrators
from sphrom.reduction.evaluated_run import EvaluatedIntegrator
from sphrom.reduction.operators import UnprojectedModel
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.setup import particles
from sphrom.store.basis import read_points
from sphrom.store.splines import read_model_splines
from sphrom.store.workspace import Workspace


def point_integrator(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    step_factor: float | None = None,
) -> EvaluatedIntegrator:
    """Return Runge-Kutta steps with rates that are evaluated at all points, ending on snapshots.

    With a `step_factor` they are automatic ones, times it.
    """
    case = workspace.case
    splines = read_model_splines(workspace, case.basis_for(model, point), model.size)
    points = particles.fixed_points(case, read_points(workspace))
    n_steps = None
    if step_factor is None:
        n_steps = given_steps(model, reduced, step_plan(case).every)
    if n_steps is None:
        automatic = integrators.automatic_steps(reduced)
        n_steps = max(1, round(automatic / (step_factor or 1.0)))
    n_snapshots = reduced.output_times.n_snapshots
    return EvaluatedIntegrator(
        reduced,
        UnprojectedModel(points, reduced.basis, splines),
        case.kinematic_viscosity(point),
        integrators.whole_steps(n_steps, n_snapshots) // max(1, n_snapshots - 1),
        point.factors,
    )
