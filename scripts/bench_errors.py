"""Error over processor time for the Taylor-Green vortex: sphrom, PySPH and JAX-SPH.

All start from the same packed particles, with the same kernel and support, and run on one thread.
sphrom takes the steps of `time.step: auto`; peers take theirs (`peer_vortices.py`). Times are those
of all steps, without start, compilation and output. The error is that of the velocity of particles
at the end. Installs peers into environments of their own. Prints a table; writes JSON and a plot.

    python scripts/bench_errors.py --figure docs/figures/error-over-time.png
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np
from bench_full import TILE, machine, packed
from bench_peers import install
from rich.console import Console
from rich.table import Table

from sphrom.case.loader import load_case
from sphrom.kernels.jit import set_threads
from sphrom.metrics.histories import relative_l2
from sphrom.setup.particles import functional
from sphrom.sph.fluid import fluctuation_of
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

CASE = Path(__file__).parent.parent / "cases" / "taylor_green_verification.yaml"
PEER = Path(__file__).with_name("peer_vortices.py")
OURS = {"sphrom": "float64", "sphrom, float32": "float32"}
PEERS = {"PySPH, EDAC": "edac", "PySPH, TVF": "tvf", "JAX-SPH": "jax-sph"}
FINEST = (("JAX-SPH", "50"), ("PySPH, TVF", "50"))
"""Finest resolutions of slow programs; finer runs would take longer than all others together."""
JAX_SPH = (
    ["--no-deps", "--ignore-requires-python", "jax-sph"],
    ["jax[cpu]==0.4.29", "numpy<2", "scipy<1.13", "h5py", "omegaconf", "pandas", "pyvista"],
)
"""Arguments of pip: the package, which refuses Python 3.11.1 and later, and its requirements."""


def vortex(resolution: int, ratio: float, final_time: float, precision: str) -> dict[str, object]:
    """Return the case, model and start of a run, by name."""
    settings = {
        "discretization.resolution": resolution,
        "discretization.smoothing_length_ratio": ratio,
        "discretization.pair_precision": precision,
        "time.final_time": final_time,
        "time.courant_number": 1.2,
        "snapshots.every": 1,
    }
    case = load_case(str(CASE), settings)
    point = case.plan.points[0]
    domain = case.scene.domain
    if resolution % TILE:
        position = pack(domain, case.plan.discretization).position
    else:
        position = packed(resolution, domain)
    flow = case.plan.flow(point)
    return {
        "case": case,
        "flow": flow,
        "model": functional(case, point),
        "position": position,
        "pressure": flow.initial_pressure(position),
        "velocity": flow.initial_velocity(position),
    }


def run_ours(run: dict) -> dict[str, object]:
    """Return time and error of a run by sphrom."""
    case, model = run["case"], run["model"]
    fluctuation = fluctuation_of(run["pressure"], case.plan.sound_speed)
    state = np.vstack((run["position"].T, fluctuation, run["velocity"].T))
    steps = case.plan.steps
    model(state)
    started = time.process_time()
    for number in range(steps.n_steps):
        state = runge_kutta_step(model, state, steps.time(number), steps.time_step)
    seconds = time.process_time() - started
    exact = run["flow"].exact.velocity(state[:2].T, steps.time(steps.n_steps))
    error = float(relative_l2(state[3:].T, exact, field_axes=2))
    return {"seconds": seconds, "n_steps": steps.n_steps, "error": error}


def run_peer(python: Path, name: str, run: dict, folder: Path) -> dict[str, object]:
    """Return time and error of a run by another program."""
    plan = run["case"].plan
    point = plan.points[0]
    target = folder / "state.npz"
    np.savez(
        target,
        position=run["case"].scene.domain.wrap(run["position"]).T,
        velocity=run["velocity"].T,
        pressure=run["pressure"],
        spacing=plan.particle_spacing,
        smoothing_length=plan.smoothing_length,
        reference_density=run["case"].fluid.reference_density,
        sound_speed=plan.sound_speed,
        kinematic_viscosity=plan.kinematic_viscosity(point),
        final_time=run["case"].time.final_time,
    )
    single = {"OMP_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
    done = subprocess.run(
        [python, PEER, name, target], check=True, capture_output=True, text=True,
        env={**os.environ, **single},
    )  # fmt: skip
    result: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return result


def draw(rows: list[dict], target: Path) -> None:
    """Draw the error over the time."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.6, 3.8), layout="constrained")
    for name in dict.fromkeys(row["program"] for row in rows):
        own = [row for row in rows if row["program"] == name]
        seconds, errors = ([row[key] for row in own] for key in ("seconds", "error"))
        axes.loglog(seconds, errors, "o-", label=name)
        for row in own:
            at = (row["seconds"], row["error"])
            label = str(row["resolution"])
            axes.annotate(label, at, xytext=(3, 4), textcoords="offset points", fontsize=7)
    axes.set_xlabel("processor time [s]")
    axes.set_ylabel("relative L2 error of velocity [%]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=110)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environments", type=Path, default=Path("runs/peers"))
    parser.add_argument("--resolutions", type=int, nargs="+", default=[25, 50, 100])
    parser.add_argument("--programs", nargs="+", default=[*OURS, *PEERS])
    parser.add_argument("--most", nargs=2, action="append", help="a program, its finest resolution")
    parser.add_argument("--ratio", type=float, default=2.0, help="h / dx")
    parser.add_argument("--final-time", type=float, default=0.5, help="[s]")
    parser.add_argument("--json", type=Path, default=Path("runs/bench_errors.json"))
    parser.add_argument("--figure", type=Path, default=Path("runs/error-over-time.png"))
    arguments = parser.parse_args()
    set_threads(1)
    pythons = {}
    if {"PySPH, EDAC", "PySPH, TVF"} & set(arguments.programs):
        pythons["edac"] = pythons["tvf"] = install(arguments.environments / "pysph")
    if "JAX-SPH" in arguments.programs:
        pythons["jax-sph"] = install(arguments.environments / "jax-sph", "jax_sph", JAX_SPH)
    most = {name: int(finest) for name, finest in arguments.most or FINEST}
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    table = Table(title="error of velocity [%] over processor time [s]")
    for column in ("program", "particles", "steps", "time", "error"):
        table.add_column(column, justify="right")
    for resolution in arguments.resolutions:
        for name in arguments.programs:
            if resolution > most.get(name, resolution):
                continue
            precision = OURS.get(name, "float64")
            run = vortex(resolution, arguments.ratio, arguments.final_time, precision)
            if name in OURS:
                row = run_ours(run)
            else:
                peer = PEERS[name]
                row = run_peer(pythons[peer], peer, run, arguments.json.parent)
            rows.append({"program": name, "resolution": resolution, **row})
            print(rows[-1], flush=True)
            cells = (row["n_steps"], f"{row['seconds']:.3g}", f"{row['error']:.3g}")
            table.add_row(name, f"{resolution}x{resolution}", *map(str, cells))
            results = {"machine": machine(), "threads": 1, "rows": rows}
            arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    Console().print(table)
    draw(rows, arguments.figure)


if __name__ == "__main__":
    main()
