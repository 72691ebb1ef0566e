"""The full model against the exact Taylor-Green vortex: order of convergence, Re, and Ma -> 0.

Runs `cases/taylor_green_verification.yaml` at several resolutions, Reynolds and Mach numbers
through the command line, prints a table, and writes it as JSON. Errors are on the grid that
`compare` samples, which smooths the scatter of particles, and over the particles themselves.

    python scripts/convergence.py --reynolds 60 100 200 400 1000 --mach 0.1 0.05
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.metrics.histories import relative_l2

CASE = Path(__file__).parent.parent / "cases" / "taylor_green_verification.yaml"


def measure(resolution: int, mach: float, reynolds: float, folder: Path) -> dict[str, float]:
    """Run one full run and return its errors at the end."""
    out = folder / f"{resolution}-{mach}-{reynolds}"
    settings = {
        "discretization.resolution": resolution,
        "fluid.mach_number": mach,
        "parameters.train.reynolds": [reynolds],
        "compare.plots": False,
    }
    command = [sys.executable, "-m", "sphrom", "run", str(CASE), "--out", str(out), "--quiet"]
    for key, value in settings.items():
        command += ["--set", f"{key}={json.dumps(value)}"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    results = json.loads((out / "compare.json").read_text())
    errors, decay = results["errors"][0], results["decay"][0]
    case = load_case(str(CASE), settings)
    with open_artifact(next(out.glob("fom-*.h5")), "sphrom/trajectory", made_by="") as run:
        position, velocity, time = (run.dataset(n)[-1] for n in ("position", "velocity", "time"))
    exact = case.plan.flow(case.plan.points[0]).exact.velocity(position, time)
    return {
        "resolution": resolution,
        "mach_number": mach,
        "reynolds": reynolds,
        "velocity_l2_percent": errors["velocity_field_relative_l2_end"],
        "velocity_l2_particles_percent": float(relative_l2(velocity, exact, field_axes=2)),
        "velocity_l2_peak_percent": errors["velocity_field_relative_l2_peak"],
        "pressure_l2_percent": errors["pressure_field_relative_l2_end"],
        "decay_rate_ratio": decay["ratio"],
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resolutions", type=int, nargs="+", default=[25, 50, 100])
    parser.add_argument("--mach", type=float, nargs="+", default=[0.1])
    parser.add_argument("--reynolds", type=float, nargs="+", default=[100.0])
    parser.add_argument("--json", type=Path, default=Path("runs/convergence.json"))
    arguments = parser.parse_args()
    rows, orders = [], []
    print(
        "    Re    Ma  N^(1/2)  velocity L2 end/peak [%]  over particles [%]  pressure L2 [%]  "
        "decay rate / exact"
    )
    with tempfile.TemporaryDirectory() as folder:
        for reynolds, mach in itertools.product(arguments.reynolds, arguments.mach):
            chosen = []
            for resolution in arguments.resolutions:
                row = measure(resolution, mach, reynolds, Path(folder))
                chosen.append(row)
                print(
                    f"{reynolds:6g} {mach:5.3g} {resolution:8d}  {row['velocity_l2_percent']:12.3f}"
                    f" / {row['velocity_l2_peak_percent']:.3f} "
                    f"{row['velocity_l2_particles_percent']:19.3f} "
                    f"{row['pressure_l2_percent']:16.2f} {row['decay_rate_ratio']:19.4f}",
                    flush=True,
                )
            rows += chosen
            if len(chosen) > 1:
                spacing = [1.0 / row["resolution"] for row in chosen]
                error = [row["velocity_l2_percent"] for row in chosen]
                order = float(np.polyfit(np.log(spacing), np.log(error), 1)[0])
                orders.append({"reynolds": reynolds, "mach_number": mach, "order": order})
                print(f"Re {reynolds:g}, Ma {mach:g}: fitted order {order:.2f} in velocity")
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps({"runs": rows, "orders": orders}, indent=2) + "\n")


if __name__ == "__main__":
    main()
