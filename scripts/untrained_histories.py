"""Errors of an exported unit (FMU) whose driving has a history that was never trained.

    python scripts/untrained_histories.py FOLDER

trains `cases/gallery/cylinder.yaml` in a folder, exports its model, makes full runs with three
histories of the force, and prints the errors of the unit's outputs: root mean squares over those of
the outputs, without averaging sound out. It needs FMPy and a C compiler.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from fmpy import simulate_fmu

from sphrom.api.study import Study, load
from sphrom.artifacts import open_artifact
from sphrom.store.trajectory import measured_of

CASE = Path(__file__).parents[1] / "cases" / "gallery" / "cylinder.yaml"
FORCE, REYNOLDS = 0.2, 60.0
N_STEPS = 64
"""Communication steps between snapshots."""
HISTORIES = {
    "1 - exp(-t*t)": lambda t: 1 - np.exp(-t * t),
    "sin(2*t)": lambda t: np.sin(2 * t),
    "(1 - exp(-t*t))*(1 + 0.5*sin(3*t))": lambda t: (
        (1 - np.exp(-t * t)) * (1 + 0.5 * np.sin(3 * t))
    ),
}
"""The trained history, one about zero, and one about the trained one."""
OUTPUTS = {
    "flux_flow_rate": ("flux", "flow_rate", ()),
    "drag_force_x": ("drag", "force", (0,)),
    "wake_velocity_x": ("wake", "velocity", (0, 0)),
    "wake_pressure": ("wake", "pressure", (0,)),
}


def measured(folder: Path, history: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Run the full model; return its times [s] and outputs."""
    changes = {
        "scene.body_force": [f"{FORCE}*({history})", 0],
        "parameters": {"train": {"reynolds": [REYNOLDS]}},
        "rom": [],
    }
    study = Study(CASE, set=changes, out=folder, quiet=True)
    study.run(until="fom")
    target = folder / f"fom-reynolds{REYNOLDS:g}.h5"
    with open_artifact(target, "sphrom/trajectory", made_by="sphrom fom") as run:
        known = measured_of(study.case, run)
        time = run.read("time")
    return time, {o: known[n][q][:, *index] for o, (n, q, index) in OUTPUTS.items()}


def main(folder: Path) -> None:
    """Print the errors of the outputs by history."""
    study = Study(CASE, out=folder / "trained", quiet=True)
    study.run(until="operators")
    unit = folder / "model-fast.fmu"
    unit.unlink(missing_ok=True)
    study.run_stage("export", only=["fast"], to="fmu", into=folder)
    amplitude = load(folder / "trained" / "model-fast.h5")._reduced.amplitude
    scale = amplitude(np.array([5.0]))[0] / HISTORIES["1 - exp(-t*t)"](5.0)
    for number, (history, of_time) in enumerate(HISTORIES.items()):
        time, known = measured(folder / f"full-{number}", history)
        fine = np.linspace(time[0], time[-1], 2001)
        table = np.column_stack((fine, scale * of_time(fine)))
        signal = np.array(list(map(tuple, table)), dtype=[("time", float), ("driving", float)])
        for own in (0.0, 1.0) if number == 0 else (0.0,):
            found = simulate_fmu(
                str(unit),
                start_values={"reynolds": REYNOLDS, "own_driving": own},
                input=signal,
                start_time=time[0],
                stop_time=time[-1],
                # An input is constant within a communication step.
                output_interval=(time[1] - time[0]) / N_STEPS,
                output=list(OUTPUTS),
            )
            errors = []
            for output, values in known.items():
                missed = np.linalg.norm(found[output][::N_STEPS] - values)
                errors.append(f"{output} {100 * missed / np.linalg.norm(values):.2g} %")
            print(f"{history}, own_driving {own:g}: {', '.join(errors)}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
