"""Derivatives of reduced runs with respect to the parameters, from the model's own equations.

The coordinates a of a model follow da/dt = f(a, t; p). Their derivatives s = da/dp follow the
tangent equations ds/dt = J(a) s + df/dp, starting from the derivative of the start. Both are
integrated in one loop (`sphrom.kernels.tangent`). The coefficients of f are polynomials of the
viscosity and of the driving parameters, so their central difference is exact up to rounding; so are
those of the start and of the amplitude, as far as they are linear. The end of a spin-up is treated
as a fixed start, because only the training runs show how it changes.

The correction of the coordinates changes with the parameters too. It has a kink at the training
points, where the derivative is the mean of both sides.

A force is a polynomial of the coordinates with coefficients that depend on the parameters; it is
differentiated by a central difference, and so is a pressure with modes of its own. The kinetic
energy is quadratic in the velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.metrics.measures import Quantities, Samples, with_coefficients
from sphrom.models.points.fast_model import FastModel
from sphrom.models.points.quantities import forces_of
from sphrom.reduction import reference_model
from sphrom.reduction.exponential_steps import Change, ExponentialModel
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps
from sphrom.store.trajectory import totals


@dataclass(frozen=True)
class Tangents:
    """A run and its derivatives with respect to each parameter."""

    parameters: tuple[str, ...]
    """The parameters of the derivatives, along the first axis of the following arrays."""
    time: Array
    """(n_snapshots,) [s]."""
    run: Array
    """(n_snapshots, n_modes) generalized coordinates of the run itself."""
    coordinates: Array
    """(n_parameters, n_snapshots, n_modes) derivatives of the generalized coordinates."""
    mean_changes: Array
    """(n_parameters,) of the separate mean density fluctuation [kg/m3]."""
    kinetic_energy: Array
    """(n_parameters, n_snapshots) [J/m]."""
    measured: Mapping[str, Quantities]
    """Derivatives (n_parameters, n_snapshots, ...) by measurement and quantity."""
    _sample: Callable[[Array], Samples]
    """Samples the derivatives of velocity and pressure at points (n_points, 2) [m]."""


@dataclass(frozen=True)
class _Sides:
    """A model slightly below and slightly above a value of one parameter."""

    below: ReferenceModel
    above: ReferenceModel
    width: float
    """Difference of the parameter between both."""

    def mapped(self, change: Callable[[ReferenceModel], ReferenceModel | None]) -> _Sides:
        """Return the pair of models derived from these."""
        below = change(self.below)
        above = change(self.above)
        assert below is not None
        assert above is not None
        return replace(self, below=below, above=above)

    def slope(self, of: Callable[[ReferenceModel], Any]) -> Any:
        """Return the derivative of a number or array of the model for the parameter."""
        return (of(self.above) - of(self.below)) / self.width

    @property
    def change(self) -> Change:
        """The derivative of the equations with respect to the parameter."""
        low = self.below.amplitude
        high = self.above.amplitude
        width = self.width
        polynomial = self.above.polynomial.plus(self.below.polynomial, -1.0).scaled(1.0 / width)
        start = self.slope(lambda model: model.start)
        if low is None or high is None:
            return Change(polynomial, start)
        return Change(polynomial, start, lambda times: (high(times) - low(times)) / width)


def _starting_as(side: ReferenceModel, model: ReferenceModel) -> ReferenceModel:
    leading = side.leading
    if leading is not None and model.leading is not None:
        leading = _starting_as(leading, model.leading)
    mean = model.mean_density_fluctuation
    return replace(side, start=model.start, mean_density_fluctuation=mean, leading=leading)


def tangents(
    model: FastModel,
    point: ParameterPoint,
    names: Sequence[str],
    reduced: ReferenceModel,
    step_factor: float = 1.0,
    integrator: Integrator | None = None,
) -> Tangents:
    """Return derivatives of a run, its forces and its energy with respect to parameters.

    Parameters
    ----------
    reduced : the model at the point, with the output times of the run.
    step_factor : length of the steps over that of the integrator's.
    integrator : of the model; by default with automatic steps.

    Raises UnstableError if the run diverges.
    """
    case = model.workspace.case
    basis = model.basis_at(point)
    sides = [_sides(model, point, name, basis) for name in names]
    if case.time.spin_up > 0.0:
        sides = [s.mapped(lambda side: _starting_as(side, reduced)) for s in sides]
    steps = (integrator or reference_model.automatic(reduced)).with_steps(step_factor)
    run, changes = _completed(reduced, sides, steps)
    if not (np.isfinite(run).all() and np.isfinite(changes).all()):
        raise UnstableError("the run diverges, so that it has no derivatives")
    modes = reduced.basis.velocity_modes.reshape(reduced.basis.n_modes, -1)
    gradient = run @ (modes @ modes.T)  # of the kinetic energy
    means = np.array([s.slope(lambda model: model.mean_density_fluctuation) for s in sides])
    measured = _forces(reduced, sides, run, changes, means)
    states, state_changes = _with_pressure(reduced, sides, run, changes)
    measured |= _fields(reduced, states, state_changes, means)
    energy = np.asarray(case.plan.mass * np.einsum("sm,psm->ps", gradient, changes))
    ordered = {name: measured[name] for name in (*case.scene.recorded, *measured)}
    ordered = with_coefficients(ordered, case.plan.coefficients)
    times = reduced.output_times.time

    def sampled(points: Array) -> Samples:
        mean = reduced.mean_density_fluctuation
        moved = zip(states + state_changes, mean + means, strict=True)
        sample = partial(model.on_basis(basis).sampled, points, times)
        samples = sample(states, mean)
        others = [sample(state, density) for state, density in moved]
        velocity = np.stack([other.velocity - samples.velocity for other in others])
        pressure = np.stack([other.pressure - samples.pressure for other in others])
        return Samples(times, velocity, pressure)

    return Tangents(tuple(names), times, run, changes, means, energy, ordered, sampled)


def _completed(
    reduced: ReferenceModel, sides: Sequence[_Sides], integrator: Integrator
) -> tuple[Array, Array]:
    """Return a run and its derivatives, with the corrections of the coordinates."""
    leading = whole = correction = None
    if integrator.leading is not None:
        first = [side.mapped(lambda model: model.leading) for side in sides]
        leading = _integrated(integrator.leading, first)
    if integrator.whole is not None:
        whole = _integrated(integrator.whole, sides)
    if reduced.correction is not None:
        # The run first, then its derivatives.
        slopes = [side.slope(lambda model: model.correction) for side in sides]
        correction = np.stack((reduced.correction, *slopes))
    found, _ = reduced.completed(leading, whole, correction)
    return found[0], found[1:]


def _integrated(steps: Steps, sides: Sequence[_Sides]) -> Array:
    """Return a run and its derivatives (1 + n_parameters, n_snapshots, n_modes)."""
    system = steps.system
    model = steps.model
    if not isinstance(system, ExponentialModel):
        raise UnstableError("a model without training states has no exponential steps")
    changes = [side.change for side in sides]
    with np.errstate(all="ignore"):
        run, slopes = system.tangents(
            steps.n_steps, model.start, model.output_times, changes, model.amplitude
        )
    return np.concatenate((run[None], slopes))


def _sides(model: FastModel, point: ParameterPoint, name: str, basis: str) -> _Sides:
    values = point.as_dict()
    plan = model.workspace.case.plan
    step = plan.small_step(point, name)
    low, high = (plan.point({**values, name: values[name] + change}) for change in (-step, step))
    below, above = (model.on_basis(basis).at(point) for point in (low, high))
    return _Sides(below, above, high.as_dict()[name] - low.as_dict()[name])


def _with_pressure(
    reduced: ReferenceModel, sides: Sequence[_Sides], run: Array, changes: Array
) -> tuple[Array, Array]:
    """Return a run and its derivatives with the coordinates of the model's own pressure modes."""
    times = reduced.output_times.time
    states = reduced.with_pressure(times, run)
    if reduced.pressure is None:
        return states, changes

    def at(model: ReferenceModel, run: Array) -> Array:
        return replace(model, output_times=reduced.output_times).with_pressure(times, run)

    slopes = []
    for side, change in zip(sides, changes, strict=True):
        half = 0.5 * side.width * change
        slopes.append((at(side.above, run + half) - at(side.below, run - half)) / side.width)
    return states, np.stack(slopes)


def _fields(
    reduced: ReferenceModel, run: Array, changes: Array, means: Array
) -> dict[str, Quantities]:
    """Return the derivatives of flow rates, probes and lines, which are linear in the state."""
    mean = reduced.mean_density_fluctuation
    here = reduced.measured(run, mean)
    moved = [
        reduced.measured(run + change, mean + of_mean)
        for change, of_mean in zip(changes, means, strict=True)
    ]
    return {
        name: {q: np.stack([run[name][q] - fields[q] for run in moved]) for q in fields}
        for name, fields in here.items()
    }


def _forces(
    reduced: ReferenceModel, sides: Sequence[_Sides], run: Array, changes: Array, means: Array
) -> dict[str, Quantities]:
    """Return the derivatives of the forces and torques."""
    times = reduced.output_times.time
    mean = reduced.mean_density_fluctuation
    differences = []
    for side, change, of_mean in zip(sides, changes, means, strict=True):
        low, high = (
            forces_of(
                replace(model, output_times=reduced.output_times),
                times,
                run + step * change,
                mean + step * of_mean,
            )
            for model, step in ((side.below, -0.5 * side.width), (side.above, 0.5 * side.width))
        )
        differences.append({name: (high[name] - low[name]) / side.width for name in low})
    n_dim = reduced.basis.velocity_modes.shape[-1]
    return {
        name: totals(np.stack([loads[name] for loads in differences]), n_dim)
        for name in reduced.forces
    }
