"""Models of a coarse wake beside full runs: amplitude and frequency of the lift over Re.

Two models are trained on the last 30 s of full runs of `scripts/onset.py`, one of them at Re 60,
80 and 120, the other without Re 60. They run for 210 s, of which the first 29 s do not count. The
pictures show the oscillation of models and full runs; where a model's estimates of the onset
differ, its line is dotted. The drag at some values is printed.

    python scripts/onset_models.py 50 60 80 120
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure
from onset import CASE, CHANGES
from small_picture import write_small

from sphrom.api.study import Study
from sphrom.metrics.series import oscillation

TRAINED = [60, 80, 120]
MODEL = {"n_modes": 20, "evaluation": "operators", "calibrated": "cycle", "until": 240.0}
CASE_CHANGES = CHANGES | {
    "time": {"step": 0.01875, "spin_up": 30.0, "final_time": 60.0},
    "scene.measure.shedding": {"frequency": {"of": "cylinder_force_y", "from_time": 59.0}},
    "basis.subsets": {"distant": {"reynolds": [80, 120]}},
    "rom": [
        {"name": "distant", "basis": "distant", **MODEL},
        {"name": "near", **MODEL},
    ],
}
LABELS = {"distant": "trained at Re 80 and 120", "near": "trained at Re 60, 80 and 120"}
FIGURES = {"frequency": "frequency of the lift [Hz]", "amplitude": "amplitude of the lift [N/m]"}
VALUES = np.linspace(30.0, 130.0, 101)
"""Reynolds numbers of the models' runs."""
N_LAST = 100
"""Last snapshots of a run, 30 s, over which the drag is averaged."""


def of_full_run(path: Path) -> dict[str, float]:
    """Return the oscillation of the lift in a full run."""
    with h5py.File(path) as run:
        load = run["force/cylinder"]
        return oscillation(run["time"][()], (load["pressure"][()] + load["viscous"][()])[:, 1])


def main() -> None:
    """Run the models, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reynolds", type=float, nargs="+", help="values of full runs")
    parser.add_argument("--out", type=Path, default=Path("runs/onset-models"))
    parser.add_argument("--picture", type=Path, default=Path("onset-models.png"))
    given = parser.parse_args()
    tested = [value for value in given.reynolds if value not in TRAINED]
    points = {"train": {"reynolds": TRAINED}, "test": {"reynolds": tested}}
    study = Study(CASE, set=CASE_CHANGES | {"parameters": points}, out=given.out)
    study.run(until="operators")
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = dict(zip(FIGURES, figure.subplots(1, len(FIGURES)), strict=True))
    for colour, (name, label) in enumerate(LABELS.items()):
        runs = study.model(name, reynolds=100.0).run_many({"reynolds": VALUES})
        told = runs.regime.values != "undecided"
        for quantity, panel in panels.items():
            found = runs[f"shedding_{quantity}"].values
            line = {"color": f"C{colour}"}
            panel.plot(VALUES, np.where(told, found, np.nan), **line, label=label)
            panel.plot(VALUES, np.where(told, np.nan, found), ":", **line)
        drag = runs.cylinder_force.values[:, -N_LAST:, 0].mean(axis=1)
        for row in (VALUES % 10.0 == 0.0).nonzero()[0]:
            print(
                f"{label}, Re {VALUES[row]:g}: {runs.regime.values[row]}, drag {drag[row]:.3f} N/m"
            )
    full = [of_full_run(study.folder / f"fom-reynolds{value:g}.h5") for value in given.reynolds]
    for quantity, panel in panels.items():
        panel.plot(given.reynolds, [each[quantity] for each in full], "ko", label="full runs")
        panel.set(xlabel="Reynolds number", ylabel=FIGURES[quantity])
    panels["amplitude"].legend()
    figure.savefig(given.out / "onset.png", dpi=150)
    write_small(given.out / "onset.png", given.picture, 900)


if __name__ == "__main__":
    main()
