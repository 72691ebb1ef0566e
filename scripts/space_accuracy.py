"""Errors of the full model in space against the solutions of `space_references.py`.

- `taylor-green`: the vortex in a periodic cube; errors are over the solution's norm.
- `cube`: the lid-driven cube; errors are over the lid's speed, on two lines through the centre, to
  which the solutions on two grids are extrapolated.

The case is the one that `sphrom case new` writes, with `--across` particles along the cube. Prints
also the processor time per particle and step, and the memory.

    python scripts/space_accuracy.py taylor-green --across 32 --time 2
    python scripts/space_accuracy.py cube --across 24 --time 5
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from space_references import Cube, Vortex

import sphrom
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.setup import particles
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

Array = NDArray[np.float64]

CASES = Path(sphrom.__file__).parent / "cases" / "new"
SPECTRAL_STEP = 0.05
N_POINTS = 32
"""Of the spectral solution along the cube: at Re 100 the energy at t = 2 agrees with 48 points."""
GRIDS = (36, 48)
"""Cells along the cube of the two finite difference solutions."""
PLACES = np.linspace(0.05, 0.95, 19)
"""On the centre lines."""
WRAP_EVERY = 10


def on_centre_lines(reynolds: float, until: float) -> tuple[Array, float]:
    """Return u along y and v along x (2, n_places), and the largest change by extrapolation."""
    found = []
    for n in GRIDS:
        cube = Cube(n, reynolds)
        cube.advance(until)
        found.append(np.stack(cube.profiles(PLACES)))
    coarse, fine = found
    change = (fine - coarse) / ((GRIDS[1] / GRIDS[0]) ** 2 - 1.0)
    return fine + change, float(np.abs(change).max())


def run(name: str, across: int, reynolds: float, until: float) -> tuple[Case, Array, str]:
    """Run the full model; return its case, its last state (7, n_particles), and its cost."""
    settings = [
        f"discretization.resolution={across}",
        f"parameters.train.reynolds=[{reynolds}]",
        "parameters.test.reynolds=[]",
        f"time.final_time={until}",
        "snapshots.every=1",
    ]
    case = load_case(CASES / f"{name}.yaml", settings, True)
    plan = case.plan
    point = plan.points[0]
    flow = plan.flow(point)
    position = case.scene.fill(plan.particle_spacing)
    if plan.packed:
        position = pack(flow.domain, plan.discretization).position
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    state = np.vstack((position.T, density, flow.initial_velocity(position).T))
    functional = particles.functional(case, point)
    functional(state)
    step = plan.steps.time_step
    began = time.process_time()
    for k in range(plan.steps.n_steps):
        state = runge_kutta_step(functional, state, k * step, step)
        if k % WRAP_EVERY == WRAP_EVERY - 1:
            state = functional.wrapped(state)
    spent = 1e6 * (time.process_time() - began) / (plan.steps.n_steps * len(position))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    mean = state[3].mean() / case.fluid.reference_density
    cost = f"{plan.steps.n_steps} steps, {spent:.1f} us per particle and step, {memory:.0f} MB"
    return case, state, f"{cost}, mean density {100 * mean:+.4f} %"


def taylor_green(across: int, reynolds: float, until: float) -> None:
    """Print the errors of the full model of the vortex."""
    vortex = Vortex(N_POINTS, reynolds)
    n_steps = math.ceil(until / SPECTRAL_STEP)
    for _ in range(n_steps):
        vortex.step(until / n_steps)
    case, state, cost = run("taylor-green-3d", across, reynolds, until)
    place = case.scene.domain.wrap(state[:3].T).T * N_POINTS / (2.0 * math.pi)
    fields = vortex.fields()
    velocity, pressure = (
        np.stack([map_coordinates(f, place, mode="grid-wrap") for f in np.atleast_1d(part)])
        for part in (fields[0], fields[1][None])
    )
    pressure = pressure[0] - pressure[0].mean()
    energy = 0.5 * np.mean(np.sum(state[4:] ** 2, axis=0)) / vortex.energy()[0] - 1.0
    found = pressure_of(state[3], case.plan.sound_speed) / case.fluid.reference_density
    found -= found.mean()
    errors = (
        np.linalg.norm(state[4:] - velocity) / np.linalg.norm(velocity),
        np.linalg.norm(found - pressure) / np.linalg.norm(pressure),
    )
    print(f"energy {100 * energy:+.3f} %, velocity {100 * errors[0]:.2f} %", end=", ")
    print(f"pressure {100 * errors[1]:.1f} %; {cost}")


def lid_driven_cube(across: int, reynolds: float, until: float) -> None:
    """Print the errors of the full model of the cube."""
    lines, change = on_centre_lines(reynolds, until)
    case, state, cost = run("lid-driven-cube", across, reynolds, until)
    middle = np.full_like(PLACES, 0.5)
    for component, along in ((0, 1), (1, 0)):
        places = np.stack((middle, middle, middle), axis=1)
        places[:, along] = PLACES
        sample = particles.sampler(case, places)
        _, velocity = sample(state[:3].T, state[3], state[4:].T)
        error = velocity[:, component] - lines[component]
        print(
            f"{'uvw'[component]} along {'xyz'[along]}: largest {np.abs(error).max():.4f}", end=", "
        )
        print(f"root mean square {math.sqrt(np.mean(error**2)):.4f}")
    print(f"extrapolation {change:.4f}; {cost}")


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flow", choices=("taylor-green", "cube"))
    parser.add_argument("--across", type=int, default=24)
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--time", type=float, default=2.0)
    arguments = parser.parse_args()
    show = taylor_green if arguments.flow == "taylor-green" else lid_driven_cube
    show(arguments.across, arguments.reynolds, arguments.time)


if __name__ == "__main__":
    main()
