"""The sweeps themselves: their rows, any number of threads, and without the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import numba
import numpy as np
import pytest

from sphrom.kernels import sweeps
from sphrom.kernels.jit import set_threads
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional
from sphrom.sph.neighbourhood import Neighbourhood

SPACING = 0.0625
SHAPE = (16, 14)
BOX = BoxDomain((0.0, 0.0), (1.0, 0.875), (True, True))


@pytest.fixture
def threads() -> Iterator[Callable[[int], int]]:
    before = numba.get_num_threads()
    yield set_threads
    numba.set_num_threads(before)


@pytest.mark.parametrize("kind", ["jittered", "random"])
@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
def test_rows_of_regularity(brute_force: type, scatter: Callable, kind: str, ratio: float) -> None:
    """In the order that they are named in; the damper takes from the density's row."""
    state = scatter((0.0, 0.0), SPACING, SHAPE, kind, seed=1)
    sums = brute_force(state[:2].T, BOX.lengths, (True, True), ratio * SPACING, SPACING)
    volume = 1e-3 * np.random.default_rng(2).uniform(1.0, 2.0, state.shape[1])
    neighbourhood = Neighbourhood(BOX, 2.0 * ratio * SPACING, SPACING, n_fields=sweeps.N_FIELDS)
    neighbourhood.update(state[:2])
    near = neighbourhood.sources
    source = np.empty((sweeps.N_FIELDS, near.particle.size))
    fields = np.vstack((state, volume))
    sweeps.gather(near.particle, near.image, fields, sweeps.X, source)
    constants = sweeps.RegularityConstants(
        magnitude=2.0 * ratio * SPACING * 0.7,
        amplitude=0.25,
        inverse_kernel=1.0 / float(sums.kernel(np.array(SPACING))),
        as_printed=0.0,
        limit=0.35,
        damping=0.3,
    )
    out = np.full((sweeps.N_REGULAR_ROWS, state.shape[1]), np.nan)
    sweeps.regularity(
        near.particle, near.targets, neighbourhood.block_start, source, near.grid,
        near.cell_start, neighbourhood.reach, 1.0 / (ratio * SPACING), constants,
        np.empty((6, 0)), neighbourhood.scratch, out,
    )  # fmt: skip
    divergence = sums.divergence(state[3:].T, volume)
    expected = {
        (sweeps.OWN_PRESSURE,): state[2] - 0.3 * divergence,
        (sweeps.OWN_VISCOUS,): -2.0 / sums.laplacian_moment(volume),
        (sweeps.OWN_GRADIENT_X, sweeps.OWN_GRADIENT_Y): sums.renormalised_gradient(
            state[2], volume
        ),
        (sweeps.OWN_SHIFT_U, sweeps.OWN_SHIFT_V): sums.shifting_velocity(
            volume, 0.7, 0.25, as_printed=False
        ),
        (sweeps.DIVERGENCE,): divergence,
        (sweeps.SUPPORT_X, sweeps.SUPPORT_Y): sums.kernel_gradient_sum(volume),
    }
    assert sorted(sum(expected, ())) == list(range(sweeps.N_REGULAR_ROWS))
    for rows, values in expected.items():
        found = out[list(rows)].T.reshape(values.shape)
        assert np.max(np.abs(found - values)) < 1e-11 * np.max(np.abs(values))


@pytest.mark.parametrize("transport", ["advective", "paper"])
def test_is_bitwise_the_same_on_any_number_of_threads(
    scatter: Callable, threads, transport: str
) -> None:
    discretization = Discretization(
        SPACING, 2.0 * SPACING, acoustic_damping=1.0, shifting_transport=transport
    )
    functional = Functional(Fluid(1000.0, 10.0, 0.01, 1.0), discretization, BOX)
    state = scatter((0.0, 0.0), SPACING, SHAPE, "jittered", seed=3)
    if threads(2) < 2:
        pytest.skip("one core only")
    on_two = functional(state), functional.advection(state[:2], state[2], state[3:])
    threads(1)
    on_one = functional(state), functional.advection(state[:2], state[2], state[3:])
    for first, second in zip(on_two, on_one, strict=True):
        assert np.array_equal(first, second)


PLAIN = """
import sys
import numpy as np
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional
from sphrom.sph.walls import build_walls
from sphrom.reduction.reference_space import ReferenceMap
state = np.load(sys.argv[1])
box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
damped = Discretization(0.125, 0.1875, acoustic_damping=1.0)
functional = Functional(Fluid(1000.0, 10.0, 0.01, 1.0), damped, box)
printed = Discretization(0.125, 0.1875, shifting_transport="paper", viscosity="pair")
printed = Functional(functional.fluid, printed, box)
closed = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
walled = Functional(
    functional.fluid, functional.discretization, closed, build_walls(closed, 0.125, 3),
    lambda position, time: position - time,
)
inside = np.vstack((state[:2] % 1.0, state[2:]))
mapped = ReferenceMap(state[:2].T, box, particle_spacing=0.125, smoothing_length=0.25)
density, velocity = mapped(state[:2].T, state[2], state[3:].T)
out = np.vstack((
    functional(state), functional.advection(state[:2], state[2], state[3:]), density, velocity.T,
    printed(state), walled(inside, 0.3), walled.advection(inside[:2], inside[2], inside[3:]),
))
np.save(sys.argv[2], out)
"""


def test_the_compiler_changes_nothing_but_rounding(scatter: Callable, tmp_path) -> None:
    np.save(tmp_path / "state.npy", scatter((0.0, 0.0), 0.125, (8, 8), "jittered"))
    results = []
    for name, disabled in (("compiled", "0"), ("plain", "1")):
        target = tmp_path / f"{name}.npy"
        subprocess.run(
            [sys.executable, "-c", PLAIN, str(tmp_path / "state.npy"), str(target)],
            env={**os.environ, "NUMBA_DISABLE_JIT": disabled},
            check=True,
            timeout=300,
        )
        results.append(np.load(target))
    compiled, plain = results
    scale = np.max(np.abs(plain), axis=1, keepdims=True)
    assert np.isfinite(plain).all()
    assert np.max(np.abs(compiled - plain) / scale) < 1e-12
