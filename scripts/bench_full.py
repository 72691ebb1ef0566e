"""How fast the full model is: pairs per second and core, for whole time steps and sweep by sweep.

Runs the functional of the Taylor-Green vortex, and with --walls that of the lid-driven cavity, as
the product does: packed particles, shifting, density diffusion, classical Runge-Kutta steps with
the neighbour lists built anew as often as the flow needs. A pair is a particle and another one
within its kernel's support; each is counted once for each right-hand side, however many sweeps
visit it. Prints a table and writes JSON.

    python scripts/bench_full.py --quick
    python scripts/bench_full.py --threads 1 2 --particles 10000 90000 1000000 --walls
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

import sphrom
from sphrom.kernels import sweeps
from sphrom.kernels.jit import set_threads
from sphrom.scenes.flows import LidDrivenCavity, TaylorGreen
from sphrom.sph import functional as functional_module
from sphrom.sph import neighbourhood as neighbourhood_module
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid, fluctuation_of
from sphrom.sph.functional import Functional
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

TILE = 50
"""Particles along an edge of the packed square that larger sets are tiled with."""
SAMPLE = 10_000
"""Particles whose neighbours are counted."""
COURANT = 0.375
"""c0 dt / h of the steps: that of the Taylor-Green experiment at its full size."""
RIGHT_HAND_SIDES = 4
"""In a step."""


@dataclass(frozen=True)
class Timing:
    """One row of the table."""

    scene: str
    n_particles: int
    smoothing_length_ratio: float
    threads: int
    neighbours: float
    n_steps: int
    step_seconds: float
    """Median over the steps."""
    slowest_seconds: float
    pairs_per_second_and_core: float
    nanoseconds_per_particle: float
    """And right-hand side and core."""
    share_of_step: dict[str, float]
    """What each part takes of all steps' time."""


def clock() -> float:
    """Return the time [s]; on one thread that of the processor, whatever else it does."""
    return time.process_time() if numba.get_num_threads() == 1 else time.perf_counter()


def flow(scene: str, resolution: int, ratio: float) -> tuple[Functional, np.ndarray]:
    """Return the functional of a scene, and the state (5, n_particles) that it starts from."""
    spacing = 1.0 / resolution
    walled = scene == "lid-driven cavity"
    domain = BoxDomain((0.0, 0.0), (1.0, 1.0), (not walled, not walled))
    fluid = Fluid(
        reference_density=1000.0, sound_speed=10.0, kinematic_viscosity=0.01, max_speed=1.0
    )
    discretization = Discretization(spacing, ratio * spacing)
    if walled:
        cavity = LidDrivenCavity(length=1.0, speed=1.0, lid="regularised")
        walls = domain.ghosts(spacing, discretization.n_layers).moving(cavity.wall_velocity)
        position = domain.fill(spacing)
        state = np.vstack((position.T, np.zeros((3, len(position)))))
        return Functional(fluid, discretization, domain, walls=walls), state
    vortex = TaylorGreen(1.0, 1.0, fluid.reference_density, fluid.kinematic_viscosity)
    position = packed(resolution, domain)
    fluctuation = fluctuation_of(vortex.initial_pressure(position), fluid.sound_speed)
    state = np.vstack((position.T, fluctuation, vortex.initial_velocity(position).T))
    return Functional(fluid, discretization, domain), state


def packed(resolution: int, domain: Domain) -> np.ndarray:
    """Return packed positions (n_particles, 2), a small packed square repeated."""
    copies = resolution // TILE
    shifts = np.stack(np.meshgrid(np.arange(copies), np.arange(copies)), axis=-1).reshape(-1, 1, 2)
    return np.asarray(((tile() + shifts) / copies).reshape(-1, 2))


@cache
def tile() -> np.ndarray:
    """Return packed positions (TILE^2, 2) in the unit square."""
    box = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
    return pack(box, Discretization(1.0 / TILE, 2.0 / TILE)).position


def count_neighbours(functional: Functional, state: np.ndarray) -> float:
    """Return how many others a particle has within its support, ghosts of walls among them.

    The mean of evenly chosen particles.
    """
    domain, radius = functional.domain, functional.discretization.support_radius
    box = domain.lengths if all(domain.periodic) else None
    position = domain.wrap(state[:2].T)
    chosen = position[:: max(1, len(position) // SAMPLE)]
    trees = [cKDTree(position, boxsize=box)]
    if functional.ghosts is not None:
        trees.append(cKDTree(functional.ghosts.walls.position))
    counts = sum(tree.query_ball_point(chosen, radius, return_length=True) for tree in trees)
    return float(np.mean(counts)) - 1.0


@contextmanager
def profiled(seconds: dict[str, float]) -> Iterator[None]:
    """Add up the time in the parts of a right-hand side."""
    parts: list[tuple[Any, str, str]] = [
        (sweeps, "regularity", "regularity"),
        (sweeps, "rates", "rates"),
        (sweeps, "gather", "gather"),
        (functional_module.Functional, "_around", "ghosts"),
        (neighbourhood_module.Neighbourhood, "update", "neighbours"),
    ]
    before = [getattr(owner, name) for owner, name, _ in parts]

    def clocked(call: Callable[..., Any], label: str) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            started = clock()
            result = call(*arguments)
            seconds[label] = seconds.get(label, 0.0) + clock() - started
            return result

        return timed

    for (owner, name, label), call in zip(parts, before, strict=True):
        setattr(owner, name, clocked(call, label))
    try:
        yield
    finally:
        for (owner, name, _), call in zip(parts, before, strict=True):
            setattr(owner, name, call)


def measure(
    scene: str, resolution: int, ratio: float, threads: int, n_steps: int, budget: float
) -> Timing:
    """Time steps of one flow, at least two and not many more than fit a time [s]."""
    used = set_threads(threads)
    taken: list[float] = []
    parts: dict[str, float] = {}
    with profiled(parts):  # which functionals that are made before would not see
        functional, state = flow(scene, resolution, ratio)
        step = COURANT * functional.discretization.smoothing_length / functional.fluid.sound_speed
        state = runge_kutta_step(functional, state, 0.0, step)
        parts.clear()
        while len(taken) < 2 or (len(taken) < n_steps and sum(taken) < budget):
            started = clock()
            state = runge_kutta_step(functional, state, 0.0, step)
            taken.append(clock() - started)
    neighbours, median = count_neighbours(functional, state), float(np.median(taken))
    n_particles = state.shape[1]
    each = median * used / (RIGHT_HAND_SIDES * n_particles)
    total = sum(taken)
    return Timing(
        scene=scene,
        n_particles=n_particles,
        smoothing_length_ratio=ratio,
        threads=used,
        neighbours=neighbours,
        n_steps=len(taken),
        step_seconds=median,
        slowest_seconds=max(taken),
        pairs_per_second_and_core=neighbours / each,
        nanoseconds_per_particle=1e9 * each,
        share_of_step={name: value / total for name, value in parts.items()}
        | {"rest": 1.0 - sum(parts.values()) / total},
    )


def machine() -> dict[str, object]:
    """Return what figures depend on."""
    model = platform.processor()
    information = Path("/proc/cpuinfo")
    if information.exists():
        lines = information.read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if "model name" in line), model)
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "sphrom": sphrom.__version__,
        **{name: version(name) for name in ("numpy", "numba")},
    }


def show(rows: list[Timing]) -> None:
    """Print the table."""
    table = Table(title="full model: median of steps, neighbour search included")
    table.add_column("scene")
    for name in ("particles", "h/dx", "threads", "neighbours", "step [ms]", "M pairs/s/core",
                 "ns/particle"):  # fmt: skip
        table.add_column(name, justify="right")
    table.add_column("share of the step [%]")
    for row in rows:
        shares = sorted(row.share_of_step.items(), key=lambda item: -item[1])
        table.add_row(
            row.scene,
            str(row.n_particles),
            f"{row.smoothing_length_ratio:g}",
            str(row.threads),
            f"{row.neighbours:.0f}",
            f"{1e3 * row.step_seconds:.1f}",
            f"{1e-6 * row.pairs_per_second_and_core:.0f}",
            f"{row.nanoseconds_per_particle:.0f}",
            ", ".join(f"{name} {100.0 * share:.0f}" for name, share in shares if share > 0.004),
        )
    Console(width=None if os.isatty(1) else 160).print(table)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[10_000, 90_000, 1_000_000])
    parser.add_argument("--ratios", type=float, nargs="+", default=[2.0, 4.0], help="h / dx")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, os.cpu_count() or 1])
    parser.add_argument("--steps", type=int, default=20, help="at most, for each row")
    parser.add_argument("--seconds", type=float, default=3.0, help="about, for each row")
    parser.add_argument("--walls", action="store_true", help="the lid-driven cavity too")
    parser.add_argument("--quick", action="store_true", help="10,000 particles, three steps")
    parser.add_argument("--json", type=Path, default=Path("runs/bench_full.json"))
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.particles, arguments.steps, arguments.walls = [10_000], 3, True
    scenes = ["Taylor-Green", *(["lid-driven cavity"] if arguments.walls else [])]
    rows = []
    for scene in scenes:
        for particles in arguments.particles:
            for ratio in arguments.ratios:
                for threads in sorted(set(arguments.threads)):
                    resolution = TILE * max(1, round(particles**0.5 / TILE))
                    row = measure(
                        scene, resolution, ratio, threads, arguments.steps, arguments.seconds
                    )
                    rows.append(row)
    show(rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    results = {"machine": machine(), "rows": [asdict(row) for row in rows]}
    arguments.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
