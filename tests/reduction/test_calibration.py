"""Calibration of reduced rates with systems whose rates are known."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.calibration import Calibration, CorrectedRates, Slope, TrainingRun, calibrate
from sphrom.reduction.polynomial_model import OutputTimes, PolynomialModel
from sphrom.reduction.reduced_operators import Polynomial

INTERVAL = 0.01
VISCOSITY = 1e-2
LINEAR = np.array([[-0.4, -3.0, 0.0], [3.0, -0.5, 0.2], [0.0, 0.1, -0.3]])
QUADRATIC = np.zeros((3, 3, 3))
QUADRATIC[0, 1, 2] = QUADRATIC[0, 2, 1] = 0.3
QUADRATIC[2, 0, 0] = -0.2
TRUE = Polynomial(((np.array([0.5, 0.0, 1.0]), LINEAR, QUADRATIC),))
AT_MEAN = CorrectedRates(
    constant=np.array([0.02, -0.03, 0.01]), linear=0.01 * np.arange(9.0).reshape(3, 3) - 0.04
)
OFF = Polynomial((AT_MEAN.tensors(None),))


def correction(runs: list[TrainingRun], *settings: float, **more: float) -> Polynomial:
    """What runs at one viscosity call for."""
    return calibrate(runs, *settings, **more).at(VISCOSITY)


def run_of(polynomial: Polynomial, start, n_snapshots: int = 801, amplitude=None) -> np.ndarray:
    output_times = OutputTimes(INTERVAL, n_snapshots)
    model = PolynomialModel(polynomial)
    n_steps, begin = 4 * (n_snapshots - 1), np.asarray(start, dtype=float)
    return model.run(n_steps, begin, output_times, amplitude).coordinates


STARTS = ([1.0, 0.0, 0.0], [0.0, -2.0, 1.0], [0.5, 1.0, -1.0])


@pytest.fixture(scope="module")
def runs() -> list[np.ndarray]:
    return [run_of(TRUE, start) for start in STARTS]


@pytest.mark.parametrize("off", [OFF, OFF.scaled(0.0)], ids=["wrong", "right"])
def test_a_known_error_of_the_rates_is_found(runs, off):
    wrong = TRUE.plus(off, -1.0)
    found = correction(
        [TrainingRun(wrong, run, VISCOSITY) for run in runs], INTERVAL, 0.1, penalty=0.0
    )
    # Averages and central differences are of second order in the interval.
    assert np.allclose(found.powers[0][0], off.powers[0][0], atol=2e-3)
    assert np.allclose(found.powers[0][1], off.powers[0][1], atol=2e-3)


def test_a_flow_that_nothing_drives_still_comes_to_rest():
    decaying = Polynomial(((np.zeros(3), LINEAR, QUADRATIC),))
    biased = run_of(decaying, STARTS[0]) + np.array([0.01, 0.0, -0.02])
    found = correction([TrainingRun(decaying, biased, VISCOSITY)], INTERVAL, 0.1)
    assert not found(np.zeros(3)).any()
    assert found.powers[0][1].any()


def test_an_error_that_changes_with_the_flow_s_energy_is_found():
    linear = np.array([[-0.4, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, -0.3]])
    quadratic = np.array([0.0, 0.1, -0.05])[:, None, None] * np.eye(3)
    off = Polynomial(((np.zeros(3), np.zeros((3, 3)), quadratic),))
    true = Polynomial(((np.zeros(3), linear, QUADRATIC),))
    runs = [TrainingRun(true.plus(off, -1.0), run_of(true, start), VISCOSITY) for start in STARTS]
    found = correction(runs, INTERVAL, 0.1, penalty=1e-8)
    for state in ([1.0, 0.5, -0.5], [0.0, -1.0, 0.5]):
        np.testing.assert_allclose(found(np.array(state)), off(np.array(state)), atol=2e-3)


def test_oscillations_faster_than_the_window_are_averaged_out():
    # Seen every 0.03 s, an oscillation of 12 Hz can't be differentiated.
    time = 0.03 * np.arange(400)
    slow = run_of(TRUE, STARTS[0], 1198)[::3]
    sound = 0.02 * np.stack([np.cos(2.0 * np.pi * 12.0 * time + k) for k in range(3)], axis=1)
    wrong = TRUE.plus(Polynomial(((OFF.powers[0][0], np.zeros((3, 3))),)), -1.0)
    found = correction([TrainingRun(wrong, slow + sound, VISCOSITY)], 0.03, 0.24, penalty=1e-6)
    assert np.allclose(found.powers[0][0], OFF.powers[0][0], atol=5e-3)


def test_the_body_force_is_no_error_of_the_rates():
    own = TRUE.powers[0]
    driven = Polynomial((own, (np.array([0.0, 1.0, 0.0]), np.zeros((3, 3)))))

    def amplitude(times):
        return np.sin(times)

    run = run_of(driven, STARTS[0], amplitude=amplitude)
    forces = amplitude(INTERVAL * np.arange(len(run)))
    known = correction([TrainingRun(driven, run, VISCOSITY, forces)], INTERVAL, 0.1)
    unknown = correction([TrainingRun(driven, run, VISCOSITY)], INTERVAL, 0.1)
    assert np.abs(known.powers[0][0]).max() < 2e-3 < np.abs(unknown.powers[0][0]).max()
    assert all(map(np.array_equal, driven.plus(known).powers[1], driven.powers[1]))


def test_runs_shorter_than_the_window_still_count():
    run = run_of(TRUE, STARTS[0], 6)
    found = correction([TrainingRun(TRUE.plus(OFF, -1.0), run, VISCOSITY)], INTERVAL, 10.0)
    assert np.isfinite(found.powers[0][1]).all()
    assert np.linalg.norm(found.powers[0][0]) > 0.0


def test_without_enough_snapshots_there_is_nothing_to_calibrate_with():
    with pytest.raises(ValueError, match="calibrate with"):
        calibrate([TrainingRun(TRUE, np.zeros((2, 3)), VISCOSITY)], INTERVAL, 0.1)


def test_a_known_error_that_follows_the_viscosity_is_found(runs):
    slope = CorrectedRates(constant=np.array([0.0, 0.02, 0.0]), linear=np.diag([0.0, 0.1, -0.05]))
    known = Calibration(at_mean=AT_MEAN, slope=slope, mean_viscosity=2e-2)
    wrong = [
        TrainingRun(TRUE.plus(known.at(viscosity), -1.0), run, viscosity)
        for run, viscosity in zip(runs, (1e-2, 2e-2, 3e-2), strict=True)
    ]
    more = [TrainingRun(TRUE.plus(known.at(v), -1.0), run, v) for run in runs for v in (1e-2, 3e-2)]
    found = calibrate(wrong + more, INTERVAL, 0.1, penalty=1e-9)
    for viscosity in (1e-2, 1.7e-2, 4e-2):
        ours, theirs = found.at(viscosity), known.at(viscosity)
        assert np.allclose(ours.powers[0][0], theirs.powers[0][0], atol=5e-3)
        assert np.allclose(ours.powers[0][1], theirs.powers[0][1], atol=5e-3)


def test_one_viscosity_tells_nothing_of_others(runs):
    found = calibrate([TrainingRun(TRUE, run, VISCOSITY) for run in runs], INTERVAL, 0.1)
    assert np.all(found.slope.constant == 0.0)
    assert np.all(found.slope.linear == 0.0)


def test_a_known_error_that_follows_another_parameter_is_found(runs):
    rates = {"constant": np.array([0.01, 0.0, -0.02]), "linear": np.diag([0.05, 0.0, -0.05])}
    none = CorrectedRates(constant=np.zeros(3), linear=np.zeros((3, 3)))
    known = Calibration(
        at_mean=AT_MEAN,
        slope=none,
        mean_viscosity=VISCOSITY,
        others={"lid": Slope(**rates, mean=0.75, largest=1.0)},
    )
    given = [(run, {"lid": lid}) for run in runs for lid in (0.5, 1.0)]
    found = calibrate(
        [
            TrainingRun(TRUE.plus(known.at(VISCOSITY, at), -1.0), run, VISCOSITY, None, at)
            for run, at in given
        ],
        INTERVAL,
        0.1,
        penalty=1e-9,
    )
    for lid in (0.5, 0.8, 1.2):
        ours, theirs = found.at(VISCOSITY, {"lid": lid}), known.at(VISCOSITY, {"lid": lid})
        assert np.allclose(ours.powers[0][0], theirs.powers[0][0], atol=5e-3)
        assert np.allclose(ours.powers[0][1], theirs.powers[0][1], atol=5e-3)
