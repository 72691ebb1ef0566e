"""Where runs are compared, in boxes with and without walls, and what is sampled there."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sphrom.errors import CaseError
from sphrom.metrics.measures import Samples
from sphrom.models.reference.limits import sample_best
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis, reconstruct, with_pressures
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.space_box import SpaceBox
from sphrom.store.stored_run import probes_of, sample_run


def test_probes_of_a_periodic_box(case_of):
    probes = probes_of(case_of("taylor-green", compare={"grid": 6, "line_points": 4}))
    np.testing.assert_allclose(probes.line, [[0.5, y] for y in (0.125, 0.375, 0.625, 0.875)])
    assert probes.grid.shape == (36, 2)
    assert len(probes.stations) == 0
    values = np.arange(36.0)
    np.testing.assert_array_equal(probes.picture(values), values.reshape(6, 6))


def test_probes_of_the_open_cavity(case_of):
    case = case_of("open-cavity", compare={"grid": 40, "line_points": 100})
    probes, domain = probes_of(case), case.scene.domain
    assert probes.grid_shape == (20, 40)
    np.testing.assert_allclose(probes.line[:, 0], 0.25)
    np.testing.assert_allclose(probes.line[:, 1], 0.001 + 0.002 * np.arange(100))
    np.testing.assert_allclose(probes.stations, [[0.25, 0.1]])
    assert domain.contains(probes.all).all()
    distance = domain.wall_distance(probes.grid)
    assert distance.min() == pytest.approx(0.005)
    picture = probes.picture(probes.grid[:, 1])
    assert np.isnan(picture[:10, :10]).all()
    assert not np.isnan(picture[10:]).any()
    np.testing.assert_allclose(picture[:, 20], 0.005 + 0.01 * np.arange(20))


def test_grid_points_on_inner_walls_are_left_out(case_of):
    case = case_of("open-cavity", compare={"grid": 50})
    probes = probes_of(case)
    on_side = np.isclose(probes.grid[:, 0], 0.1) & (probes.grid[:, 1] < 0.1)
    assert not on_side.any()
    assert case.scene.domain.wall_distance(probes.grid).min() > 1e-3


def test_line_follows_the_fluid(case_of):
    domain = case_of("open-cavity").scene.domain
    assert domain.sections(0.25) == [(0.0, 0.2)]
    assert domain.sections(0.05) == [(0.1, 0.2)]
    assert domain.sections(0.1) == [(0.1, 0.2)]
    assert domain.sections(0.0) == [(0.1, 0.2)]
    assert domain.sections(0.5) == []
    gap = (Rectangle((0.0, 0.0), (1.0, 1.0)), Rectangle((0.0, 2.0), (1.0, 3.0)))
    apart = BoxDomain((0.0, 0.0), (1.0, 3.0), (False, False), gap)
    assert apart.sections(0.5) == [(0.0, 1.0), (2.0, 3.0)]


def test_line_that_the_case_chooses(case_of):
    case = case_of("open-cavity", compare={"line": 0.05, "line_points": 10})
    np.testing.assert_allclose(probes_of(case).line[[0, -1]], [[0.05, 0.105], [0.05, 0.195]])
    for kind, x in (("open-cavity", 0.5), ("lid-driven-cavity", 1.0)):
        with pytest.raises(CaseError, match=r"compare\.line: there is no fluid at x = "):
            probes_of(case_of(kind, compare={"line": x}))


def test_best_approximations_are_of_states_and_of_each_field() -> None:
    """Three modes on two points hold each of the fields."""
    inner, random = InnerProduct.acoustic(1000.0, 10.0), np.random.default_rng(3)
    states = np.linalg.qr(random.standard_normal((6, 3)))[0].T.reshape(3, 2, 3)
    basis = TrialBasis(
        density_modes=states[..., 0],
        velocity_modes=states[..., 1:],
        singular_values={},
        weights=np.ones(2),
        gram_error=0.0,
        inner_product=inner,
    )
    case = SimpleNamespace(plan=SimpleNamespace(sound_speed=10.0))
    probes = SimpleNamespace(all=np.zeros((2, 2)))

    def best_of(
        density: np.ndarray, velocity: np.ndarray, whole: TrialBasis = basis
    ) -> tuple[Samples, Samples]:
        data = {"density_fluctuation": density[None], "velocity": velocity[None]}
        mapped = SimpleNamespace(dataset=data.get, read=lambda _: np.zeros(1))
        n_all = len(whole.density_modes)
        modes = np.zeros((2, n_all, 3))
        modes[..., 0], modes[..., 1:] = whole.density_modes.T, whole.velocity_modes.swapaxes(0, 1)
        return sample_best(case, mapped, whole, lambda _: modes, probes, 3)

    one, other = (reconstruct(basis, np.array(c), 0.0) for c in ((1.0, 2.0, 3.0), (-2.0, 0.5, 1.0)))
    for state in best_of(*one):
        np.testing.assert_allclose(state.pressure[0], 100.0 * one[0], rtol=1e-9)
        np.testing.assert_allclose(state.velocity[0], one[1], rtol=1e-9)
    _, alone = best_of(one[0], other[1])
    np.testing.assert_allclose(alone.pressure[0], 100.0 * one[0], rtol=1e-9)
    np.testing.assert_allclose(alone.velocity[0], other[1], rtol=1e-9)
    # Pressure modes of its own represent any pressure, and change no velocity.
    both, alone = best_of(one[0], other[1], with_pressures(basis, np.eye(2)))
    joint, _ = best_of(one[0], other[1])
    for state in (both, alone):
        np.testing.assert_allclose(state.pressure[0], 100.0 * one[0], rtol=1e-9)
    np.testing.assert_allclose(both.velocity, joint.velocity, rtol=1e-9)
    assert np.abs(joint.pressure[0] - 100.0 * one[0]).max() > 1.0
    np.testing.assert_allclose(alone.velocity[0], other[1], rtol=1e-9)


@pytest.mark.parametrize("kind", ["lid-driven-cavity", "open-cavity"])
def test_sampling_is_second_order_up_to_the_walls(case_of, made_up, kind):
    """The support is one-sided there; quadratic velocities and linear pressures are exact."""
    case = case_of(kind)
    height = case.scene.domain.lengths[1]

    def flow(position, time):
        y = position[:, 1] / height
        return np.stack((time + y**2, 1.0 - y), axis=1), 5.0 * y - 3.0

    probes = probes_of(case)
    trajectory = made_up(case, flow, np.array([1.0, 2.0]))
    samples = sample_run(case, trajectory, probes.all)
    for time, velocity, pressure in zip(
        samples.time, samples.velocity, samples.pressure, strict=True
    ):
        expected = flow(probes.all, time)
        np.testing.assert_allclose(velocity, expected[0], atol=1e-9)
        np.testing.assert_allclose(pressure, expected[1], atol=1e-9)


def test_probes_of_a_box_in_space() -> None:
    domain = SpaceBox((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), (True, False, True))
    case = SimpleNamespace(
        scene=SimpleNamespace(domain=domain),
        plan=SimpleNamespace(probe_line=0.5),
        compare=SimpleNamespace(line_points=4, grid=27),
    )
    probes = probes_of(case)
    np.testing.assert_allclose(probes.line[1], [0.5, 0.375, 0.5])
    # As many points along the longer side as give a cube the number of points of a square.
    assert probes.grid.shape == (9 * 4 * 4, 3)
    assert domain.contains(probes.all).all()
    picture = probes.picture(probes.pictured[:, 2])
    assert picture.shape == probes.grid_shape
    assert np.isnan(picture[-1, -1])
    assert picture[0, 0] == pytest.approx(0.5)
    assert picture[-1, 0] > 0.9
