"""Two parameters against one: the same number of training runs, and what derivatives cost.

A lid-driven cavity at Re 50-200 is learnt twice from six full runs: at one lid speed, and at lid
speeds from half of it up. Every model is judged at full runs that it has not seen, over a grid of
the parameters. The last lines are ratios of times in one process: a run with two parameters over
one with one, and a run with its derivatives over the run alone.

    python scripts/bench_parameters.py --resolution 30 --out /tmp/parameters
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import sphrom
from sphrom.models.points.fast_model import FastModel
from sphrom.reduction import reference_model
from sphrom.reduction.exponential_steps import Change, ExponentialModel
from sphrom.store.workspace import Workspace

MODES = 10
ONE = {
    "train": {"reynolds": [50, 66, 87, 115, 152, 200]},
    "test": {"reynolds": [58, 100, 175]},
}
TWO = {
    "train": {"reynolds": [50, 100, 200], "lid": [0.5, 1.0]},
    "test": {"reynolds": [58, 101, 175], "lid": [0.55, 0.75, 0.95]},
}


def case(parameters: dict[str, Any], name: str, resolution: int, final_time: float) -> Any:
    """Return the content of a case."""
    model = {"evaluation": "operators", "n_modes": MODES}
    return {
        "name": name,
        "scene": {"kind": "lid-driven-cavity"},
        "discretization": {"resolution": resolution},
        "time": {"final_time": final_time},
        "snapshots": {"every": 3},
        "parameters": parameters,
        "rom": [
            {"name": "fast", **model},
            {"name": "calibrated", **model, "calibrated": True},
        ],
        "compare": {"plots": False, "from_time": 0.5 * final_time},
    }


def worst(study: sphrom.Study) -> dict[str, float]:
    """Return the worst error of velocity of each row of the comparison where it predicts [%]."""
    rows = json.loads((study.folder / "compare.json").read_text())["errors"]
    found: dict[str, float] = {}
    for row in rows:
        if row["role"] != "trained" and row["against"] == "full":
            error = row["velocity_field_relative_l2"]
            found[row["compared"]] = max(found.get(row["compared"], 0.0), error)
    return found


def least_seconds(work: Callable[[], object], repeats: int = 200) -> float:
    """Return the least time of some calls [s]."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def prepared(study: sphrom.Study, **values: float) -> tuple[Any, ExponentialModel, int]:
    """Return the fast model of a study at some values, ready to run."""
    workspace = Workspace(study._context)
    section = study.case.rom[0]
    reduced = FastModel(workspace, section).at(study.case.plan.point(values))
    steps = reference_model.automatic(reduced).steps
    assert isinstance(steps.system, ExponentialModel)
    return reduced, steps.system, steps.n_steps


def timed(one: sphrom.Study, two: sphrom.Study) -> dict[str, float]:
    """Return ratios of times of reduced runs, in as many steps each."""
    reduced, system, n_steps = prepared(one, reynolds=100.0)
    times = reduced.output_times
    other, wide, _ = prepared(two, reynolds=100.0, lid=0.8)
    alone = least_seconds(lambda: system.run(n_steps, reduced.start, times))
    same = least_seconds(lambda: wide.run(n_steps, other.start, times))
    changes = [Change(other.polynomial.scaled(0.1 * k), other.start) for k in (1, 2, 3)]
    found = {"run of two parameters over one": same / alone}
    for n in (1, 2, 3):
        with_tangents = least_seconds(
            lambda n=n: wide.tangents(n_steps, other.start, times, changes[:n])
        )
        found[f"run with {n} derivatives over the run alone"] = with_tangents / same
    return found


def main() -> None:
    """Run both cases, and print errors and ratios."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--resolution", type=int, default=30)
    parser.add_argument("--final-time", type=float, default=2.0)
    parser.add_argument("--out", type=Path, default=Path("runs/bench-parameters"))
    asked = parser.parse_args()
    studies = []
    for name, parameters in (("one", ONE), ("two", TWO)):
        content = case(parameters, name, asked.resolution, asked.final_time)
        study = sphrom.Study(content, out=asked.out / name, quiet=True)
        study.run()
        studies.append(study)
    one, two = map(worst, studies)
    for row in one:
        if row in two:
            line = f"{row}: one parameter {one[row]:.3g} %, two {two[row]:.3g} %"
            print(f"{line}, ratio {two[row] / one[row]:.3g}")
    for what, ratio in timed(*studies).items():
        print(f"{what}: {ratio:.3g}")


if __name__ == "__main__":
    main()
