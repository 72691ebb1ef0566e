"""Steps that carry a linear part exactly."""

from __future__ import annotations

import math
from itertools import permutations
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.linalg import expm

from sphrom.reduction.exponential_steps import (
    ExponentialModel,
    LinearPart,
    StepRatio,
    integrals,
)
from sphrom.reduction.polynomial_model import Amplitude, OutputTimes, PolynomialModel
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.reference_model import LONGER, Steps, accurate

SOUND = 300.0
"""Of what oscillates [1/s]."""
LINEAR = np.array([[-0.3, 0.2, 0.0], [0.1, -0.1, SOUND], [0.4, -SOUND, -0.5]])
START = np.array([1.0, 0.02, -0.01])


def flow(seed: int = 3, degree: int = 2) -> Polynomial:
    """Return sound in a flow that moves at rates near one."""
    random = np.random.default_rng(seed)
    parts: list[np.ndarray] = [0.3 * random.standard_normal(3), LINEAR]
    for d in range(2, degree + 1):
        tensor = random.standard_normal((3,) * (d + 1))
        orders = [tensor.transpose(0, *axes) for axes in permutations(range(1, d + 1))]
        parts.append(0.3 * np.mean(orders, axis=0))
    return Polynomial((tuple(parts),))


def driven(seed: int = 3) -> Polynomial:
    """Return such a flow that an amplitude drives."""
    still = flow(seed).powers[0]
    return Polynomial((still, (np.array([1.0, -0.5, 0.2]), 0.2 * np.diag([-1.0, 0.5, 0.3]))))


def jacobian(polynomial: Polynomial) -> np.ndarray:
    return polynomial.jacobian(START, 0.5)


def exact(
    polynomial: Polynomial, output_times: OutputTimes, drive: Amplitude | None = None
) -> np.ndarray:
    n_steps = 4000 * (output_times.n_snapshots - 1) // 10
    runs = PolynomialModel(polynomial).run(n_steps, START, output_times, drive)
    return runs.coordinates


@pytest.mark.parametrize("time", [1e-6, 0.004, 0.3])
def test_integrals_are_those_of_the_exponential(time: float) -> None:
    found = integrals(LINEAR, time)
    assert np.allclose(found[0], expm(time * LINEAR), atol=1e-12)
    scale = time ** np.arange(4)[:, None, None]
    for k in range(1, 4):
        # L times one is the one before, less its Taylor term.
        rest = found[k - 1] - time ** (k - 1) / math.factorial(k - 1) * np.eye(3)
        assert np.allclose(LINEAR @ found[k], rest, atol=1e-11 * scale[k - 1])
    assert np.allclose(
        integrals(np.zeros((3, 3)), time) / scale,
        np.array([np.eye(3) / math.factorial(k) for k in range(4)]),
    )


def test_integrals_at_multiples_are_those_there() -> None:
    linear = LinearPart(LINEAR)
    for multiple in (7, 1, 2, 40):
        expected = integrals(LINEAR, 0.003 * multiple)
        assert np.allclose(linear.integrals(0.003, multiple), expected, atol=1e-11)


@pytest.mark.parametrize("n_intervals", [1, 2, 7, 200, 834])
def test_strides_meet_snapshots(n_intervals: int) -> None:
    for asked in range(1, 2 * n_intervals + 3):
        ratio = StepRatio.of(asked, n_intervals)
        taken = ratio.n_steps(n_intervals)
        assert min(ratio.snapshots_per_step, ratio.steps_per_snapshot) == 1
        assert taken >= asked
        assert StepRatio.of(taken, n_intervals) == ratio
        reach = taken * ratio.snapshots_per_step / ratio.steps_per_snapshot
        assert 0.0 <= reach - n_intervals < ratio.snapshots_per_step


@pytest.mark.parametrize("n_steps", [1, 2, 3, 4, 7, 16, 27])
def test_parabolas_in_time_beside_what_is_linear_are_exact_in_any_steps(n_steps: int) -> None:
    """The slow rates are t^2, those of sound linear."""
    constant, none = np.array([0.5, -2.0, 1.0]), np.zeros((3, 3))
    polynomial = Polynomial(((constant, LINEAR), (np.zeros(3), none), (START, none)))
    output_times = OutputTimes(0.1, 11, start_time=2.0)
    model = ExponentialModel(polynomial, LinearPart(LINEAR))
    runs = model.run(n_steps, START, output_times, lambda time: time - 2.0)
    at = [integrals(LINEAR, time) for time in runs.time - 2.0]
    expected = [e[0] @ START + e[1] @ constant + 2.0 * e[3] @ START for e in at]
    assert np.allclose(runs.coordinates, expected, atol=1e-9)
    assert np.isnan(runs.diverged_at)


@pytest.mark.parametrize("time_step", [0.004, 0.02])
def test_a_step_is_that_of_krogstad(time_step: float) -> None:
    """Written out (Krogstad 2005): an order doesn't show a coefficient that is nearly right."""
    polynomial, h = driven(), time_step
    whole, half = integrals(h * LINEAR, 1.0), integrals(0.5 * h * LINEAR, 1.0)

    def rest(state: np.ndarray, time: float) -> np.ndarray:
        return np.asarray(polynomial(state, np.cos(time)) - LINEAR @ state)

    n1 = rest(START, 0.0)
    second = half[0] @ START + 0.5 * h * half[1] @ n1
    n2 = rest(second, 0.5 * h)
    n3 = rest(second + h * half[2] @ (n2 - n1), 0.5 * h)
    fourth = whole[0] @ START + h * whole[1] @ n1 + 2.0 * h * whole[2] @ (n3 - n1)
    n4 = rest(fourth, h)
    expected = whole[0] @ START + h * (
        (whole[1] - 3.0 * whole[2] + 4.0 * whole[3]) @ n1
        + (2.0 * whole[2] - 4.0 * whole[3]) @ (n2 + n3)
        + (4.0 * whole[3] - whole[2]) @ n4
    )
    model = ExponentialModel(polynomial, LinearPart(LINEAR))
    runs = model.run(1, START, OutputTimes(h, 2), np.cos)
    assert np.allclose(runs.coordinates[1], expected, rtol=0.0, atol=1e-13)


def test_steps_and_snapshots_within_them_are_of_fourth_order() -> None:
    polynomial, output_times = driven(), OutputTimes(0.001, 121)
    model = ExponentialModel(polynomial, LinearPart(LINEAR))
    truth = exact(driven(), output_times, np.cos)
    numbers = np.array([24, 30, 40, 60, 120])
    errors = [
        np.max(np.abs(model.run(n, START, output_times, np.cos).coordinates - truth))
        for n in numbers
    ]
    assert 3.7 < -np.polyfit(np.log(numbers), np.log(errors), 1)[0] < 4.6


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("n_steps", [4, 10, 13, 40])
def test_any_linear_part_gives_the_same_solution(degree: int, n_steps: int) -> None:
    polynomial, output_times = flow(degree=degree), OutputTimes(0.001, 41)
    truth = exact(polynomial, output_times)
    for linear in (LINEAR, polynomial.jacobian(START), 0.9 * LINEAR):
        model = ExponentialModel(polynomial, LinearPart(linear))
        found = model.run(25 * n_steps, START, output_times).coordinates
        assert np.allclose(found, truth, atol=1e-7)


def test_the_last_step_may_reach_beyond_the_last_snapshot() -> None:
    polynomial = driven()
    model = ExponentialModel(polynomial, LinearPart(jacobian(polynomial)))
    long, short = OutputTimes(0.02, 13), OutputTimes(0.02, 11)  # three times 4 reach 12
    whole, part = (model.run(3, START, s, np.cos) for s in (long, short))
    assert whole.time_step == pytest.approx(0.08)
    assert model.steps_taken(3, short) == model.steps_taken(3, long) == 3
    assert np.array_equal(whole.coordinates[:11], part.coordinates)


@pytest.mark.parametrize(("n_steps", "n_kept"), [(2, 6), (5, 7), (10, 7), (20, 7)])
def test_divergence_is_seen_in_steps_and_snapshots_before_it_are_kept(
    n_steps: int, n_kept: int
) -> None:
    """e^(10 t) passes 1000 between the snapshots at 0.6 and 0.7."""
    polynomial = Polynomial(((np.zeros(1), np.full((1, 1), 10.0)),))
    model = ExponentialModel(polynomial, LinearPart(np.zeros((1, 1))))
    output_times = OutputTimes(0.1, 11, largest_norm=1e3)
    runs = ExponentialModel(polynomial, LinearPart(np.full((1, 1), 10.0))).run(
        n_steps, np.ones(1), output_times
    )
    kept = np.isfinite(runs.coordinates[:, 0])
    assert kept.sum() == n_kept
    assert kept[: kept.sum()].all()
    assert runs.diverged_at == pytest.approx(output_times.time[kept.sum() - 1], abs=0.05)
    blown = model.run(1, np.full(1, 1e200), OutputTimes(0.1, 3))
    assert np.isnan(blown.coordinates[1:]).all()
    assert blown.diverged_at == 0.0


def test_steps_are_chosen_by_the_flow_not_by_sound() -> None:
    polynomial, output_times = flow(), OutputTimes(0.01, 101)
    model = ExponentialModel(polynomial, LinearPart(jacobian(polynomial)))
    n_stable = math.ceil(output_times.time[-1] * SOUND / 2.8)
    reduced = Mock(start=START, output_times=output_times, amplitude=None, n_stable=n_stable)
    first = Steps(reduced, model, n_stable // LONGER)
    errors = {}
    for tolerance in (1e-3, 1e-5):
        n_steps = accurate(first, tolerance).n_steps
        found = model.run(n_steps, START, output_times).coordinates
        truth = exact(polynomial, output_times)
        errors[tolerance] = np.linalg.norm(found - truth) / np.linalg.norm(truth)
        assert errors[tolerance] < 1.1 * tolerance
        assert n_steps == model.steps_taken(n_steps, output_times) < 3 * n_stable
