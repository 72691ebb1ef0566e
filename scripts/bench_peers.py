"""The full model beside PySPH: one right-hand side of the same flow, particles and support.

Installs PySPH from the package registry into an environment of its own (it compiles its sums with a
C++ compiler, which has to be there), and takes the processor time of right-hand sides of both on
one thread, in turns. A pair is a particle and another one within its kernel's support. Prints a
table and writes JSON.

    python scripts/bench_peers.py --environment /tmp/pysph
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bench_full import count_neighbours, flow, machine
from rich.console import Console
from rich.table import Table

from sphrom.kernels.jit import set_threads
from sphrom.sph.functional import Functional

PEER = Path(__file__).with_name("pysph_taylor_green.py")
PYSPH = [["pysph", "setuptools"]]
DIFFERENCES = """What differs:
- sphrom: delta-plus-SPH; shifting velocities and their terms in continuity and momentum at every
  right-hand side, four of which make a classical Runge-Kutta step. Neighbour lists are kept until a
  particle has moved by 0.3 spacings (bench_full.py has whole steps); where the search is included
  here, the list is built anew at every right-hand side, as PySPH does.
- PySPH: delta-SPH after Marrone et al. 2011 with XSPH, and one Fickian shift of positions without
  terms of its own in the equations; a predictor and a corrector make a step, with two right-hand
  sides and one shift; neighbours are found anew each time.
- Both: Wendland's C2 kernel, renormalised density gradients, laminar viscosity, float64, periodic
  images."""


def install(
    environment: Path, module: str = "pysph", wanted: Sequence[Sequence[str]] = PYSPH
) -> Path:
    """Return the interpreter of an environment with a program, made if it isn't there yet.

    `wanted` are the arguments of calls of pip.
    """
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        venv.create(environment, with_pip=True)
    if subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode:
        command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        for packages in wanted:
            subprocess.run([*command, *packages], check=True)
    return python


def write_state(target: Path, functional: Functional, state: np.ndarray) -> None:
    """Write what the peer needs."""
    fluid, discretization = functional.fluid, functional.discretization
    np.savez(
        target,
        position=functional.domain.wrap(state[:2].T).T,
        density_fluctuation=state[2],
        velocity=state[3:],
        spacing=discretization.particle_spacing,
        smoothing_length=discretization.smoothing_length,
        reference_density=fluid.reference_density,
        sound_speed=fluid.sound_speed,
        kinematic_viscosity=fluid.kinematic_viscosity,
    )


def time_ours(functional: Functional, state: np.ndarray, repeats: int, rebuild: bool) -> float:
    """Return the median time of a right-hand side [s]."""
    functional(state)
    taken = []
    for _ in range(repeats):
        if rebuild:
            functional.neighbourhood.rebuild_at(None)
        started = time.process_time()
        functional(state)
        taken.append(time.process_time() - started)
    return float(np.median(taken))


def compare(python: Path, resolution: int, ratio: float, repeats: int) -> dict[str, object]:
    """Return the figures of one row."""
    functional, state = flow("Taylor-Green", resolution, ratio)
    pairs = count_neighbours(functional, state) * state.shape[1]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "state.npz"
        write_state(target, functional, state)
        done = subprocess.run(
            [python, PEER, target, str(repeats)],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
    peer = json.loads(done.stdout.splitlines()[-1])
    rebuilt = time_ours(functional, state, 3 * repeats, rebuild=True)
    kept = time_ours(functional, state, 3 * repeats, rebuild=False)
    return {
        "n_particles": state.shape[1],
        "smoothing_length_ratio": ratio,
        "pairs": pairs,
        "sphrom_seconds_list_rebuilt": rebuilt,
        "sphrom_seconds_list_kept": kept,
        "pysph_seconds": peer["seconds"],
        "pysph_seconds_without_search": peer["seconds_without_search"],
        "ratio_list_rebuilt": peer["seconds"] / rebuilt,
        "ratio_without_search": peer["seconds_without_search"] / kept,
        "pysph_version": peer["version"],
        "pysph_equations": peer["equations"],
    }


def show(rows: list[dict]) -> None:
    """Print the table."""
    table = Table(title="million pairs per second, one right-hand side on one core")
    for name in ("particles", "h/dx", "search", "sphrom", "PySPH", "ratio"):
        table.add_column(name, justify="right")
    for row in rows:
        for search, ours, theirs in (
            ("included", "sphrom_seconds_list_rebuilt", "pysph_seconds"),
            ("without", "sphrom_seconds_list_kept", "pysph_seconds_without_search"),
        ):
            table.add_row(
                str(row["n_particles"]),
                f"{row['smoothing_length_ratio']:g}",
                search,
                f"{1e-6 * row['pairs'] / row[ours]:.1f}",
                f"{1e-6 * row['pairs'] / row[theirs]:.2f}",
                f"{row[theirs] / row[ours]:.0f}",
            )
    console = Console()
    console.print(table)
    print(DIFFERENCES)
    print(f"PySPH {rows[0]['pysph_version']}: {', '.join(rows[0]['pysph_equations'])}")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environment", type=Path, help="folder to install PySPH in, and to keep")
    parser.add_argument("--resolution", type=int, default=100, help="particles along an edge")
    parser.add_argument("--ratios", type=float, nargs="+", default=[2.0, 4.0], help="h / dx")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, default=Path("runs/bench_peers.json"))
    arguments = parser.parse_args()
    set_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        try:
            python = install(arguments.environment or Path(folder))
            rows = [
                compare(python, arguments.resolution, ratio, arguments.repeats)
                for ratio in arguments.ratios
            ]
        except subprocess.CalledProcessError as error:
            sys.exit(f"PySPH did not install or run:\n{error.stderr or error}")
    show(rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    results = {"machine": machine(), "threads": 1, "rows": rows}
    arguments.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
