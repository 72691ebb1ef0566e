"""Estimated errors of oscillations beside true ones, of models of a coarse wake.

The wake is that of `scripts/onset.py`, in full runs of 72 s of which the last 36 s are recorded.
Models are trained on some of these runs, and predict all of them: their frequency, amplitude and
mean of the lift and of the transverse velocity 4 diameters behind the cylinder, and the phases at
the end. A second run takes only the time of the models.

    python scripts/oscillation_estimates.py

With `--train`, one model is trained for Re 60 to 120 with three full runs, one of which it chooses.
With `--two-cylinders`, a wake with two frequencies is run, whose model is refused.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from onset import CASE, CHANGES

from sphrom.api.study import Study
from sphrom.compare.measured import oscillation_rows
from sphrom.metrics.series import ESTIMATED
from sphrom.models.points.fast_model import FastModel
from sphrom.store.trajectory import measured_of
from sphrom.store.workspace import Workspace

VALUES = [60, 70, 80, 90, 100, 110, 120]
TRAINED = [
    [80, 120], [60, 120], [60, 100], [70, 110],
    [60, 80, 120], [80, 100, 120], [60, 90, 120], [70, 90, 110],
    [60, 80, 100, 120], [60, 70, 110, 120], [60, 80, 90, 100, 110, 120],
]  # fmt: skip
"""Reynolds numbers of the training runs of each model."""
CASE_CHANGES = CHANGES | {
    "time": {"step": 0.01875, "spin_up": 36.0, "final_time": 72.0},
    "scene.measure.shedding": {"frequency": {"of": "cylinder_force_y"}},
    "scene.measure.beat": {"frequency": {"of": "far_velocity_y"}},
    "parameters": {"train": {"reynolds": VALUES}, "test": {"reynolds": []}},
    "basis.subsets": {f"b{k}": {"reynolds": values} for k, values in enumerate(TRAINED)},
    "rom": [
        {"name": f"m{k}", "basis": f"b{k}", "n_modes": 20}
        | {"evaluation": "operators", "calibrated": "cycle"}
        for k in range(len(TRAINED))
    ],
}


TRAINING = {
    "parameters": {"train": {"reynolds": [60, 120]}, "test": {"reynolds": []}},
    "basis.subsets": {},
    "rom": [{"name": "fast", "n_modes": 20, "evaluation": "operators", "calibrated": "cycle"}],
    "training": {"reynolds": [60, 120], "tolerance": "4%", "budget": 3},
}
"""Changes of the case for a training."""
TWO_CYLINDERS = {
    "scene.box": {"lower": [-4, -4], "upper": [8, 4], "periodic": ["x", "y"]},
    "scene.inflow.strip": {"from": -4, "to": -1.5},
    "scene.solids": {
        "large": {"circle": {"centre": [0, 1.25], "radius": 0.5}},
        "small": {"circle": {"centre": [0, -1.25], "radius": 0.35}},
    },
    "scene.measure": {
        "large": {"force_on": "large"},
        "small": {"force_on": "small"},
        "shedding": {"frequency": {"of": "large_force_y"}},
        "other": {"frequency": {"of": "small_force_y"}},
    },
    "fluid.mach_number": 0.1,
    "discretization.resolution": 8,
    "time": {"step": 0.0125, "spin_up": 30.0, "final_time": 75.0},
    "snapshots.every": 24,
    "parameters": {"train": {"reynolds": [100]}, "test": {"reynolds": []}},
}
"""Changes of the case for two cylinders side by side."""


def where(value: float, trained: list[int]) -> str:
    """Return where a Reynolds number is, relative to those of training runs."""
    if value in trained:
        return "trained"
    return "inside" if trained[0] < value < trained[-1] else "outside"


def main() -> None:
    """Run the models, and print the shares of errors below their estimates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/oscillation-estimates"))
    parser.add_argument("--train", action="store_true", help="train a model instead")
    parser.add_argument("--two-cylinders", action="store_true", help="run a refused wake instead")
    given = parser.parse_args()
    if given.two_cylinders:
        Study(CASE, set=TWO_CYLINDERS, out=given.out).run(until="operators")
        return
    if given.train:
        Study(CASE, set=CASE_CHANGES | TRAINING, out=given.out).run_stage("train")
        return
    study = Study(CASE, set=CASE_CHANGES, out=given.out)
    study.run(until="operators")
    workspace = Workspace(study._context)
    ratios = defaultdict[tuple[str, str], list[float]](list)
    for section, trained in zip(study.case.rom, TRAINED, strict=True):
        model = FastModel(workspace, section)
        for point in study.case.plan.points:
            run = model.run(point)
            with workspace.open(workspace.full_run(point)) as trajectory:
                full = measured_of(study.case, trajectory)
            found = oscillation_rows(
                study.case, run.time, run.measured, full, section.name, point.label,
                estimates={
                    name: {figure: np.array(error) for figure, error in each.items()}
                    for name, each in run.oscillation_errors.items()
                },
            )  # fmt: skip
            for row in found:
                for figure in ESTIMATED:
                    error, estimate = (
                        getattr(row, f"{figure}_{kind}") for kind in ("error", "estimated")
                    )
                    place = where(point.reynolds, trained)
                    ratios[place, figure].append(abs(error) / estimate)
    print("below the estimate, below twice, below a quarter [%]; error over estimate, 5 to 95 %")
    for (place, figure), found in ratios.items():
        values = np.array(found)
        shares = [100.0 * float(np.mean(values < limit)) for limit in (1.0, 2.0, 0.25)]
        low, high = np.quantile(values, (0.05, 0.95))
        words = "".join(f"{share:6.0f}" for share in shares)
        print(f"{place:8} {figure:10} {len(values):3d} errors {words}   {low:.2g} to {high:.2g}")


if __name__ == "__main__":
    main()
