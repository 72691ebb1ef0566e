"""The time steps of models on the reference points, and when their runs count as diverged."""

from __future__ import annotations

import math
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from sphrom.case.model_sections import PointModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.models.points.basis_model import steps_of
from sphrom.models.points.fast_model import FastRun
from sphrom.reduction import reference_model
from sphrom.reduction.polynomial_model import OutputTimes, Run
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.setup.assembly import output_times_of

CASE = Case.model_validate({"name": "x", "scene": {"kind": "taylor-green"}})
PLAN = CASE.plan.steps


def growing(rate: float) -> ReferenceModel:
    """Return one coordinate that grows or decays at a rate [1/s], from one."""
    polynomial = Polynomial(((np.zeros(1), np.array([[rate]])),))
    return ReferenceModel(
        polynomial=polynomial,
        basis=Mock(n_modes=1, singular_values={"joint": np.array([1.0, 0.1])}),
        start=np.ones(1),
        output_times=OutputTimes(PLAN.snapshot_interval, PLAN.n_snapshots, largest_norm=1e3),
        mean_density_fluctuation=0.0,
        states=np.ones((1, 1)),
    )


def steps(reduced: ReferenceModel, time_step: float | str = "auto") -> int:
    model = PointModelSection(name="x", evaluation="operators", time_step=time_step)
    return steps_of(model, reduced, PLAN.every).n_steps


def timed(reduced: ReferenceModel, n_steps: int) -> tuple[Run, float]:
    steps = reference_model.runge_kutta(reduced, n_steps)
    return reference_model.Integrator(reduced, steps).timed(2)


def test_steps_are_automatic_given_or_the_full_model_s() -> None:
    interval, n_intervals = PLAN.snapshot_interval, PLAN.n_snapshots - 1
    duration = interval * n_intervals
    assert steps(growing(0.0)) == 1
    assert 1 < steps(growing(-3.0 / duration)) < 6
    fast = 10.0 * n_intervals
    assert steps(growing(-fast / duration)) >= fast / 2.785 / 0.9
    assert steps(growing(-1.0), "fom") == PLAN.every * n_intervals
    assert steps(growing(-1.0), interval / 3.0) == 3 * n_intervals


def test_more_steps_than_a_run_can_take_are_refused() -> None:
    with pytest.raises(CaseError, match=r"x is stable only with steps below 2\.79e-15 s, more"):
        steps(growing(-1e15))


def test_a_run_that_grows_is_kept_until_it_is_no_flow() -> None:
    interval = PLAN.snapshot_interval
    runs, seconds = timed(growing(1.0 / interval), 4 * (PLAN.n_snapshots - 1))
    failure = FastRun(**vars(runs), model=Mock(), point=Mock(), reduced=Mock()).failure
    assert failure is not None
    assert "unstable after t = " in str(failure)
    kept = np.isfinite(runs.coordinates[:, 0])
    assert kept.sum() == 7  # e^6 is below the limit, e^7 is not
    assert runs.coordinates[kept].max() < 1e3
    assert seconds > 0.0
    steady, _ = timed(growing(0.0), 1)
    still = FastRun(**vars(steady), model=Mock(), point=Mock(), reduced=Mock())
    assert still.failure is None


def test_a_run_diverges_at_three_times_the_largest_trained_state() -> None:
    """As many times more, as parameters or the time are beyond the trained ones."""
    states = np.array([[3.0, 4.0], [1.0, 0.0]])
    for reynolds, longer, expected in ((50.0, 1, 15.0), (250.0, 1, 37.5), (100.0, 2, 30.0)):
        times = output_times_of(CASE, PLAN, states, ParameterPoint(reynolds))
        times = replace(times, n_snapshots=longer * (PLAN.n_snapshots - 1) + 1)
        assert math.sqrt(times.largest_square) == pytest.approx(expected)
