"""Reduced models below an elevation: linear theory, energy, volume, and where a run ends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sphrom.arrays import Array
from sphrom.errors import SphromError
from sphrom.metrics.elevation import find_elevation
from sphrom.reduction.graph_model import GraphModel, calibrated_model, run_many
from sphrom.reduction.graph_training import TrainingRun, _Fit, _Projected, train
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.reduction.surface_basis import SurfaceBasis, chosen_size, make_basis

SPACE = StreamSpace(left=1.0, right=3.0, bottom=-1.0, top=0.5, n_columns=10, n_rows=8)
DEPTH, GRAVITY = 1.0, 2.0
COLUMNS = SPACE.left + SPACE.width * (np.arange(48) + 0.5) / 48


def wave_number(mode: int) -> float:
    return mode * math.pi / SPACE.width


def potential_wave(points: Array, mode: int) -> Array:
    k = wave_number(mode)
    x, y = points[:, 0] - SPACE.left, points[:, 1] - SPACE.bottom
    both = [-np.sin(k * x) * np.cosh(k * y), np.cos(k * x) * np.sinh(k * y)]
    return np.stack(both, axis=-1) / math.sinh(k * DEPTH)


def still_points() -> Array:
    x, y = np.meshgrid(np.linspace(1.02, 2.98, 50), np.linspace(-0.98, -0.02, 25))
    return np.stack([x.ravel(), y.ravel()], axis=-1)


@pytest.fixture(scope="module")
def basis() -> SurfaceBasis:
    fits = [SPACE.fit(still_points(), potential_wave(still_points(), n))[0] for n in (1, 2, 3)]
    x = np.linspace(0, SPACE.width, 48, endpoint=False) + SPACE.width / 96
    waves = [0.1 * np.cos(wave_number(n) * x) for n in (1, 2, 3)]
    return make_basis(SPACE, np.array([fits]), np.array([waves]), 1e-3, 3)


def model(basis: SurfaceBasis, viscosity: float = 0.0, force: float = 0.0) -> GraphModel:
    def body_force(times: Array) -> Array:
        return np.stack([force * np.ones_like(times), 0 * times])

    return GraphModel(basis, DEPTH, GRAVITY, viscosity, body_force)


def training_run(basis: SurfaceBasis, gravity: float, frequency: float) -> TrainingRun:
    """A run of the model at another gravity, as if it were a full run's."""

    def force(times: Array) -> Array:
        return np.stack([0.02 * np.sin(frequency * times), 0 * times])

    times = np.linspace(0, 30, 201)
    own = GraphModel(basis, DEPTH, gravity, 5e-3, force)
    run = own.run(times, np.zeros(len(first_wave(basis, 1.0))))
    coefficients = run.coordinates[:, : len(basis.stream_modes)] @ basis.stream_modes
    elevation = own.elevation(run.coordinates, COLUMNS)
    return TrainingRun(times, coefficients, elevation, DEPTH, GRAVITY, 5e-3, force)


def first_wave(basis: SurfaceBasis, amplitude: float) -> Array:
    n_modes = len(basis.stream_modes)
    return np.concatenate([np.zeros(n_modes), amplitude * basis.surface_modes[:, 0]])


def test_a_potential_wave_is_fitted_and_its_residual_is_the_noise() -> None:
    points, exact = still_points(), potential_wave(still_points(), 2)
    coefficients, residual = SPACE.fit(points, exact)
    assert residual < 0.015
    assert SPACE.velocity(coefficients, points) == pytest.approx(exact, abs=0.03)
    noise = 0.05 * np.random.default_rng(1).standard_normal(exact.shape)
    _, residual = SPACE.fit(points, exact + noise)
    expected = float(np.linalg.norm(noise) / np.linalg.norm(exact + noise))
    assert residual == pytest.approx(expected, rel=0.1)


def test_a_fit_does_not_depend_on_units() -> None:
    points, exact = still_points(), potential_wave(still_points(), 3)
    sides = {name: 10 * getattr(SPACE, name) for name in ("left", "right", "bottom", "top")}
    larger = StreamSpace(**sides, n_columns=10, n_rows=8)
    assert larger.fit(10 * points, 7 * exact)[0] == pytest.approx(70 * SPACE.fit(points, exact)[0])


def test_walls_are_stream_lines() -> None:
    coefficients = np.random.default_rng(2).standard_normal(12 * 11)
    walls = np.array([[1.0, -0.3], [3.0, 0.2], [1.7, -1.0]])
    velocity = SPACE.velocity(coefficients, walls)
    normal = [velocity[0, 0], velocity[1, 0], velocity[2, 1]]
    assert normal == pytest.approx([0, 0, 0], abs=1e-12)


def test_derivatives_along_lines_are_those_of_a_polynomial() -> None:
    """A quartic that is zero at the walls is a spline; above and below the box it goes on."""

    points = np.random.default_rng(0).uniform((1, -1), (3, 0.5), (600, 2))
    s, t = points[:, 0] - SPACE.left, points[:, 1] - SPACE.bottom
    (values,) = SPACE.derivatives(points, (0, 0))
    stream = np.linalg.lstsq(values, s**2 * (2 - s) ** 2 * (t**3 - t**4))[0]
    x, y = np.array([1.0, 1.3, 2.9]), np.linspace(-1.1, 0.6, 24).reshape(2, 3, 4)
    factors = np.array([[1.0], [-2.0]])
    found = SPACE.along(stream[None], factors, x, y, (1, 2), (3, 0))
    s, t = x[:, None] - SPACE.left, y - SPACE.bottom
    exact = (8 * s - 12 * s**2 + 4 * s**3) * (6 * t - 12 * t**2), 24 * (s - 1) * (t**3 - t**4)
    for values, right in zip(found, exact, strict=True):
        assert values == pytest.approx(factors[:, :, None] * right, abs=1e-8)


def test_energy_is_constant_without_viscosity_and_force(basis: SurfaceBasis) -> None:
    own = model(basis)
    run = own.run(np.linspace(0, 20, 101), first_wave(basis, 0.15))
    assert run.ended is None
    energy = own.kinetic_energy(run.coordinates) + own.potential_energy(run.coordinates)
    assert own.kinetic_energy(run.coordinates).max() > 0.5 * energy[0]
    assert energy == pytest.approx(energy[0] * np.ones(101), rel=1e-4)


def test_a_small_wave_has_the_frequency_and_decay_of_linear_theory(basis: SurfaceBasis) -> None:
    viscosity, k = 2e-3, wave_number(1)
    own = model(basis, viscosity)
    period = 2 * math.pi / math.sqrt(GRAVITY * k * math.tanh(k * DEPTH))
    run = own.run(np.linspace(0, 4 * period, 161), first_wave(basis, 1e-3))
    expected = 1e-3 * np.exp(-2 * viscosity * k**2 * run.times)
    expected *= np.cos(2 * math.pi * run.times / period)
    at_wall = own.elevation(run.coordinates, np.array([SPACE.left]))[:, 0]
    assert at_wall == pytest.approx(expected, abs=3e-5)


def test_a_constant_force_tilts_the_surface(basis: SurfaceBasis) -> None:
    own = model(basis, viscosity=0.05, force=0.02)
    run = own.run(np.linspace(0, 100, 101), np.zeros(len(first_wave(basis, 1.0))))
    tilt = 4 * SPACE.width * 0.02 / (math.pi**2 * GRAVITY)
    coordinates = run.coordinates[-1, 3:] @ basis.surface_modes
    assert coordinates[0] == pytest.approx(-tilt, rel=0.02)


def test_a_run_ends_where_the_surface_is_too_steep(basis: SurfaceBasis) -> None:
    run = model(basis, force=0.8).run(np.linspace(0, 10, 51), 0 * first_wave(basis, 1.0))
    assert run.ended is not None
    assert 0 < run.end_time < 10
    assert 1 < run.end_place < 3
    assert len(run.times) == len(run.coordinates) < 51
    assert np.isfinite(run.coordinates).all()


def test_a_surface_breaks_at_a_slope_of_one_unless_training_is_near_it(basis) -> None:
    """Training has waves of 0.1 m. A wave at rest only falls at first, so its start decides."""
    x = SPACE.width * (np.arange(24) + 0.5) / 24
    trained = max(0.1 * k * np.abs(np.sin(k * x)).max() for k in map(wave_number, (1, 2, 3)))
    assert basis.largest_slope == pytest.approx(trained, rel=1e-3)
    unit = wave_number(3) * np.abs(np.sin(wave_number(3) * x)).max()
    times = np.linspace(0.0, 0.02, 3)
    for largest, steep in ((trained, 1.0), (0.8, 1.2)):
        whole = SurfaceBasis(**vars(basis) | {"largest_slope": largest})
        state = np.concatenate([np.zeros(3), whole.surface_modes.T[2]]) / unit
        assert model(whole).steepness(state) == pytest.approx(1.0)
        for share, ended in ((0.98, None), (1.02, "the surface is so steep that it would break")):
            assert model(whole).run(times, share * steep * state).ended == ended


def test_a_wave_above_the_modes_is_told_by_its_height(basis: SurfaceBasis) -> None:
    run = model(basis).run(np.linspace(0.0, 0.02, 3), first_wave(basis, 0.7))
    height = SPACE.top - SPACE.bottom
    limit = f"a wave is more than {height:.3g} m above the floor"
    assert run.ended == f"{limit}, where the modes end"


def test_a_run_that_diverges_within_a_step_ends(basis: SurfaceBasis) -> None:
    start = first_wave(basis, 0.1)
    own = replace(model(basis), closure=1e200 * np.eye(len(start)))
    run = own.run(np.linspace(0, 10, 51), start)
    assert run.ended == "the run has diverged"
    assert np.isfinite(run.coordinates).all()


def test_runs_in_parallel_are_those_made_one_by_one(basis: SurfaceBasis) -> None:
    models = [model(basis, viscosity, force) for viscosity, force in ((0.0, 0.02), (0.01, 0.8))]
    times, starts = np.linspace(0, 10, 51), [first_wave(basis, size) for size in (0.1, 0.0)]
    together = run_many(models, times, starts)
    for own, start, run in zip(models, starts, together, strict=True):
        alone = own.run(times, start)
        assert alone.ended == run.ended
        assert alone.coordinates == pytest.approx(run.coordinates, rel=1e-12)
    with pytest.raises(ValueError, match="one basis"):
        run_many([models[0], model(basis.reduced(3, 3))], times, starts)


def test_pressure_of_a_small_wave_is_that_of_potential_flow(basis: SurfaceBasis) -> None:
    own, k = model(basis), wave_number(1)
    frequency = math.sqrt(GRAVITY * k * math.tanh(k * DEPTH))
    times = np.linspace(0, 4, 41)
    run = own.run(times, first_wave(basis, 1e-3))
    points = np.array([[1.0, -0.5], [1.4, -0.9], [3.0, -1.0], [2.0, 0.3]])
    pressure = own.pressure(times, run.coordinates, points)
    x, y = points[:3, 0] - SPACE.left, points[:3, 1] - SPACE.bottom
    wave = 1e-3 * np.cos(k * x) * np.cosh(k * y) / math.cosh(k * DEPTH)
    exact = GRAVITY * (DEPTH - y + np.outer(np.cos(frequency * times), wave))
    assert pressure[:, :3] == pytest.approx(exact, abs=2e-5)
    assert (pressure[:, 3] == 0).all()


def test_forces_on_walls_balance_weight_and_momentum(basis: SurfaceBasis) -> None:
    own = model(basis)
    times, middle = np.linspace(0, 4, 161), np.array([2.0, -0.5])
    rest = np.zeros((161, len(first_wave(basis, 1.0))))
    for wall, force in (("left", (-1.0, 0.0)), ("right", (1.0, 0.0)), ("bottom", (0.0, -4.0))):
        forces, torques = own.wall_force(times, rest, wall, middle)
        assert forces == pytest.approx(np.tile(force, (161, 1)), rel=1e-9)
        arm = -force[0] * (SPACE.bottom + DEPTH / 3 - middle[1])
        assert torques == pytest.approx(np.full(161, arm), abs=1e-9)
    coordinates = own.run(times, first_wave(basis, 0.05)).coordinates
    walls = [own.wall_force(times, coordinates, w, middle)[0] for w in ("left", "right", "bottom")]
    area = DEPTH * SPACE.width
    given = area * np.array([0.0, -GRAVITY]) - sum(walls)
    place = own.centre_of_mass(coordinates)
    second = np.diff(place, 2, axis=0) / (times[1] - times[0]) ** 2
    scale = np.abs(area * second[:, 0]).max()
    assert area * second == pytest.approx(given[1:-1], abs=0.02 * scale)


def test_training_finds_gravity_and_the_number_of_elevation_modes(basis: SurfaceBasis) -> None:
    runs = [training_run(basis, 1.012 * GRAVITY, frequency) for frequency in (1.2, 1.4)]
    trained = train(basis, runs, [2, 3], lambda done: None)
    assert chosen_size(trained) == 3
    best = trained[3]
    assert best.gravity_factor == pytest.approx(1.012, abs=1e-3)
    assert best.n_surface == 3
    assert max(best.elevation_error, best.velocity_error) < 2e-3
    assert best.best_velocity_error < 1e-6
    assert best.uncalibrated_elevation_error > 0.05
    expected = training_run(basis, 1.012 * GRAVITY, 1.3)
    given = expected.depth, expected.gravity, expected.viscosity, expected.force
    errors = []
    for calibrated in (False, True):
        own = GraphModel(basis.reduced(best.n_modes, best.n_surface), *given)
        own = calibrated_model(own, best) if calibrated else own
        run = own.run(expected.times, np.zeros(6))
        elevation = own.elevation(run.coordinates, COLUMNS)
        wave = np.linalg.norm(expected.elevation - SPACE.bottom - DEPTH)
        errors.append(np.linalg.norm(elevation - expected.elevation) / wave)
    assert errors[1] < 3e-3 < 0.05 < errors[0]


def test_gravity_may_change_with_the_amplitude(basis: SurfaceBasis) -> None:
    """A wave keeps its amplitude, so that it has the frequency of one changed gravity."""
    times, start = np.linspace(0, 20, 101), first_wave(basis, 0.05)
    for most, square in ((math.inf, 0.05**2), (0.04**2, 0.04**2)):
        changed = replace(model(basis), gravity_growth=-1.0, largest_square=most)
        same = replace(model(basis), gravity_factor=1.0 - square)
        runs = run_many([changed, same, model(basis)], times, [start] * 3)
        differences = [np.abs(run.coordinates - runs[0].coordinates).max() for run in runs]
        assert differences[1] < 0.1 * differences[2]


def test_elevation_has_the_modes_that_its_variance_requires(basis: SurfaceBasis) -> None:
    """A share of 1e-8 of the variance is left out, of 1e-4 not."""
    for share, n_surface in ((1e-4, 1), (1e-2, 2)):
        waves = [
            size * np.cos(wave_number(n) * COLUMNS) for n, size in ((1, 0.1), (2, 0.1 * share))
        ]
        found = make_basis(SPACE, basis.stream_modes[None, :2], np.array([waves]), 1e-3, 2)
        assert len(found.surface_modes) == n_surface


def test_modes_below_the_noise_are_cut_off(basis: SurfaceBasis) -> None:
    runs = [training_run(basis, GRAVITY, 1.3)]
    noisy = SurfaceBasis(**vars(basis) | {"energies": np.array([1.0, 0.1, 1e-8]), "noise": 1e-7})
    trained = train(noisy, runs, [3], lambda done: None)
    assert trained[3].n_modes == 2


def test_modes_above_the_noise_do_not_depend_on_those_that_are_kept(basis: SurfaceBasis) -> None:
    """Five directions, each a tenth of the one before, with a noise of 0.015 in each."""
    draws = np.random.default_rng(3).standard_normal((5, SPACE.n_coefficients))
    flat = np.tile(1e-9 * np.cos(wave_number(1) * COLUMNS), (1, 5, 1))
    whole = make_basis(SPACE, draws[None], flat, 0.0, 5)
    sizes = np.sqrt(np.logspace(0, -4, 5) / whole.energies)
    given = sizes[:, None] * whole.stream_modes * np.sqrt(5 * whole.energies)[:, None]
    noise = np.sqrt(1.5e-2 * SPACE.n_coefficients / 1.1111)
    counts = [make_basis(SPACE, given[None], flat, noise, n).modes_above_noise for n in (1, 2, 5)]
    assert counts == [1, 2, 2]


def test_elevation_of_particles_and_columns_without_one_surface() -> None:
    spacing = 0.02
    x, y = np.meshgrid(np.arange(0.01, 1, spacing), np.arange(0.01, 0.5, spacing))
    fluid = np.stack([x.ravel(), y.ravel()], axis=-1)
    walls, columns = (0.0, 1.0, 0.0), np.array([0.0, 0.33, 0.9])
    area = np.full(len(fluid), spacing**2)
    heights = find_elevation(fluid, area, columns, 4 * spacing, walls)
    assert heights == pytest.approx([0.5] * 3, abs=2e-3)
    drop = fluid[np.hypot(fluid[:, 0] - 0.9, fluid[:, 1] - 0.2) < 0.1] + [0, 0.6]
    both = np.concatenate([fluid, drop])
    with pytest.raises(SphromError, match=r"x = 0\.9 m has more than one surface"):
        find_elevation(both, np.full(len(both), spacing**2), columns, 4 * spacing, walls)
    half = fluid[:, 0] < 0.5
    with pytest.raises(SphromError, match=r"x = 0\.9 m has no fluid"):
        find_elevation(fluid[half], area[half], columns, 4 * spacing, walls)


def test_training_runs_at_rest_give_finite_numbers(basis: SurfaceBasis) -> None:
    run = training_run(basis, 1.0, 1.0)
    still = replace(
        run,
        force=lambda times: np.zeros((2, len(times))),
        coefficients=np.zeros_like(run.coefficients),
        elevation=np.full_like(run.elevation, run.elevation.mean()),
    )
    products = basis.products(still.coefficients, still.elevation)
    fit = _Fit([_Projected.of(basis, still, products, 0.0)]).improved(2, 2)
    assert np.isfinite(fit.numbers).all()
    assert np.isfinite(fit.change(fit.numbers)["closure"]).all()
