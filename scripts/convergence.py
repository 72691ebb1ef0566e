"""The full model against the exact Taylor-Green vortex: order of convergence, and Ma -> 0.

Runs `cases/taylor_green_verification.yaml` at several resolutions and Mach numbers through the
command line, prints a table, and writes it as JSON.

    python scripts/convergence.py --resolutions 25 50 100 --mach 0.1 0.05
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from sphrom.metrics.trends import order_of_convergence

CASE = Path(__file__).parent.parent / "cases" / "taylor_green_verification.yaml"


def measure(resolution: int, mach: float, reynolds: float, folder: Path) -> dict[str, float]:
    """Run one full run and return its errors at the end."""
    out = folder / f"{resolution}-{mach}"
    settings = {
        "discretization.resolution": resolution,
        "fluid.mach_number": mach,
        "parameters.train.reynolds": [reynolds],
        "compare.plots": "false",
    }
    command = [sys.executable, "-m", "sphrom", "run", str(CASE), "--out", str(out), "--quiet"]
    for key, value in settings.items():
        command += ["--set", f"{key}={value}"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    results = json.loads((out / "compare.json").read_text())
    errors, decay = results["errors"][0], results["decay"][0]
    return {
        "resolution": resolution,
        "mach_number": mach,
        "velocity_l2_percent": errors["velocity_field_relative_l2_end"],
        "velocity_l2_peak_percent": errors["velocity_field_relative_l2_peak"],
        "pressure_l2_percent": errors["pressure_field_relative_l2_end"],
        "decay_rate_ratio": decay["ratio"],
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resolutions", type=int, nargs="+", default=[25, 50, 100])
    parser.add_argument("--mach", type=float, nargs="+", default=[0.1, 0.05])
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--json", type=Path, default=Path("runs/convergence.json"))
    arguments = parser.parse_args()
    rows = []
    print("N^(1/2)   Ma     velocity L2 end/peak [%]   pressure L2 [%]   decay rate / exact")
    with tempfile.TemporaryDirectory() as folder:
        for mach in arguments.mach:
            for resolution in arguments.resolutions:
                row = measure(resolution, mach, arguments.reynolds, Path(folder))
                rows.append(row)
                print(
                    f"{resolution:7d}  {mach:5.3g}  {row['velocity_l2_percent']:10.3f} / "
                    f"{row['velocity_l2_peak_percent']:.3f}  {row['pressure_l2_percent']:18.2f}"
                    f"  {row['decay_rate_ratio']:16.4f}",
                    flush=True,
                )
    orders = {}
    for mach in arguments.mach:
        chosen = [row for row in rows if row["mach_number"] == mach]
        if len(chosen) > 1:
            spacing = [1.0 / row["resolution"] for row in chosen]
            error = [row["velocity_l2_percent"] for row in chosen]
            orders[str(mach)] = order_of_convergence(spacing, error)
            print(f"Ma {mach:g}: fitted order {orders[str(mach)]:.2f} in velocity")
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps({"runs": rows, "orders": orders}, indent=2) + "\n")


if __name__ == "__main__":
    main()
