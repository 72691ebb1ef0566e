"""Sobol indices of full runs beside those of a reduced model: what noise of particles changes.

A row of cylinders in a channel, whose viscosity and body force are uncertain. The full model and
the reduced one run at the same draws of Saltelli's design, 64 by default. For every output a row
says, at the end or of the mean over time: the share of the model's error in the variance of full
runs as it is estimated; the true root mean square error over the estimated one, over all runs and
instants; the indices of first order of both; and by how much an index is off at most.

    python scripts/bench_noise.py               a cylinder off the middle
    python scripts/bench_noise.py --height 0    in the middle: its lift is noise
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import numpy as np

import sphrom
from sphrom.arrays import Array
from sphrom.artifacts import open_artifact, read_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.studies import sweep_name
from sphrom.store.workspace import Workspace
from sphrom.sweep.batches import RunRecord, SweptModel, read_records
from sphrom.sweep.statistics import Output, outputs_of


def case(height: float, count: int) -> dict[str, Any]:
    """Return the content of a case, with the cylinder at a height above the middle [m]."""
    floor, ceiling = [[0, -1.5], [3, -1]], [[0, 1], [3, 1.5]]
    walls = {
        name: {"rectangle": {"lower": low, "upper": high}}
        for name, (low, high) in (("floor", floor), ("ceiling", ceiling))
    }
    cylinder = {"circle": {"centre": [1.0, height], "radius": 0.4}}
    return {
        "name": "noise",
        "scene": {
            "kind": "custom",
            "box": {"lower": [0, -1], "upper": [3, 1], "periodic": ["x"]},
            "solids": {**walls, "cylinder": cylinder},
            "constants": {"push": 0.15},
            "body_force": ["push", 0],
            "reference_length": 1.0,
            "measure": {
                "wake": {"probe": [2.0, 0.1]},
                "side": {"probe": [1.0, 0.7]},
                "above": {"flow_rate": {"from": [1.0, 0.6], "to": [1.0, 1.0]}},
                "load": {"force_on": "cylinder"},
            },
        },
        "fluid": {"reference_speed": 0.5},
        "discretization": {"resolution": 14, "smoothing_length_ratio": 1.6},
        "reference": {"smoothing_length_ratio": 1.6},
        "time": {"final_time": 5.0},
        "snapshots": {"every": 6},
        "parameters": {
            "train": {"reynolds": [20, 80], "push": [0.1, 0.2]},
            "test": {"reynolds": []},
        },
        "rom": [{"name": "fast", "n_modes": 8, "evaluation": "operators"}],
        "sweep": {
            "sample": {
                "method": "saltelli",
                "count": count,
                "seed": 1,
                "reynolds": {"distribution": "uniform", "loc": 30, "scale": 40},
                "push": {"distribution": "uniform", "loc": 0.12, "scale": 0.06},
            },
            "quantiles": [0.5],
        },
    }


def swept(study: sphrom.Study) -> tuple[Statistics, list[RunRecord]]:
    """Make the sweep of a study, and return its statistics and its runs."""
    study.run_stage("sweep", workers=1)
    path = study.folder / f"sweep-{sweep_name(study.case)}.h5"
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        return read_record(artifact, Statistics, "statistics"), read_records(artifact)


def size(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print a row for every output."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--height", type=float, default=0.1, help="of the cylinder [m]")
    parser.add_argument("--count", type=int, default=16, help="a quarter of the full runs")
    parser.add_argument("--out", type=Path, default=Path("runs/bench_noise"))
    options = parser.parse_args()
    shutil.rmtree(options.out, ignore_errors=True)
    given = case(options.height, options.count)
    study = sphrom.Study(given, out=options.out, quiet=True)
    study.run(until="operators")
    full_case = {**given, "sweep": {**given["sweep"], "model": "full"}}
    full, full_runs = swept(sphrom.Study(full_case, out=options.out, quiet=True))
    fast, fast_runs = swept(study)
    trained = SweptModel(Workspace(study._context)).in_training([r.point for r in fast_runs])

    def outputs(runs: list[RunRecord], known: Any = ()) -> dict[str, Output]:
        found = outputs_of(study.case, [run.values for run in runs], known)
        return {output.name: output for output in found}

    truth = outputs(full_runs)
    print(
        "output | share of the error | true over estimated | fast | full | index off by\n"
        + 5 * "---|"
        + "---"
    )
    for name, output in outputs(fast_runs, trained).items():
        own, others = fast.indices[name], full.indices[name]
        off = max(
            np.abs(getattr(own, k) - getattr(others, k))[:, -1].max() for k in ("first", "total")
        )
        share, wrong = fast.outputs[name].error_share, size(output.values - truth[name].values)
        first = [", ".join(f"{s:.2f}" for s in each.first[:, -1]) for each in (own, others)]
        figures = f"{share[-1]:.2f} | {wrong / size(output.errors):.2f}"
        print(f"{name} | {figures} | {' | '.join(first)} | {off:.2f}")


if __name__ == "__main__":
    main()
