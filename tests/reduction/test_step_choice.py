"""Steps that are stable and fine enough for what a basis leaves out."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest

from sphrom.reduction.polynomial_model import OutputTimes, PolynomialModel, step_limit, steps_within
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.reference_model import (
    FINEST,
    LEAST_ERROR,
    Steps,
    accurate,
    step_tolerance,
)

SOUND = 20.0
"""Of what oscillates [1/s]."""
START = np.array([1.0, 0.5, 0.0])
OUTPUT_TIMES = OutputTimes(0.05, 41, largest_norm=1e3)


def decaying_sound(rate: float = -0.3) -> Polynomial:
    """Return a slow decay, or growth, beside an oscillation."""
    linear = np.array([[rate, 0.0, 0.0], [0.0, -0.1, SOUND], [0.0, -SOUND, -0.1]])
    return Polynomial(((np.zeros(3), linear),))


def steps(polynomial: Polynomial, tolerance: float, start: np.ndarray = START) -> tuple[int, int]:
    """Return accurate steps and stable ones."""
    duration = OUTPUT_TIMES.time[-1]
    n_stable = steps_within(duration, step_limit(polynomial, start[None]))
    model = Mock(start=start, output_times=OUTPUT_TIMES, amplitude=None, n_stable=0)
    first = Steps(model, PolynomialModel(polynomial), n_stable)
    return accurate(first, tolerance).n_steps, n_stable


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_the_error_is_within_the_tolerance_and_not_far_below(tolerance: float) -> None:
    polynomial = decaying_sound()
    n_steps, n_stable = steps(polynomial, tolerance)
    model = PolynomialModel(polynomial)
    fine, found = (model.run(n, START, OUTPUT_TIMES).coordinates for n in (5000, n_steps))
    error = np.linalg.norm(found - fine) / np.linalg.norm(fine)
    assert 0.3 * tolerance < error < 1.1 * tolerance
    assert n_stable < n_steps < FINEST * n_stable


@pytest.mark.parametrize(
    ("rate", "tolerance", "sound", "finer"),
    [(-0.3, 1e-4, 0.0, 1), (8.0, 1e-4, 0.5, 1), (-0.3, 1e-14, 0.5, FINEST)],
    ids=["no sound in the start", "divergent in any steps", "a limit to how fine they become"],
)
def test_steps_are_stable_or_as_fine_as_can_be(rate, tolerance, sound, finer) -> None:
    n_steps, n_stable = steps(decaying_sound(rate), tolerance, np.array([1.0, sound, 0.0]))
    assert n_steps == finer * n_stable


def test_the_tolerance_is_a_part_of_what_the_basis_leaves_out() -> None:
    joint = Mock(n_modes=2, singular_values={"joint": np.array([4.0, 3.0, 0.3, 0.4])})
    assert step_tolerance(joint) == pytest.approx(0.05 * np.sqrt(0.25 / 25.25))
    whole = Mock(n_modes=2, singular_values={"joint": np.array([4.0, 3.0])})
    assert step_tolerance(whole) == LEAST_ERROR
