"""The cost of a step of a lid-driven cavity with walls of one kind, relative to another kind.

Also the cost with pairs in one precision relative to another, with walls or without.

Both flows take turns in one process, and ratios are medians over many turns of processor time,
because other processes slow both down alike.

    python scripts/bench_walls.py --kinds adjoint mirrored --across 50 100 200
    python scripts/bench_walls.py --kinds none none --precisions float32 float64 --across 100
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from bench_full import COURANT

from sphrom.kernels.jit import set_threads
from sphrom.scenes.flows import LidDrivenCavity
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import runge_kutta_step

BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
PERIODIC = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
FLUID = Fluid(reference_density=1000.0, sound_speed=10.0, kinematic_viscosity=0.01, max_speed=1.0)
LID = LidDrivenCavity(length=1.0, speed=1.0, lid="regularised")
FIRST_STEPS = 3


class Flow:
    """A cavity with walls of one kind, or none around the fluid's vortices."""

    def __init__(self, kind: str, precision: str, across: int, ratio: float) -> None:
        spacing = 1.0 / across
        walled = kind != "none"
        sizes = Discretization(
            spacing,
            ratio * spacing,
            wall_kind=kind if walled else "mirrored",
            acoustic_damping=1.0,
            pair_precision=precision,
        )
        walls = BOX.ghosts(spacing, sizes.n_layers).moving(LID.wall_velocity) if walled else None
        self._rates = Functional(FLUID, sizes, BOX if walled else PERIODIC, walls=walls)
        self._step = COURANT * sizes.smoothing_length / FLUID.sound_speed
        position = BOX.fill(spacing).T
        self._state = np.vstack((position, np.zeros((3, position.shape[1]))))
        if not walled:
            self._state[3:] = np.sin(2.0 * np.pi * position[::-1])
        self.go(FIRST_STEPS)

    def go(self, n_steps: int) -> float:
        """Take some steps; return the processor time of one [s]."""
        started = time.process_time()
        for _ in range(n_steps):
            self._state = runge_kutta_step(self._rates, self._state, 0.0, self._step)
        return (time.process_time() - started) / n_steps


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--kinds", nargs=2, default=["adjoint", "mirrored"], help="of walls, or none"
    )
    parser.add_argument("--precisions", nargs=2, default=["float64", "float64"], help="of pairs")
    parser.add_argument("--across", type=int, nargs="+", default=[50, 100, 200], help="particles")
    parser.add_argument("--ratio", type=float, default=2.0, help="h / dx")
    parser.add_argument("--turns", type=int, default=40)
    arguments = parser.parse_args()
    set_threads(1)
    for across in arguments.across:
        settings = zip(arguments.kinds, arguments.precisions, strict=True)
        flows = [Flow(kind, precision, across, arguments.ratio) for kind, precision in settings]
        n_steps = max(1, round(10 * (50 / across) ** 2))
        taken = []
        for turn in range(arguments.turns):
            order = [0, 1] if turn % 2 else [1, 0]
            seconds = {which: flows[which].go(n_steps) for which in order}
            taken.append((seconds[0], seconds[1]))
        first, second = np.array(taken).T
        low, median, high = np.percentile(second / first, [25, 50, 75])
        milliseconds = " and ".join(f"{1e3 * np.median(steps):.2f}" for steps in (first, second))
        quartiles = f"quartiles {low:.3f} and {high:.3f}"
        print(f"{across} across: {milliseconds} ms, ratio {median:.3f} ({quartiles})", flush=True)


if __name__ == "__main__":
    main()
