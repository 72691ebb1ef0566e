"""What thousands of draws cost: seconds of `sphrom sweep` with statistics, start-up included.

    python scripts/bench_uncertainty.py

Needs some seconds for the full runs of `cases/taylor_green_demo.yaml`, once; they stay in the
folder that `--out` names. Processor time is that of all processes. On a machine that does nothing
else the wall time is about half of it on two cores, and the time of what one process does alone:
start-up, statistics, tables and figures.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

CASE = Path(__file__).parents[1] / "cases" / "taylor_green_demo.yaml"
REYNOLDS = "{distribution: truncnorm, a: -3, b: 3, loc: 150, scale: 16}"
PROBE = ("--set", "scene.measure={there: {probe: [0.25, 0.5]}}")
STAGES = ("fom", "map", "pod", "fit-psi", "operators")


def sphrom(*arguments: object) -> tuple[float, float]:
    """Run a command, and return its wall time and its processor time [s]."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "sphrom", *map(str, arguments), "--quiet"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=1800)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print a table of numbers of runs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/bench_uncertainty"))
    parser.add_argument("--runs", type=int, nargs="+", default=[100, 1000, 10_000])
    options = parser.parse_args()
    for stage in STAGES:
        if not (options.out / "operators.h5").exists():
            sphrom(stage, CASE, "--out", options.out, *PROBE)
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    print("runs | wall [s] | processor [s]\n---|---|---")
    for count in options.runs:
        settings = (
            "sweep.reynolds=null", f"sweep.name=draws{count}",
            f"sweep.sample={{count: {count}, reynolds: {REYNOLDS}}}",
        )  # fmt: skip
        given = [word for setting in settings for word in ("--set", setting)]
        wall, processor = sphrom("sweep", CASE, "--out", options.out, "--force", *PROBE, *given)
        print(f"{count} | {wall:.1f} | {processor:.1f}", flush=True)


if __name__ == "__main__":
    main()
