"""The onset of vortex shedding in full runs of a coarse wake, by rates of growth and decay.

Runs the wake of the gallery in a smaller box, with 8 particles per diameter. At the start a vortex
behind the cylinder disturbs the flow, so that oscillations are above the particles' noise. Prints
the amplitude of the transverse velocity behind the cylinder over time, and its rate of growth: the
trend of its logarithm over the time given. The rate is zero at the onset.

    python scripts/onset.py 50 60 --from-time 14 --to-time 56
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np

from sphrom.api.study import Study
from sphrom.metrics.series import demodulated, dominant_frequency

CASE = Path(__file__).parents[1] / "cases" / "gallery" / "wake.yaml"
AROUND = "max(x**2 + (y - 0.02)**2, 0.25)**2"
VORTEX = "exp(-(x - 2)**2 - y**2)"
CHANGES = {
    "scene.box": {"lower": [-4, -2.5], "upper": [7, 2.5], "periodic": ["x", "y"]},
    "scene.inflow.strip": {"from": -4, "to": -1.5},
    "scene.initial": {
        "u": f"1 - 0.25*(x**2 - (y - 0.02)**2)/{AROUND} - y*{VORTEX}",
        "v": f"-0.5*x*(y - 0.02)/{AROUND} + (x - 2)*{VORTEX}",
    },
    "scene.measure.far": {"probe": [4, 0]},
    "fluid.mach_number": 0.15,
    "discretization.resolution": 8,
    "time": {"step": 0.01875, "spin_up": 0.0, "final_time": 60.0},
    "snapshots.every": 16,
    "parameters": {"train": {"reynolds": [50]}},
    "rom": [],
}
"""Changes of the case: potential flow around the cylinder at the start, and a vortex."""
IGNORED = 8.0
"""Time of the start [s], in which the frequency is another one."""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reynolds", type=float, nargs="+")
    parser.add_argument("--from-time", type=float, default=14.0)
    parser.add_argument("--to-time", type=float, default=56.0)
    parser.add_argument("--out", type=Path, default=Path("runs/onset"))
    given = parser.parse_args()
    print(f"{'Re':>6}{'f [Hz]':>9}{'rate [1/s]':>12}  amplitude [m/s] every 6 s from 12 s on")
    for reynolds in given.reynolds:
        changes = CHANGES | {"parameters.train.reynolds": [reynolds]}
        study = Study(CASE, set=changes, out=given.out)
        study.run(until="fom")
        with h5py.File(study.folder / f"fom-reynolds{reynolds:g}.h5") as run:
            time = run["time"][()]
            across = run["measure/far/velocity"][()].reshape(len(time), 2)[:, 1]
        late = time > IGNORED
        frequency = dominant_frequency(time[late], across[late])
        instants, wave, _ = demodulated(time[late], across[late], frequency)
        some = (instants >= given.from_time) & (instants <= given.to_time)
        rate = np.polyfit(instants[some], np.log(np.abs(wave[some])), 1)[0]
        sizes = np.interp(np.arange(12.0, instants[-1], 6.0), instants, np.abs(wave))
        listed = " ".join(f"{size:.3f}" for size in sizes)
        print(f"{reynolds:6g}{frequency:9.4f}{rate:12.4f}  {listed}", flush=True)


if __name__ == "__main__":
    main()
