"""The gates of the models on the reference points, on snapshots of full runs of every scene.

The vortex, the lid-driven cavity with its walls, and the open cavity with its force that changes in
time. Modes have no mean density, as cases have it where volumes are fixed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, cached_property
from itertools import chain

import numpy as np
import pytest
from numpy.typing import NDArray

from sphrom.reduction.decomposition import decompose
from sphrom.reduction.memory_projection import project_memory
from sphrom.reduction.operator_projection import project_operators, residual_factor
from sphrom.reduction.polynomial_model import (
    OutputTimes,
    PolynomialModel,
    Run,
    step_limit,
    steps_within,
)
from sphrom.reduction.reduced_operators import Polynomial, ReducedOperators, largest_growth
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.spline import LocalSplines, default_cell_width, fit_splines
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis, project
from sphrom.scenes.flows import LidDrivenCavity, OpenCavity, Scene, TaylorGreen
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import Discretization, Fluid, fluctuation_of
from sphrom.sph.functional import Functional
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

Array = NDArray[np.float64]

MACH, COURANT, EVERY = 0.1, 0.75, 2
TRAINED = (100.0, 150.0, 200.0, 250.0)


@dataclass(frozen=True)
class Flow:
    """A scene at some Reynolds numbers, and how it is run."""

    kind: str
    resolution: int
    time: float
    reynolds: tuple[float, ...]
    ratio: float = 2.0
    reference_density: float = 1000.0

    def scene(self, reynolds: float) -> Scene:
        if self.kind == "vortex":
            return TaylorGreen(1.0, 1.0, self.reference_density, 1.0 / reynolds)
        return LidDrivenCavity(1.0, 1.0) if self.kind == "lid" else OpenCavity()

    def fluid(self, reynolds: float) -> Fluid:
        speed, length = (2.0, 0.2) if self.kind == "open" else (1.0, 1.0)
        return Fluid(self.reference_density, speed / MACH, speed * length / reynolds, speed)

    def viscosity(self, reynolds: float) -> float:
        return self.fluid(reynolds).kinematic_viscosity

    @property
    def domain(self) -> Domain:
        return self.scene(self.reynolds[0]).domain

    @property
    def discretization(self) -> Discretization:
        spacing = self.domain.lengths[0] / self.resolution
        options = {"shifting_transport": "advective", "fixed_volume": True}
        return Discretization(spacing, self.ratio * spacing, **options)

    @property
    def walls(self) -> Walls | None:
        if not self.domain.has_walls:
            return None
        layers = self.discretization.n_layers
        at_rest = self.domain.ghosts(self.discretization.particle_spacing, layers)
        return at_rest.moving(self.scene(self.reynolds[0]).wall_velocity)

    @property
    def interval(self) -> float:
        """From one snapshot to the next [s]."""
        fluid, length = self.fluid(self.reynolds[0]), self.discretization.smoothing_length
        longest = EVERY * COURANT * length / fluid.sound_speed
        return self.time / math.ceil(self.time / longest)

    def amplitude(self, times: Array) -> Array:
        drive = self.scene(self.reynolds[0]).body_force
        return np.zeros(times.shape) if drive is None else np.array([*map(drive.amplitude, times)])


@dataclass(frozen=True)
class Training:
    """The mapped snapshots of a flow's full runs, one run after the other."""

    flow: Flow
    position: Array
    """(n_points, 2), where particles started."""
    density: Array
    velocity: Array

    @property
    def n_snapshots(self) -> int:
        return len(self.density) // len(self.flow.reynolds)

    def points(self) -> FixedPoints:
        flow, where = self.flow, self.position
        drive = flow.scene(flow.reynolds[0]).body_force
        force = None if drive is None else drive.field(where.T)
        fluid = flow.fluid(flow.reynolds[0])
        return FixedPoints(where, fluid, flow.discretization, flow.domain, flow.walls, force)

    def basis(self, n_modes: int, name: str = "acoustic", separate_mean: bool = True) -> TrialBasis:
        fluid = self.flow.fluid(self.flow.reynolds[0])
        density = fluid.reference_density
        acoustic = InnerProduct.acoustic(density, fluid.sound_speed)
        return decompose(
            lambda part: (self.density[:, part], self.velocity[:, part]),
            len(self.position),
            len(self.density),
            acoustic if name == "acoustic" else InnerProduct.raw(density),
            np.full(len(self.position), self.flow.discretization.particle_spacing**2),
            {"all": n_modes},
            {"all": np.arange(len(self.density))},
            mean_density=self.density.mean(axis=1) if separate_mean else None,
        )["all"]

    def reduced(self, basis: TrialBasis, advection: str = "spline") -> Reduced:
        splines = None
        if advection == "spline":
            columns = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
            splines = fit_splines(
                self.position,
                columns.transpose(1, 0, 2).reshape(len(self.position), -1),
                self.flow.domain,
                cell_width=default_cell_width(self.flow.domain, len(self.position)),
            )
        states = project(basis, self.density, self.velocity)
        return Reduced(self, self.points(), basis, splines, states)


@dataclass(frozen=True)
class Reduced:
    """A model of a flow on the reference points."""

    training: Training
    points: FixedPoints
    basis: TrialBasis
    splines: LocalSplines | None
    states: Array
    """(n_snapshots, n_modes) the coordinates of all training snapshots."""

    @cached_property
    def operators(self) -> ReducedOperators:
        return project_operators(self.points, self.basis, self.splines)

    @property
    def largest(self) -> float:
        """The norm of the largest training state."""
        return float(np.linalg.norm(self.states, axis=1).max())

    def rates(self, reynolds: float) -> Polynomial:
        return self.operators.at(self.training.flow.viscosity(reynolds))

    def kinetic_energy(self, states: Array) -> Array:
        velocity = np.tensordot(states, self.basis.velocity_modes, 1)
        return 0.5 * np.einsum("snd,snd,n->s", velocity, velocity, self.basis.weights)

    def limit(self, rates: Polynomial) -> float:
        """The step [s] that is stable around every fourth training state, with the first force."""
        strongest = float(self.training.flow.amplitude(np.zeros(1))[0])
        return step_limit(rates, self.states[::4], strongest)

    def run(self, rates: Polynomial, output_times: OutputTimes, n_steps: int | None = None) -> Run:
        """Run from the first snapshot, in stable steps if not in as many an interval."""
        n_steps = n_steps or steps_within(output_times.interval, self.limit(rates))
        start, amplitude = self.states[0], self.training.flow.amplitude
        taken = n_steps * (output_times.n_snapshots - 1)
        return PolynomialModel(rates).run(taken, start, output_times, amplitude)


@cache
def train(flow: Flow) -> Training:
    """Run a flow from packed points, or from a lattice where there are walls."""
    domain, spacing = flow.domain, flow.discretization.particle_spacing
    walled = domain.has_walls
    position = domain.fill(spacing) if walled else pack(domain, flow.discretization).position
    to_points = ReferenceMap(
        position, domain, particle_spacing=spacing, smoothing_length=2.0 * spacing
    )
    step, n_steps = flow.interval / EVERY, EVERY * round(flow.time / flow.interval)
    mapped = []
    for reynolds in flow.reynolds:
        scene, fluid = flow.scene(reynolds), flow.fluid(reynolds)
        full = Functional(fluid, flow.discretization, domain, flow.walls, scene.body_force)
        density = fluctuation_of(scene.initial_pressure(position), fluid.sound_speed)
        state = np.vstack((position.T, density, scene.initial_velocity(position).T))
        for n in range(n_steps + 1):
            if n % EVERY == 0:
                mapped.append(to_points(state[:2].T, state[2], state[3:].T))
            if n < n_steps:
                state = runge_kutta_step(full, state, n * step, step)
    density, velocity = (np.array(field) for field in zip(*mapped, strict=True))
    return Training(flow, position, density, velocity)


FLOWS = {
    "vortex": Flow("vortex", 24, 0.5, (100.0, 250.0)),
    "lid": Flow("lid", 20, 1.0, (100.0,)),
    "open": Flow("open", 40, 0.05, (2400.0,)),
}
ALL = pytest.mark.parametrize("name", FLOWS)


@cache
def reduced(name: str, n_modes: int) -> Reduced:
    """Return the model of a scene on the reference points."""
    return train(FLOWS[name]).reduced(train(FLOWS[name]).basis(n_modes))


def close(actual: Array, expected: Array, tolerance: float) -> None:
    scale = max(float(np.max(np.abs(expected))), 1e-12)
    assert np.max(np.abs(actual - expected)) <= tolerance * scale


# Sound.


def test_a_mean_density_creates_some() -> None:
    """Continuity without its mean is skew to pressure without its mean alone.

    Where modes keep theirs, what is missing is how uneven points are: measured, 2.5e-5.
    """
    here = train(FLOWS["vortex"])
    kept = project_operators(here.points(), here.basis(20, separate_mean=False))
    assert 1.2e-5 < kept.skewness < 5e-5


@ALL
def test_the_raw_product_creates_sound(name: str) -> None:
    """Its symmetric part is as large as itself: measured, 0.98 to 1.12."""
    here = train(FLOWS[name])
    raw = project_operators(here.points(), here.basis(10, "raw", separate_mean=False))
    assert raw.skewness > 0.5


def test_the_raw_product_diverges_where_the_acoustic_one_does_not() -> None:
    """In the lid-driven cavity, with 20 modes of the same snapshots.

    Measured: a Jacobian that grows by 61 to 69 a second, and a thousand times the largest state
    after 0.2 s; in the acoustic product one that falls by 0.4 a second, and an energy within 3 % of
    the full run's.
    """
    here = train(FLOWS["lid"])
    raw = here.reduced(here.basis(20, "raw", separate_mean=False))
    acoustic = here.reduced(here.basis(20))
    growth, runs = {}, {}
    for name, model in (("raw", raw), ("acoustic", acoustic)):
        rates = model.rates(100.0)
        growth[name] = [largest_growth(rates.jacobian(a)) for a in model.states[::8]]
        output_times = OutputTimes(0.05, 21, largest_norm=1e3 * model.largest)
        runs[name] = model.run(rates, output_times)
    assert min(growth["raw"]) > 10.0
    assert max(growth["acoustic"]) < 0.0
    assert runs["raw"].diverged_at < 1.0
    assert np.isnan(runs["acoustic"].diverged_at)
    energy = acoustic.kinetic_energy(runs["acoustic"].coordinates).max()
    assert energy == pytest.approx(acoustic.kinetic_energy(acoustic.states).max(), rel=0.1)


# What is projected.


@ALL
def test_nothing_depends_on_the_reference_density(name: str) -> None:
    """Full runs of a fluid as light as air give the same operators, and the same reduced run.

    Measured: within 2e-12. In the raw product not even the spectrum is the same.
    """
    heavy, light = reduced(name, 8), train(replace(FLOWS[name], reference_density=1.2))
    same = light.reduced(light.basis(8))
    close(same.states, heavy.states, 1e-9)
    reynolds = FLOWS[name].reynolds[0]
    ours, theirs = heavy.rates(reynolds), same.rates(reynolds)
    for first, second in zip(ours.powers, theirs.powers, strict=True):
        for tensor, other in zip(first, second, strict=True):
            close(other, tensor, 1e-9)
    output_times = OutputTimes(FLOWS[name].interval, light.n_snapshots)
    runs = [model.run(model.rates(reynolds), output_times) for model in (heavy, same)]
    close(runs[1].coordinates, runs[0].coordinates, 1e-9)
    raw = [t.reduced(t.basis(8, "raw", separate_mean=False)) for t in (heavy.training, light)]
    heavy_raw, light_raw = (np.linalg.eigvals(m.rates(reynolds).at_rest()) for m in raw)
    # Each by its nearest of the other: eigenvalues come in no order.
    apart = np.abs(heavy_raw[:, None] - light_raw).min(axis=1)
    assert apart.max() > 0.1 * np.abs(heavy_raw).max()


# What a run costs.


def arrays(value: object) -> Iterator[Array]:
    """Yield all arrays that a record holds."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple | list):
        for part in value:
            yield from arrays(part)
    elif is_dataclass(value):
        for part in fields(value):
            yield from arrays(getattr(value, part.name))
    elif hasattr(value, "__dict__"):
        for part in vars(value).values():
            yield from arrays(part)


def test_nothing_online_is_as_large_as_the_points_are_many() -> None:
    """Arrays have the same shapes at 196 points and at 400, and none an axis of either."""
    found = []
    for resolution in (14, 20):
        here = train(Flow("vortex", resolution, 0.3, (100.0,)))
        model, n_points = here.reduced(here.basis(4)), len(here.position)
        rates, viscosity = model.rates(100.0), here.flow.viscosity(100.0)
        memory = project_memory(model.points, model.basis, model.splines).at(viscosity)
        factor = residual_factor(model.points, model.basis, model.operators, model.splines)
        residual = factor.of_model(model.operators, np.arange(4))
        closed = rates.plus(memory, 1e-4)
        systems = [PolynomialModel(polynomial) for polynomial in (rates, closed)]
        output_times = OutputTimes(0.02, 11)
        sized = [
            [a.shape for a in arrays(record)]
            for record in (model.operators, rates, closed, systems, model.run(closed, output_times))
        ]
        assert all(sized)
        kept = [*chain.from_iterable(sized), *(a.shape for a in arrays(residual))]
        assert not {n_points, 2 * n_points, 3 * n_points} & {*chain.from_iterable(kept)}
        found.append(sized)
    assert found[0] == found[1]


# Stability.


@ALL
@pytest.mark.parametrize("n_modes", [5, 20])
def test_the_step_limit_is_sharp(name: str, n_modes: int) -> None:
    """From the first snapshot: nothing grows at 0.9 of it, and at 1.3 something does at once.

    Measured: at 0.9 no state beyond 1.2 times the largest training state from the 20th step to the
    100th, at 1.3 one beyond 20 times it after 3 to 6 steps.
    """
    model = reduced(name, n_modes)
    rates = model.rates(FLOWS[name].reynolds[0])
    limit, largest = model.limit(rates), 20.0 * model.largest
    below, above = (
        model.run(rates, OutputTimes(share * limit, n, largest_norm=largest), 1)
        for share, n in ((0.9, 101), (1.3, 21))
    )
    assert np.isnan(below.diverged_at)
    late = np.linalg.norm(below.coordinates[20:], axis=1)
    assert late.max() < 2.0 * model.largest
    assert np.isfinite(above.diverged_at)


@pytest.mark.parametrize("advection", ["spline", "sph"])
@pytest.mark.parametrize("reynolds", [1000.0, 10_000.0])
def test_far_beyond_the_trained_range_no_energy_is_gained(reynolds: float, advection: str) -> None:
    """Whatever the modes, for five times as long as was trained.

    Half of the coordinates' squared norm is all energy in the acoustic product, sound's too.
    Measured: neither is ever above its start, and when the trained time ends the kinetic energy
    over that at the start is the exact one within 0.0035 (Re 1000) and 0.0093 (Re 10,000).
    """
    tolerance = 0.007 if reynolds == 1000.0 else 0.018
    here = train(Flow("vortex", 24, 1.0, TRAINED))
    for n_modes in (2, 5, 10, 20):
        model = here.reduced(here.basis(n_modes), advection)
        assert_decays(model, reynolds, trained_until=1.0, until=5.0, tolerance=tolerance)


@pytest.mark.parametrize("reynolds", [1000.0, 10_000.0])
@pytest.mark.parametrize(("resolution", "ratio"), [(24, 2.0), (36, 4.0)])
def test_trained_at_high_reynolds_numbers_no_energy_is_gained(
    reynolds: float, resolution: int, ratio: float
) -> None:
    """Whatever the modes, for half as long again as was trained.

    Modes of such runs are noise but for the first few, and convection by the splines' derivatives
    is not neutral to energy among them: far beyond the trained time some models do gain. Measured
    here: never above the start, and the exact energy within 0.0070 and 0.0099 where h = 2 dx,
    0.0104 and 0.0231 where h = 4 dx, at Re 1000 and 10,000.
    """
    tolerance = {(2.0, 1e3): 0.014, (2.0, 1e4): 0.02, (4.0, 1e3): 0.02, (4.0, 1e4): 0.045}
    here = train(Flow("vortex", resolution, 1.0, (reynolds,), ratio))
    for n_modes in (2, 5, 10, 20):
        model = here.reduced(here.basis(n_modes))
        assert_decays(
            model, reynolds, trained_until=1.0, until=1.5, tolerance=tolerance[ratio, reynolds]
        )


def assert_decays(
    model: Reduced, reynolds: float, *, trained_until: float, until: float, tolerance: float
) -> None:
    """Hold a vortex's energies to their start, and the kinetic one to the exact one."""
    output_times = OutputTimes(0.1, 1 + round(until / 0.1))
    runs = model.run(model.rates(reynolds), output_times)
    states, kinetic = runs.coordinates, model.kinetic_energy(runs.coordinates)
    assert np.isnan(runs.diverged_at)
    assert kinetic.max() < 1.0001 * kinetic[0]
    assert np.linalg.norm(states, axis=1).max() < 1.0001 * np.linalg.norm(states[0])
    exact = math.exp(-16.0 * math.pi**2 * trained_until / reynolds)
    found = kinetic[round(trained_until / 0.1)] / kinetic[0]
    assert found == pytest.approx(exact, abs=tolerance)
