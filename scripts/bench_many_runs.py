"""Processor time of many runs of a fast model from Python, with measurements and estimated errors.

    python scripts/bench_many_runs.py

The lid-driven cavity of `cases/uncertain_lid.yaml` has a force, a flow rate and a probe, two
parameters and eight modes. Its six full runs take seconds, once; they stay in the folder that
`--out` names.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np

import sphrom

CASE = Path(__file__).parents[1] / "cases" / "uncertain_lid.yaml"
OUTPUTS = "drag_force_x", "vortex_flow_rate_mean", "error_estimate_drag_force_x"


def processor_time(work: Callable[[], object]) -> float:
    """Return the processor time [s] of this process that some work takes."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    work()
    after = resource.getrusage(resource.RUSAGE_SELF)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the processor time of a run, made in three ways."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/bench_many_runs"))
    parser.add_argument("--runs", type=int, default=1000)
    options = parser.parse_args()
    study = sphrom.Study(CASE, out=options.out, quiet=True, threads=1)
    study.run(until="operators")
    model = study.model("fast", reynolds=100, lid=0.75)
    names = tuple(model.ranges)
    f = model.function(names, OUTPUTS)
    low, high = f.bounds.T
    rows = low + (high - low) * np.random.default_rng(1).random((options.runs, len(names)))
    f(rows[:2])  # compiles

    def one_by_one() -> None:
        for row in rows:
            run = model.at(**dict(zip(names, row.tolist(), strict=True))).run()
            assert run.error_estimate
            assert run.measures

    ways: dict[str, Callable[[], object]] = {
        "one by one": one_by_one,
        "run_many": lambda: model.run_many(dict(zip(names, rows.T, strict=True))),
        "function": lambda: f(rows),
    }
    print(f"{options.runs} runs | processor time of one [ms]\n---|---")
    for name, work in ways.items():
        print(f"{name} | {1e3 * processor_time(work) / options.runs:.2f}", flush=True)


if __name__ == "__main__":
    main()
