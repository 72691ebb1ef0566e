"""The full model on the benchmark of a cylinder in a channel, DFG 2D-1 and 2D-2.

Runs `cases/cylinder_wake.yaml` at Reynolds number 20, where the flow is steady, or at 100, where
vortices are shed, and prints coefficients of drag and lift C = 2 F / (rho U^2 D), the Strouhal
number f D / U, the difference of pressure between the cylinder's front and back, and what crosses
the box, beside the ranges of Schaefer and Turek (1996). Of a flow that sheds, extremes are those of
the mean and four harmonics, fitted over whole periods: the particles' noise is in none of them.

    python scripts/wake.py steady --resolution 10 20
    python scripts/wake.py shedding
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np

from sphrom.api.study import Study
from sphrom.metrics.series import dominant_frequency

DIAMETER, SPEED = 0.1, 1.0
N_HARMONICS = 4
CASE = Path(__file__).parents[1] / "cases" / "cylinder_wake.yaml"
STEADY = {
    "C_D": "5.5795",
    "C_L": "0.0106",
    "pressure difference / (rho U^2)": "2.938",
}
SHEDDING = {
    "C_D max": "3.22 to 3.24",
    "C_L max": "0.99 to 1.01",
    "Strouhal number": "0.295 to 0.305",
}


def fitted(time: np.ndarray, values: np.ndarray, frequency: float) -> np.ndarray:
    """Return the mean and harmonics of a series, fitted over whole periods."""
    n_periods = int((time[-1] - time[0]) * frequency)
    late = time >= time[-1] - n_periods / frequency
    turns = 2.0 * np.pi * frequency * np.outer(time[late], np.arange(1, N_HARMONICS + 1))
    waves = np.hstack((np.ones((late.sum(), 1)), np.cos(turns), np.sin(turns)))
    return waves @ np.linalg.lstsq(waves, values[late])[0]


def figures(folder: Path, resolution: int, changes: dict[str, object]) -> dict[str, float]:
    """Run the full model, and return its figures over the later half of what is recorded."""
    study = Study(CASE, set={"discretization.resolution": resolution, **changes}, out=folder)
    study.run(until="fom")
    reynolds = study.case.plan.points[0].reynolds
    with h5py.File(study.folder / f"fom-reynolds{reynolds:g}.h5") as run:
        time = run["time"][()]
        force = sum(run[f"force/cylinder/{part}"][()] for part in ("pressure", "viscous"))
        front, back = (run[f"measure/{name}/pressure"][()][:, 0] for name in ("front", "back"))
        flux = run["measure/flux/flow_rate"][()]
    late = time >= 0.5 * (time[0] + time[-1]) if reynolds < 50.0 else time >= time[0]
    drag, lift = 2.0 * force[late].T / (SPEED**2 * DIAMETER)
    found = {"flow rate / wanted": float(flux[late].mean()) / (0.41 * SPEED)}
    if reynolds < 50.0:
        difference = float((front - back)[late].mean())
        means = (float(drag.mean()), float(lift.mean()), difference)
        return dict(zip(STEADY, means, strict=True)) | found
    frequency = dominant_frequency(time, lift)
    extremes = (float(fitted(time, each, frequency).max()) for each in (drag, lift))
    return dict(zip(SHEDDING, (*extremes, frequency * DIAMETER / SPEED), strict=True)) | found


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flow", choices=("steady", "shedding"))
    parser.add_argument("--resolution", type=int, nargs="+", default=[20])
    parser.add_argument("--out", type=Path, default=Path("runs/wake"))
    given = parser.parse_args()
    steady = given.flow == "steady"
    changes: dict[str, object] = {"rom": [], "parameters.test.reynolds": []}
    changes["parameters.train.reynolds"] = [20.0 if steady else 100.0]
    if steady:
        changes |= {"time.spin_up": 0.0, "time.final_time": 3.6}
    known = STEADY if steady else SHEDDING
    columns = [
        figures(given.out / f"{given.flow}-{each}", each, changes) for each in given.resolution
    ]
    print(f"{'D/dx':34}" + "".join(f"{each:>10}" for each in given.resolution) + "  literature")
    for name in columns[0]:
        values = "".join(f"{column[name]:10.4f}" for column in columns)
        print(f"{name:34}{values}  {known.get(name, '1')}")


if __name__ == "__main__":
    main()
