"""The closure by limit cycles, on the mean-field model of a wake (Noack and others 2003)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sphrom.metrics.series import SHEDDING, STEADY, UNDECIDED, dominant_frequency
from sphrom.models.points.oscillation_errors import OscillationErrors
from sphrom.reduction.cycle_fits import LimitCycle, fitted_cycle, harmonics_of
from sphrom.reduction.limit_cycles import CycleClosure, TrainedCycles
from sphrom.reduction.reduced_measures import PointForce
from sphrom.reduction.reduced_operators import Polynomial, ReducedOperators

N_MODES = 5
VISCOSITIES = np.array([1.0 / 80.0, 1.0 / 120.0])
ONSET = 50.0


def rates_of(reynolds: float, a: np.ndarray) -> np.ndarray:
    """Return the rates of an oscillation, its shift of the mean, and two modes that follow it."""
    growth, omega = 0.5 * (1.0 - ONSET / reynolds), 3.0 - 100.0 / reynolds
    x, y, shift, p, q = a
    return np.array(
        [
            (growth - shift) * x - omega * y,
            omega * x + (growth - shift) * y,
            2.0 * (x * x + y * y - shift),
            x * x - y * y - p,
            2.0 * x * y - q,
        ]
    )


def integrated(rates, start: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    times = np.linspace(0.0, end, 40 * round(end))
    found = solve_ivp(lambda t, a: rates(a), (0.0, end), start, t_eval=times, rtol=1e-9, atol=1e-9)
    return times, found.y.T


def trained(reynolds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ten periods and more of a settled run."""
    times, states = integrated(lambda a: rates_of(reynolds, a), 0.1 * np.ones(N_MODES), 160.0)
    return times[-1600:], states[-1600:]


@pytest.fixture(scope="module")
def operators() -> ReducedOperators:
    """A model that lacks some of the truth: its growth is wrong, and so is its frequency."""
    zero = np.zeros(N_MODES), np.zeros((N_MODES,) * 2), np.zeros((N_MODES,) * 3)
    linear = np.diag([0.45, 0.45, -2.0, 0.2, -0.5])
    linear[0, 1], linear[1, 0] = -1.7, 1.7
    products = np.zeros((N_MODES,) * 3)
    for k in (0, 1):
        products[k, k, 2] = products[k, 2, k] = -0.5
        products[2, k, k] = 2.0
    products[3, 0, 0], products[3, 1, 1] = 1.0, -1.0
    products[4, 0, 1] = products[4, 1, 0] = 1.0
    inertia = zero[0], linear, products
    return ReducedOperators(inertia=inertia, viscosity=zero, acoustic=zero[1])


@pytest.fixture(scope="module")
def closure(operators: ReducedOperators) -> CycleClosure:
    cycles = [fitted_cycle(*trained(1.0 / nu)) for nu in VISCOSITIES]
    return CycleClosure(operators, TrainedCycles.of_runs(VISCOSITIES, [{}, {}], cycles, 0.0))


@pytest.mark.parametrize("reynolds", [55.0, 80.0, 100.0, 120.0, 150.0])
def test_the_cycle_is_that_of_stuart_and_landau(closure: CycleClosure, reynolds: float) -> None:
    cycle = closure.cycle_at(1.0 / reynolds)
    squares = np.sum(cycle.states[:, :2] ** 2, axis=1)
    assert cycle.frequency == pytest.approx(3.0 - 100.0 / reynolds, rel=1e-6)
    assert squares == pytest.approx(0.5 * (1.0 - ONSET / reynolds), rel=1e-4)


@pytest.mark.parametrize("reynolds", [80.0, 100.0, 120.0])
def test_a_model_settles_on_the_cycle(
    operators: ReducedOperators, closure: CycleClosure, reynolds: float
) -> None:
    """Uncorrected it settles on another one."""
    start, (_, truth) = 0.3 * np.ones(N_MODES), trained(reynolds)
    for added, tolerance in ((closure.at(1.0 / reynolds), 2e-3), (None, None)):
        rates = operators.at(1.0 / reynolds)
        times, states = integrated(rates if added is None else rates.plus(added), start, 120.0)
        late = slice(-1600, None)
        amplitude = np.abs(states[late, 0]).max() / np.abs(truth[:, 0]).max()
        frequency = dominant_frequency(times[late], states[late, 0])
        wanted = (3.0 - 100.0 / reynolds) / (2.0 * np.pi)
        if tolerance is None:
            assert amplitude != pytest.approx(1.0, abs=0.03)
        else:
            assert amplitude == pytest.approx(1.0, abs=tolerance)
            assert frequency == pytest.approx(wanted, rel=1e-3)
            assert states[late].mean(axis=0) == pytest.approx(truth.mean(axis=0), abs=0.03)


@pytest.mark.parametrize("reynolds", [43.0, 30.0])
def test_below_the_onset_models_end_in_the_steady_state(
    operators: ReducedOperators, closure: CycleClosure, reynolds: float
) -> None:
    """The truth is zero there, whereas the mean of its cycles would go on to fall."""
    rates = operators.at(1.0 / reynolds).plus(closure.at(1.0 / reynolds))
    _, states = integrated(rates, 0.3 * np.ones(N_MODES), 300.0)
    assert np.abs(states[-400:]).max() < 2e-3
    assert closure.regime(1.0 / reynolds) == STEADY


def law(values: list[float], squares: list[float], factors: list[dict[str, float]]) -> CycleClosure:
    """Return a closure of cycles with some squared amplitudes."""
    harmonics = np.zeros((len(values), 5, N_MODES), dtype=complex)
    harmonics[:, 1, 0] = np.sqrt(squares)
    cycles = [LimitCycle(1.0, each) for each in harmonics]
    trained = TrainedCycles.of_runs(1.0 / np.array(values), factors, cycles, 0.0)
    return CycleClosure(None, trained)  # type: ignore[arg-type]


def test_the_onset_is_that_of_the_trained_cycles(closure: CycleClosure) -> None:
    assert 1.0 / closure.onsets()[0] == pytest.approx(ONSET, rel=1e-5)


def test_between_estimates_the_regime_is_undecided() -> None:
    values, squares = [80.0, 100.0, 120.0], [0.375, 0.51, 7.0 / 12.0]
    found = law(values, squares, [{}] * 3)
    pairs = np.array([[1, 2], [0, 2], [0, 1]])
    lines = [np.polyfit(1.0 / np.array(values)[p], np.array(squares)[p], 1) for p in pairs]
    assert found.onsets()[1:4] == pytest.approx([-b / a for a, b in lines], rel=1e-9)
    low, high = 1.0 / max(found.onsets()), 1.0 / min(found.onsets())
    assert low < 48.0 < 52.0 < high
    wanted = {low - 0.1: STEADY, low + 0.1: UNDECIDED, high - 0.1: UNDECIDED, high + 0.1: SHEDDING}
    assert {value: found.regime(1.0 / value) for value in wanted} == wanted


def test_the_line_that_is_continued_is_that_of_all_runs() -> None:
    """An amplitude near the end of the range that is too large changes it little."""
    values, squares = np.array([60.0, 80.0, 120.0]), [1.0 / 6.0, 0.375 + 0.04, 7.0 / 12.0]
    slope = np.polyfit(1.0 / values, squares, 1)[0]
    onset = law(list(values), squares, [{}] * 3).onsets()[0]
    assert onset == pytest.approx(1.0 / 60.0 - squares[0] / slope, rel=1e-9)
    assert 1.0 / onset == pytest.approx(ONSET, rel=0.01)


def test_estimates_of_the_onset_agree_better_the_nearer_the_runs_are() -> None:
    spreads = []
    for values in ([80.0, 120.0], [60.0, 80.0], [55.0, 80.0]):
        onsets = 1.0 / np.array(law(values, [1.0 - ONSET / v for v in values], [{}] * 2).onsets())
        assert onsets[0] == pytest.approx(ONSET)
        assert onsets.min() < ONSET < onsets.max()
        spreads.append(np.ptp(onsets))
    assert spreads[0] > 2.0 * spreads[1] > 2.0 * spreads[2]


def test_the_onset_depends_on_other_parameters() -> None:
    """The width of a channel, say, moves it from 50 to 60."""
    values = [80.0, 120.0, 80.0, 120.0]
    factors = [{"width": w} for w in (1.0, 1.0, 2.0, 2.0)]
    squares = [1.0 - (40.0 + 10.0 * f["width"]) / v for v, f in zip(values, factors, strict=True)]
    found = law(values, squares, factors)
    for width, onset in ((1.0, 50.0), (1.5, 55.0), (2.0, 60.0)):
        assert 1.0 / found.onsets({"width": width})[0] == pytest.approx(onset, rel=0.04)


def test_the_error_between_runs_is_that_of_the_natural_spline() -> None:
    values = np.array([60.0, 80.0, 120.0])
    found = law(list(values), 1.0 - ONSET / values, [{}] * 3)
    assert [found.distance(1.0 / value, {}) for value in values] == pytest.approx([0.0] * 3)
    distances = [found.distance(1.0 / value, {}) for value in (70.0, 50.0, 40.0, 150.0, 200.0)]
    assert 0.0 < distances[0] < distances[1] < distances[2]
    assert 0.0 < distances[3] < distances[4]
    # In the middle between two runs at a distance h, the square is h^3 / 4.
    two = found.distance(1.0 / 80.0, {}, np.array([0, 2]))
    assert two**2 == pytest.approx(0.5**3 / 4.0, rel=1e-9)
    assert found.distance(1.0 / 80.0, {}, np.array([0])) == 0.0


def test_errors_of_oscillations_grow_with_the_distance_from_training_runs() -> None:
    values = np.array([60.0, 80.0, 120.0])
    closure = law(list(values), 1.0 - ONSET / values, [{}] * 3)
    # The frequency is linear in the viscosity, the amplitude in its inverse.
    figures = np.stack((0.2 - 3.0 / values, 0.01 * values, np.zeros(3)), axis=1)
    known = OscillationErrors(
        closure=closure,
        recorded=figures,
        repeated=np.tile([1e-3, 2e-3, 3e-3, 4.0], (3, 1)),
        scatter=np.zeros((3, 3)),
        rates=np.array([0.0, 0.0, 1.0]),
    )
    at_run, beside, outside = (known.at(1.0 / value, {}, 10.0) for value in (80.0, 90.0, 160.0))
    assert list(at_run.values()) == pytest.approx([1e-3, 2e-3, 3e-3, 4.0])
    for name in at_run:
        assert at_run[name] < beside[name] < outside[name], name
    assert beside["mean"] == pytest.approx(np.hypot(3e-3, closure.distance(1.0 / 90.0, {})))
    drift = 3600.0 * np.sqrt(outside["frequency"] ** 2 - 1e-6)
    assert outside["phase"] == pytest.approx(np.hypot(4.0, drift))


def test_runs_at_one_viscosity_determine_no_onset() -> None:
    found = law([100.0], [0.5], [{}])
    assert set(found.onsets()) == {np.inf}
    assert [found.regime(1.0 / value) for value in (100.0, 90.0)] == [SHEDDING, UNDECIDED]


def test_an_oscillation_that_decays_is_refused() -> None:
    times, states = integrated(lambda a: rates_of(49.0, a), 0.1 * np.ones(N_MODES), 40.0)
    with pytest.raises(ValueError, match=r"its oscillation decays, by \d+ % .* may be steady"):
        fitted_cycle(times, states)


def test_a_force_has_what_training_runs_recorded(closure: CycleClosure) -> None:
    """The model's own force lacks a constant and part of what follows the oscillation."""
    loads, linear = [], np.zeros((6, N_MODES))
    linear[0, 0] = 1.0
    own = PointForce(Polynomial(((np.zeros(6), linear),)), np.zeros((6, N_MODES)), np.zeros((2, 6)))
    for nu, cycle in zip(VISCOSITIES, closure.trained.cycles, strict=True):
        times, states = trained(1.0 / nu)
        recorded = np.zeros((len(times), 6))
        recorded[:, 0] = 2.0 + 3.0 * states[:, 0] + states[:, 3]
        loads.append(harmonics_of(times, recorded, cycle.frequency))
    force = closure.force_at(own, [own, own], loads, 1.0 / 100.0, {})
    _, states = trained(100.0)
    found = force.at(np.zeros(len(states)), states, 0.0 * states, np.zeros(len(states)))
    expected = 2.0 + 3.0 * states[:, 0] + states[:, 3]
    assert found[:, 0, 0] == pytest.approx(expected, abs=1e-2)


@pytest.mark.parametrize(("reynolds", "expected"), [(30.0, 2.0), (200.0, 3.0)])
def test_differences_of_forces_are_not_extrapolated(
    closure: CycleClosure, reynolds: float, expected: float
) -> None:
    zero = Polynomial(((np.zeros(6), np.zeros((6, N_MODES))),))
    own = PointForce(zero, np.zeros((6, N_MODES)), np.zeros((2, 6)))
    loads = [np.zeros((5, 6), dtype=complex) for _ in VISCOSITIES]
    loads[0][0, 0], loads[1][0, 0] = 2.0, 3.0
    force = closure.force_at(own, [own, own], loads, 1.0 / reynolds, {})
    found = force.at(np.zeros(1), np.zeros((1, N_MODES)), np.zeros((1, N_MODES)), np.zeros(1))
    assert found[0, 0, 0] == pytest.approx(expected, abs=1e-6)


def test_what_is_not_periodic_is_refused() -> None:
    times = np.linspace(0.0, 20.0, 400)
    random = np.random.default_rng(1)
    walk = np.cumsum(random.standard_normal((400, 3)), axis=0)
    with pytest.raises(ValueError, match=r"not periodic|no oscillation"):
        fitted_cycle(times, walk + 3.0 * np.sin(9.0 * times)[:, None] * [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("line", "size", "refused"), [(1.7, 0.305, True), (1.7, 0.1, False)])
def test_a_second_line_is_refused_by_its_frequency(line: float, size: float, refused: bool) -> None:
    times = np.linspace(0.0, 40.0, 800)
    waves = [np.exp(2j * np.pi * f * times) for f in (0.7, line, 1.4)]
    parts = [waves[0].real, waves[0].imag, size * waves[1].real, 0.5 * waves[2].real]
    states = np.stack(parts, axis=1)
    if refused:
        share = 50.0 * size**2 / (1.0 + 0.5 * 0.25 + 0.5 * size**2)
        found = rf"harmonics of 0\.7 Hz explain .* second line, of 1\.7 Hz, {share:.0f}\.\d %"
        with pytest.raises(ValueError, match=found):
            fitted_cycle(times, states)
    else:
        assert fitted_cycle(times, states).frequency == pytest.approx(1.4 * np.pi, rel=1e-3)


def test_harmonics_are_those_of_the_series() -> None:
    times = np.linspace(3.0, 17.0, 300)
    values = np.stack((2.0 + np.cos(1.3 * times), 0.5 * np.sin(2.6 * times)), axis=1)
    found = LimitCycle(1.3, harmonics_of(times, values, 1.3)).harmonics
    expected = np.zeros((5, 2), dtype=complex)
    expected[0, 0], expected[1, 0], expected[2, 1] = 2.0, 1.0, -0.5j
    assert found == pytest.approx(expected, abs=1e-9)
