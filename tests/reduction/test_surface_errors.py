"""Estimated errors of models with a free surface, from errors of training runs that are known."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.surface_errors import RunErrors, RunMeasure, SurfaceErrors

N_RUNS, N_SNAPSHOTS = 3, 40
PLACES = np.array([[0.0], [1.0], [3.0]])
"""The nearest runs are 1, 1 and 2 away."""
APART = 4.0 / 3.0
REPEATED, HELD_OUT = 0.02, 0.1
"""Errors over the amplitude."""


def runs(share: float) -> RunErrors:
    amplitude = np.outer([0.5, 1.0, 2.0], np.linspace(0.1, 1.0, N_SNAPSHOTS))
    fields = np.stack([amplitude, 5.0 * amplitude], axis=2)
    pair = np.stack([amplitude, 3.0 * amplitude], axis=2)[:, :, None]
    return RunErrors(
        places=PLACES,
        amplitude=amplitude,
        fields=share * fields,
        sizes=fields,
        measure={"wall": RunMeasure(quantities={"velocity": share * pair})},
    )


ERRORS = SurfaceErrors(repeated=runs(REPEATED), held_out=runs(HELD_OUT))


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        (0.0, REPEATED),
        (-APART, HELD_OUT),
        (3.0 + APART, HELD_OUT),
        (0.5, np.hypot(REPEATED, 0.5 / APART * np.sqrt(HELD_OUT**2 - REPEATED**2))),
    ],
)
def test_errors_grow_from_those_of_repeated_to_those_of_held_out_runs(
    place: float, expected: float
) -> None:
    over_amplitude = ERRORS.at(np.array([place]))
    shares = over_amplitude(lambda errors: errors.fields)
    np.testing.assert_allclose(shares, [expected, 5.0 * expected])
    wall = over_amplitude(lambda errors: errors.measure["wall"].quantities["velocity"])
    np.testing.assert_allclose(wall, [[expected, 3.0 * expected]])


def test_smaller_errors_of_held_out_runs_do_not_count() -> None:
    lucky = SurfaceErrors(repeated=runs(HELD_OUT), held_out=runs(REPEATED))
    shares = lucky.at(np.array([0.5]))(lambda errors: errors.fields)
    np.testing.assert_allclose(shares[0], HELD_OUT)


def test_errors_are_never_below_the_noise_and_drift_beyond_the_trained_time() -> None:
    scale = ERRORS.scale(np.zeros(2 * N_SNAPSHOTS - 1))
    least = 0.5 * np.sqrt(np.mean(np.linspace(0.1, 1.0, N_SNAPSHOTS) ** 2))
    np.testing.assert_allclose(scale[:N_SNAPSHOTS], least)
    assert scale[-1] == pytest.approx(2.0 * least)
    np.testing.assert_allclose(ERRORS.scale(np.full(3, 7.0)), 7.0)


def test_a_run_at_rest_does_not_make_estimates_absurd() -> None:
    def with_rest(share: float) -> RunErrors:
        known = runs(share)
        amplitude = known.amplitude.copy()
        amplitude[0] = 1e-16
        fields = known.fields.copy()
        fields[0] = 1e-3
        return RunErrors(places=PLACES, amplitude=amplitude, fields=fields, sizes=fields)

    errors = SurfaceErrors(repeated=with_rest(REPEATED), held_out=with_rest(HELD_OUT))
    shares = errors.at(np.array([0.5]))(lambda known: known.fields)
    assert shares[0] < HELD_OUT
    np.testing.assert_array_less(0.05, errors.waves(np.zeros(4)))
