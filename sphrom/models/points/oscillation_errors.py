"""Estimated errors of oscillations, from training runs that a model on limit cycles doesn't know.

A figure q of an oscillation is its frequency, its amplitude or its mean. Each training run k in
turn is left out of the cycles, and the cycle that the others give at its parameters has an error
e_k in the figure. A model interpolates between all training runs, so its error is

    e^2 = e_0^2 + e_n^2 + (s P)^2 + |sum_k (v_k - w_k) q_k|^2,    s^2 = mean_k (e_k / P_k)^2.

e_0 is the error of repeated training runs, and e_n the scatter within full runs, which hold few
periods and may change slowly (both interpolated between the runs). P is the error of an
interpolation up to a factor (`CycleClosure.distance`), and P_k that of one without run k. The
weights w of training runs interpolate in the viscosity, and the weights v in its inverse, because
both laws are plausible. Two runs determine no s; only the laws count then.

The phase drifts by the error of the frequency, without its e_0, over the time of the run.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sphrom.arrays import Array
from sphrom.metrics.measures import combined, items
from sphrom.metrics.series import ESTIMATED
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.quantities import quantities_of
from sphrom.reduction.limit_cycles import CycleClosure
from sphrom.reduction.trained_basis import ALL_MODES
from sphrom.sph.fluid import Factors

FIGURES = ESTIMATED[:3]
SCATTERS = ("frequency_scatter", "amplitude_scatter", "amplitude_scatter")
"""Their scatters; that of the mean is taken from the amplitude."""
WITHOUT = {"amplitude": 0.0} | dict.fromkeys(SCATTERS, 0.0)
"""Figures of a history without an oscillation."""


@dataclass(frozen=True)
class OscillationErrors:
    """The errors of an oscillation in training runs."""

    closure: CycleClosure
    recorded: Array
    """(n_runs, 3) FIGURES of the full runs."""
    repeated: Array
    """(n_runs, 4) errors of repeated training runs in FIGURES and in the phase [deg]."""
    scatter: Array
    """(n_runs, 3) scatter within full runs."""
    rates: Array
    """(3,) errors between training runs over the distance from them."""

    def at(self, viscosity: float, factors: Factors, duration: float) -> dict[str, float]:
        """Return the estimated errors of FIGURES, and of the phase after a time [s] in degrees."""
        between = self.rates * self.closure.distance(viscosity, factors)
        weights, others = self.closure.laws(viscosity, factors)
        laws = (others - weights) @ self.recorded
        repeated, scatter = (
            np.sqrt(np.clip(weights @ squares, squares.min(axis=0), squares.max(axis=0)))
            for squares in (self.repeated**2, self.scatter**2)
        )
        grown = np.linalg.norm((between, laws, scatter), axis=0)
        errors = np.hypot(repeated, np.append(grown, 360.0 * duration * grown[0]))
        return dict(zip(ESTIMATED, errors.tolist(), strict=True))


def oscillation_errors(model: BasisModel) -> dict[str, OscillationErrors]:
    """Return the errors of a model's oscillations, by name; empty without limit cycles.

    Oscillations without a frequency in one of the training runs are left out.
    """
    closure = model.trained.rates[ALL_MODES].closure
    held_out = model.held_out()
    every = np.arange(len(model.points))
    if not isinstance(closure, CycleClosure) or len(held_out) < max(2, len(every)):
        return {}
    case = model.workspace.case
    # Training runs are periodic over all of their time.
    known = {n: replace(each, from_time=-math.inf) for n, each in case.plan.oscillations.items()}
    rows: dict[str, list[list[float]]] = {name: [] for name in known}
    distances = np.zeros((len(every), 1))
    for k, reduced, coordinates in held_out:
        point = model.points[k]
        viscosity = case.plan.kinematic_viscosity(point)
        distances[k] = closure.distance(viscosity, point.factors, np.delete(every, k))
        time = reduced.output_times.time
        own = quantities_of(case, reduced, time, coordinates)
        full = combined(own, items(model.differences, k), 1.0)
        others, rates = _without(model, k)
        left = others.corrected(others.projected(point, in_training=True), point)
        states = rates.cycle_at(viscosity, point.factors).at(time)
        predicted = quantities_of(case, left, time, states)
        for name, each in known.items():
            found = [WITHOUT | each.of(time, run[each.measure]) for run in (full, own, predicted)]
            beside = each.of(time, own[each.measure], full[each.measure])
            row = [run.get(figure, math.nan) for run in found for figure in FIGURES]
            row.append(beside.get("phase_error", math.nan))
            row += [found[0][figure] for figure in SCATTERS]
            rows[name].append(row)
    usable = distances[:, 0] > 0.0
    if not usable.any() and (len(every) > 2 or closure.trained.values):
        return {}
    errors = {}
    for name, figures in rows.items():
        recorded, own_figures, left_out, phase, scatter = np.split(
            np.array(figures), (3, 6, 9, 10), axis=1
        )
        ratios = (left_out - recorded)[usable] / distances[usable]
        one = OscillationErrors(
            closure=closure,
            recorded=recorded,
            repeated=np.hstack((own_figures - recorded, phase)),
            scatter=scatter,
            # Those of cycles that vanish have no frequency.
            rates=np.sqrt(np.ma.masked_invalid(ratios**2).mean(axis=0).filled(0.0)),
        )
        if np.isfinite(one.repeated).all():
            errors[name] = one
    return errors


def _without(model: BasisModel, k: int) -> tuple[BasisModel, CycleClosure]:
    """Return a model, with its closure, whose cycles are those of all training runs but `k`."""
    kept = np.delete(np.arange(len(model.points)), k)
    trained = model.trained
    rates = trained.rates[ALL_MODES]
    assert rates.cycles is not None
    cycles = rates.cycles.mapped(lambda values: values[kept])
    forces = {
        name: replace(each, on_cycles=each.on_cycles and each.on_cycles.mapped(lambda v: v[kept]))
        for name, each in trained.forces.items()
    }
    others = copy(model)
    others.points = tuple(model.points[j] for j in kept)
    others.trained = replace(
        trained, rates={ALL_MODES: replace(rates, cycles=cycles)}, forces=forces
    )
    return others, CycleClosure(rates.operators, cycles)
