"""The sweeps without the compiler."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

PLAIN = """
import sys
import numpy as np
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional
from sphrom.reduction.reference_space import ReferenceMap
state = np.load(sys.argv[1])
box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
damped = Discretization(0.125, 0.1875, acoustic_damping=1.0)
functional = Functional(Fluid(1000.0, 10.0, 0.01, 1.0), damped, box)
printed = Discretization(0.125, 0.1875, shifting_transport="paper", viscosity="pair")
printed = Functional(functional.fluid, printed, box)
closed = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
walled = Functional(
    functional.fluid, functional.discretization, closed, closed.ghosts(0.125, 3),
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


def test_the_compiler_changes_nothing_but_rounding(scatter: Callable, tmp_path, printed) -> None:
    np.save(tmp_path / "state.npy", scatter((0.0, 0.0), 0.125, (8, 8), "jittered"))
    results = []
    for name, disabled in (("compiled", "0"), ("plain", "1")):
        target = tmp_path / f"{name}.npy"
        printed(PLAIN, tmp_path / "state.npy", target, NUMBA_DISABLE_JIT=disabled)
        results.append(np.load(target))
    compiled, plain = results
    scale = np.max(np.abs(plain), axis=1, keepdims=True)
    assert np.isfinite(plain).all()
    assert np.max(np.abs(compiled - plain) / scale) < 1e-12
