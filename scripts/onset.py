"""The onset of vortex shedding in full runs of a coarse wake, by rates of growth and decay.

Runs the wake of the gallery in a smaller box, with 8 particles per diameter. At the start a vortex
behind the cylinder disturbs the flow, so that oscillations are above the particles' noise. To the
amplitude r of the transverse velocity behind the cylinder, the equation of Stuart and Landau is
fitted, dr/dt = sigma r - l r^3, with one l for all runs. The onset is the zero of sigma, which is
linear in the viscosity between the two smallest Reynolds numbers.

    python scripts/onset.py 50 60 80
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np
from scipy.optimize import least_squares

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


def envelope(folder: Path, reynolds: float, probe: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Run the full model, and return instants, amplitudes there, and the frequency."""
    changes = CHANGES | {"parameters.train.reynolds": [reynolds]}
    study = Study(CASE, set=changes, out=folder)
    study.run(until="fom")
    with h5py.File(study.folder / f"fom-reynolds{reynolds:g}.h5") as run:
        time = run["time"][()]
        across = run[f"measure/{probe}/velocity"][()].reshape(len(time), 2)[:, 1]
    late = time > IGNORED
    frequency = dominant_frequency(time[late], across[late])
    instants, wave, _ = demodulated(time[late], across[late], frequency)
    return instants, np.abs(wave), frequency


def growth_rates(envelopes: list[tuple[np.ndarray, np.ndarray, float]]) -> np.ndarray:
    """Return sigma of each run [1/s], fitted with one l."""

    def missed(values: np.ndarray) -> np.ndarray:
        found = []
        for (instants, size, _), rate, first in zip(
            envelopes, values[1::2], values[2::2], strict=True
        ):
            grown = np.exp(2.0 * rate * (instants - instants[0]))
            square = np.exp(first)
            square *= grown / (1.0 + values[0] * square * (grown - 1.0) / rate)
            found.append(np.log(square) - 2.0 * np.log(size))
        return np.concatenate(found)

    start = [0.5]
    for _, size, _ in envelopes:
        start += [0.01, 2.0 * np.log(size[0])]
    return least_squares(missed, start).x[1::2]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reynolds", type=float, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("runs/onset"))
    given = parser.parse_args()
    values = sorted(given.reynolds)
    for probe in ("behind", "far"):
        envelopes = [envelope(given.out, reynolds, probe) for reynolds in values]
        rates = growth_rates(envelopes)
        print(f"{probe:>6}{'f [Hz]':>9}{'sigma [1/s]':>13}{'first':>8}{'last [m/s]':>12}")
        for reynolds, rate, (_, size, frequency) in zip(values, rates, envelopes, strict=True):
            print(f"{reynolds:6g}{frequency:9.4f}{rate:13.4f}{size[0]:8.3f}{size[-1]:12.3f}")
        if len(values) > 1:
            slope, constant = np.polyfit(1.0 / np.array(values[:2]), rates[:2], 1)
            print(f"onset: Re {-slope / constant:.1f}")


if __name__ == "__main__":
    main()
