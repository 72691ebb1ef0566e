"""Many runs of a model with one basis, computed at once except for the time steps.

Arrays have a first axis of runs. Operations treat each run by itself, so that results are bitwise
equal to single runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import items
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.error_estimates import ErrorEstimate
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.reduction.own_pressure import PointPressure
from sphrom.reduction.reduced_measures import PointForce, TimedLoads
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.reference_model import ReferenceModel

MOST = 64
"""Largest number of runs at once; their arrays have to fit into the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class _Together(FastRun):
    """Runs along the first axis of all arrays, also of the values of the point."""

    basis: str

    @property
    def on_basis(self) -> BasisModel:
        return self.model.on_basis(self.basis)


def can_run_together(model: BasisModel) -> bool:
    """Return whether the rates of a model are sums of constant tensors, without other closures."""
    rates = model.trained.rates.values()
    return all(each.memory is None and each.cycles is None for each in rates)


def run_together(fast: FastModel, name: str, points: Sequence[ParameterPoint]) -> Iterator[FastRun]:
    """Run a model with one of its bases at some points."""
    model = fast.on_basis(name)
    values: Any = np.array([[*point.as_dict().values()] for point in points]).T
    at = ParameterPoint(values[0], tuple(zip(points[0].factors, values[1:], strict=True)))
    viscosity = fast.workspace.case.plan.kinematic_viscosity(at)
    rates = {modes: each.at(viscosity, at.factors) for modes, each in model.trained.rates.items()}
    alone = []
    for k, point in enumerate(points):
        known = {modes: (_item(p, k), c and _item(c, k)) for modes, (p, c) in rates.items()}
        alone.append(model.uncorrected(point, known))
    polynomial, closure = next(iter(rates.values()))
    means: Any = np.array([[one.mean_density_fluctuation] for one in alone])
    together = replace(
        alone[0],
        polynomial=polynomial,
        closure=closure,
        mean_density_fluctuation=means,
        amplitude=lambda time: np.stack([one.amplitudes(time) for one in alone]),
    )
    together = model.corrected(together, at)
    runs = []
    for k, (point, one) in enumerate(zip(points, alone, strict=True)):
        reduced = _corrected(one, together, k)
        found = model.integrator(reduced).run()
        runs.append(FastRun(**vars(found), model=fast, point=point, reduced=reduced))
    whole = _Together(
        model=fast,
        point=at,
        reduced=together,
        basis=name,
        time=runs[0].time,
        coordinates=np.stack([run.coordinates for run in runs]),
        time_step=runs[0].time_step,
        diverged_at=np.nan,
    )
    with np.errstate(all="ignore"):  # the coordinates of unstable runs are not finite
        estimate = whole.estimate
        for k, run in enumerate(runs):
            own = None
            if estimate is not None:
                own = ErrorEstimate(**{name: each[k] for name, each in vars(estimate).items()})
            # The run has these already, and does not compute them again.
            vars(run).update(
                states=whole.states[k],
                measured=items(whole.measured, k),
                estimate=own,
                measured_errors=items(whole.measured_errors, k),
            )
            yield run


def _item(polynomial: Polynomial, k: int) -> Polynomial:
    return Polynomial(tuple(tuple(tensor[k] for tensor in t) for t in polynomial.powers))


def _part(values: Array | None, k: int, n_axes: int) -> Array | None:
    """Return the values of a run; values that are equal in all runs have fewer axes."""
    return values if values is None or values.ndim < n_axes else values[k]


def _corrected(one: ReferenceModel, together: ReferenceModel, k: int) -> ReferenceModel:
    """Return the model of a run with its corrections and forces among those of all runs."""
    forces = {}
    for name, force in together.forces.items():
        loads = force.correction and TimedLoads(force.correction.time, force.correction.loads[k])
        polynomial = _item(force.polynomial, k)
        forces[name] = PointForce(polynomial, force.momentum, force.uniform[k], loads, force.own)
    pressure = together.pressure and PointPressure(
        _item(together.pressure.polynomial, k), _part(together.pressure.correction, k, 3)
    )
    correction = _part(together.correction, k, 3)
    measures = together.measures
    return replace(one, correction=correction, forces=forces, measures=measures, pressure=pressure)
