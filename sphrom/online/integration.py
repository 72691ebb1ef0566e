"""The steps of a model on the reference points, as the case asks for them."""

from __future__ import annotations

from sphrom.case.plan import MAX_STEPS
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.reduction import integrators
from sphrom.reduction.integrators import PolynomialIntegrator, WholeIntegrator
from sphrom.reduction.reference_model import ReferenceModel


def polynomial_integrator(
    model: ReducedModelSection, reduced: ReferenceModel, full_steps: int
) -> PolynomialIntegrator:
    """Return the steps of a model with operators: exponential ones, unless steps are given.

    Parameters
    ----------
    full_steps : those of the full model from one snapshot to the next.
    """

    def steps(part: ReferenceModel) -> WholeIntegrator:
        n_steps = given_steps(model, part, full_steps)
        if n_steps is not None:
            return integrators.runge_kutta(part, n_steps)
        return integrators.automatic_whole(part)

    return integrators.choose(reduced, steps)


def given_steps(model: ReducedModelSection, reduced: ReferenceModel, full_steps: int) -> int | None:
    """Return the steps of a whole run that the case gives, None where they are automatic."""
    output_times = reduced.output_times
    n_intervals = output_times.n_snapshots - 1
    if model.time_step == "fom":
        return full_steps * n_intervals
    if model.time_step != "auto":
        return round(output_times.interval / model.time_step) * n_intervals
    if output_times.duration > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {model.name} is stable with steps of {reduced.step_limit:.3g} s only, which are "
            f"more than {MAX_STEPS:g} in all; choose fewer modes, a shorter memory_length or a "
            "time_step"
        )
    return None
