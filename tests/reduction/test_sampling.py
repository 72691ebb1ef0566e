"""Sampled points: which they are, and reduced rates from them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.reduction import sampling
from sphrom.reduction.operators import UnprojectedModel, project_operators
from sphrom.reduction.polynomial_model import PolynomialModel, Schedule
from sphrom.reduction.sampled_model import (
    Drive,
    SampledModel,
    SampledRemainder,
    integrate,
    remainder_modes,
)
from sphrom.reduction.sampling import choose_points, gappy_projection, weighted_modes
from sphrom.sph.fixed_points import Surroundings

NAMES = [
    "periodic",
    "lid",
    "lid without gauge",
    "driven lid",
    "forced",
    "centred",
    "raw, centred and forced",
]
METHODS = ["random", "q-deim", "s-opt"]
AROUND = Surroundings(0.01, wall_speed=0.6, amplitude=-1.4)


@pytest.fixture(params=NAMES)
def setting(request, settings):
    return settings[request.param]


def close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert np.max(np.abs(actual - expected)) <= tolerance * np.max(np.abs(expected))


def difference(model, setting) -> float:
    """Return the error of rates over that of all points, none of them expanded."""
    exact = UnprojectedModel(setting.points, setting.basis, setting.splines)
    expected = exact(setting.coordinates, AROUND)
    rates = model(setting.coordinates, AROUND)
    return float(np.linalg.norm(rates - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize("method", METHODS)
def test_points_are_different_ones_and_told_by_the_seed(settings, method):
    modes = weighted_modes(settings["lid"].basis)
    chosen = choose_points(modes, 20, method, seed=1)
    assert len(np.unique(chosen)) == 20
    assert np.all(np.diff(chosen) > 0)
    np.testing.assert_array_equal(chosen, choose_points(modes, 20, method, seed=1))
    np.testing.assert_array_equal(choose_points(modes, 10**6, method), np.arange(len(modes)))


@pytest.mark.parametrize("method", METHODS)
def test_samples_give_back_the_coordinates_of_states_of_the_modes(setting, method):
    modes = weighted_modes(setting.basis)
    chosen = choose_points(modes, 6, method, seed=2)
    state = modes[chosen] @ setting.coordinates
    found = np.tensordot(gappy_projection(modes[chosen]), state, 2)
    close(found, setting.coordinates, 1e-9)


def test_chosen_points_are_better_conditioned_than_drawn_ones(settings):
    modes = weighted_modes(settings["periodic"].basis)

    def worst(method, seed=0):
        return np.linalg.norm(gappy_projection(modes[choose_points(modes, 5, method, seed)]))

    drawn = np.median([worst("random", seed) for seed in range(20)])
    assert worst("q-deim") < 0.8 * drawn
    assert worst("s-opt") < 0.8 * drawn


def test_s_optimal_points_raise_s_most(settings):
    """The last of the points is the best of all for those before it."""
    modes = weighted_modes(settings["lid"].basis)
    *first, last = sampling._s_optimal(modes, 12)

    def s(chosen) -> float:
        rows = modes[chosen].reshape(-1, modes.shape[2])
        volume = np.linalg.slogdet(rows.T @ rows)[1]
        return float(volume - np.log((rows**2).sum(axis=0)).sum())

    found = [s([*first, point]) for point in range(len(modes)) if point not in first]
    assert s([*first, last]) == pytest.approx(max(found))


def test_far_candidates_are_drawn_where_there_are_many(settings, monkeypatch):
    modes = weighted_modes(settings["lid"].basis)
    monkeypatch.setattr(sampling, "N_CANDIDATES", 30)
    chosen = choose_points(modes, 12, "s-opt", seed=3)
    assert len(np.unique(chosen)) == 12
    assert set(chosen) != set(choose_points(modes, 12, "s-opt", seed=4))


def test_too_few_samples_are_refused(settings):
    modes = weighted_modes(settings["lid"].basis)
    with pytest.raises(ValueError, match="1 samples do not tell 5 modes apart"):
        choose_points(modes, 1, "random")
    with pytest.raises(ValueError, match="3 samples do not tell"):
        gappy_projection(np.repeat(modes[:1], 3, axis=0))


@pytest.mark.parametrize("advection", ["spline", "sph"])
def test_all_points_are_the_projection_of_the_rates(setting, advection):
    splines = setting.splines if advection == "spline" else None
    everywhere = np.arange(setting.points.n_points)
    model = SampledModel(setting.points, setting.basis, splines, everywhere)
    exact = UnprojectedModel(setting.points, setting.basis, splines)
    for scale in (1.0, 0.3):
        coordinates = scale * setting.coordinates
        close(model(coordinates, AROUND), exact(coordinates, AROUND), 1e-9)


@pytest.mark.parametrize("order", [0, 1])
def test_operators_and_the_remainder_are_all_of_the_rates(setting, order):
    everywhere = np.arange(setting.points.n_points)
    # Of the state itself, so that its remainder is of one mode; and of others, which are left out.
    states = np.stack((0.5 * setting.coordinates, setting.coordinates))
    modes = remainder_modes(setting.points, setting.basis, order, states, [AROUND], 2)
    remainder = SampledRemainder(setting.points, setting.basis, order, modes, everywhere)
    reduced = project_operators(setting.points, setting.basis, setting.splines, order=order)
    polynomial = reduced.at(AROUND.kinematic_viscosity, AROUND.wall_speed)

    def both(coordinates, around):
        return polynomial(coordinates, around.amplitude) + remainder(coordinates, around)

    left_out = difference(lambda a, around: polynomial(a, around.amplitude), setting)
    assert difference(both, setting) < min(1e-9, 0.01 * left_out)
    few = choose_points(modes, 4, "s-opt")
    remainder = SampledRemainder(setting.points, setting.basis, order, modes, few)
    assert difference(both, setting) < min(1e-9, 0.01 * left_out)


def test_modes_of_remainders_are_orthonormal_and_no_more_than_count(settings):
    setting = settings["forced"]
    states = np.linspace(-1.0, 1.0, 9)[:, None] * setting.coordinates
    around = [AROUND, Surroundings(0.01)]
    modes = remainder_modes(setting.points, setting.basis, 1, states, around, 20)
    n_modes = modes.shape[2]
    assert 2 <= n_modes <= 6
    np.testing.assert_allclose(np.einsum("ndm,ndk->mk", modes, modes), np.eye(n_modes), atol=1e-12)
    fewer = remainder_modes(setting.points, setting.basis, 1, states, around, 2)
    np.testing.assert_array_equal(fewer, modes[..., :2])


def test_more_samples_are_nearer_and_the_remainder_is_nearest(settings):
    setting = settings["lid"]
    modes = weighted_modes(setting.basis)
    polynomial = project_operators(setting.points, setting.basis, setting.splines, order=1).at(
        AROUND.kinematic_viscosity, AROUND.wall_speed
    )

    # Those of states on either side of the one that is asked for.
    states = np.stack([scale * setting.coordinates for scale in (0.8, 1.2)])
    left_out = remainder_modes(setting.points, setting.basis, 1, states, [AROUND], 5)

    def errors(n_samples):
        chosen = [choose_points(modes, n_samples, "random", seed) for seed in range(10)]
        whole, rest = [], []
        for some in chosen:
            sampled = SampledModel(setting.points, setting.basis, setting.splines, some)
            remainder = SampledRemainder(setting.points, setting.basis, 1, left_out, some)
            whole.append(difference(sampled, setting))
            rest.append(difference(lambda a, s, r=remainder: polynomial(a) + r(a, s), setting))
        return np.median(whole), np.median(rest)

    few, many = errors(15), errors(120)
    assert many[0] < 0.5 * few[0]
    assert few[1] < 0.1 * few[0]
    assert many[1] < 0.1 * many[0]


def test_runs_of_a_polynomial_are_those_of_compiled_steps(settings):
    setting = settings["forced"]
    polynomial = project_operators(setting.points, setting.basis).at(0.01)
    schedule = Schedule(0.02, 4, start_time=0.3)
    compiled = PolynomialModel([polynomial]).run(
        setting.coordinates[None], schedule, [5], lambda t: np.cos(30.0 * t)
    )
    drive = Drive(0.01, lambda t: math.cos(30.0 * t))
    counted: list[int] = []
    plain = integrate(
        lambda a, around: polynomial(a, around.amplitude),
        setting.coordinates,
        schedule,
        5,
        drive,
        counted.append,
    )
    np.testing.assert_allclose(plain.coordinates, compiled.coordinates, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(plain.time, compiled.time)
    assert np.isnan(plain.diverged_at[0])
    assert counted == [1, 1, 1]


def test_runs_that_leave_all_bounds_end_where_they_do():
    schedule = Schedule(1.0, 10, largest_norm=100.0)
    runs = integrate(lambda a, around: a, np.ones(1), schedule, 4, Drive(0.0))
    # e^4.5 is below the bound, e^4.75 is not.
    assert runs.diverged_at[0] == pytest.approx(4.5)
    assert np.isfinite(runs.coordinates[0, :5]).all()
    assert np.isnan(runs.coordinates[0, 5:]).all()
