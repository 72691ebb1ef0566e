"""Viscosity and lid speed from two probes: how near, how fast, and how often intervals hold.

A lid-driven cavity is learnt from six full runs at Re 50-200 and lid speeds from half of it up.
Two probes record full runs at nine other values, noise of 1 % of each history's range is added,
and both parameters are fitted to them. Told are the first fit's estimates and the time that it
took; then how many of the 95 % intervals hold the true values in fits to other draws of the noise,
with the model's own errors in the intervals and without, for data of full runs and for data of the
model itself, which has no errors.

    python scripts/bench_fit.py --resolution 30 --out /tmp/fit
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sphrom
from sphrom.case.studies import fit_ranges
from sphrom.fit.forward_model import FittedEquations, TrainingDifferences, box_of
from sphrom.fit.measurements import Measurements, read_measurements
from sphrom.metrics.estimation import Weights, minima, uncertainty
from sphrom.models.points.fast_model import FastModel
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
Columns = dict[str, Array]

PROBES = {"upper": [0.5, 0.85], "side": [0.8, 0.6]}
TRAIN = {"reynolds": [50, 100, 200], "lid": [0.5, 1.0]}
TEST = {"reynolds": [58, 101, 175], "lid": [0.55, 0.75, 0.95]}
FIRST = {"reynolds": 101.0, "lid": 0.75}
"""Where the first fit is."""
REPEATS = 5
"""Of the first fit, to time it."""


def case(resolution: int, final_time: float, n_modes: int) -> dict[str, Any]:
    """Return the content of the case."""
    return {
        "name": "fit",
        "scene": {
            "kind": "lid-driven-cavity",
            "measure": {name: {"probe": place} for name, place in PROBES.items()},
        },
        "discretization": {"resolution": resolution},
        "time": {"final_time": final_time},
        "snapshots": {"every": 3},
        "parameters": {"train": TRAIN, "test": TEST},
        "rom": [{"name": "fast", "evaluation": "operators", "n_modes": n_modes}],
        "compare": {"plots": False, "grid": 10},
    }


def recorded(study: sphrom.Study, point: dict[str, float]) -> Columns:
    """Return what the probes recorded in a full run, the start left out."""
    label = study.case.plan.point(point).file_label
    path = study.folder / f"fom-{label}.h5"
    found = {"time": sphrom.open(path).time.values[1:]}
    for name in PROBES:
        for axis in "xy":
            velocity = sphrom.open(path)[f"{name}_velocity"].sel(component=axis)
            found[f"{name}_velocity_{axis}"] = velocity.values[1:]
    return found


def noisy(columns: Columns, percent: float, seed: int) -> Columns:
    """Return measurements with noise, and with columns that say so."""
    rng = np.random.default_rng(seed)
    found = {"time": columns["time"]}
    for name, values in columns.items():
        if name != "time":
            deviation = np.full(len(values), 0.01 * percent * np.ptp(values))
            found[name] = values + deviation * rng.normal(size=len(values))
            found[f"{name}_noise"] = deviation
    return found


def first_fit(study: sphrom.Study, percent: float) -> None:
    """Fit one draw of the noise as a user does, and say what came out and how long it took."""
    model = study.model("fast", reynolds=100.0, lid=1.0)
    data = noisy(recorded(study, FIRST), percent, 0)
    began = time.perf_counter()
    found = model.fit(data)
    reading, seconds, of_processor = time.perf_counter() - began, [], []
    for _ in range(REPEATS):
        began, used = time.perf_counter(), time.process_time()
        model.fit(data)
        seconds.append(time.perf_counter() - began)
        of_processor.append(time.process_time() - used)
    for name, truth in FIRST.items():
        estimate = found[name]
        share = 100.0 / truth
        print(
            f"{name}: {estimate.value:.5g} (true {truth:g}), off by "
            f"{share * (estimate.value - truth):.2g} %, standard deviation "
            f"{share * estimate.standard_deviation:.2g} % (noise {share * estimate.by_noise:.2g}, "
            f"model {share * estimate.by_model:.2g}), 95 % from {estimate.low:.5g} to "
            f"{estimate.high:.5g}"
        )
    ratio = found.chi_square / found.degrees_of_freedom
    expected = found.expected_chi_square / found.degrees_of_freedom
    print(f"chi^2 per degree of freedom {ratio:.3g}, expected up to {expected:.3g}")
    print(
        f"{found.starts} starts: {reading:.2f} s with what is read first, then "
        f"{min(seconds):.2f} to {max(seconds):.2f} s, of which the processor worked "
        f"{min(of_processor):.2f} s; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )


class Coverage:
    """Fits to many draws of the noise, started at the truth."""

    def __init__(self, study: sphrom.Study) -> None:
        self._study = study
        self._workspace = Workspace(study._context)
        self._section = study.case.rom[0]
        self._fast = FastModel(self._workspace, self._section)
        self._box = box_of(fit_ranges(study.case, self._section), {})
        self._known: TrainingDifferences = {}

    def _measurements(self, columns: Columns) -> Measurements:
        plan = self._study.case.plan.model_steps(self._section)
        return read_measurements(columns, self._study.case, plan, None)

    def at(
        self, point: dict[str, float], percent: float, draws: int, of_model: bool
    ) -> tuple[Array, Array]:
        """Return the shares of intervals that hold (2, 2), and root mean squares of errors (2,).

        The first is without the model's errors, the second with them; of the Reynolds number and
        the lid's speed.
        """
        data = self._measurements(noisy(recorded(self._study, point), percent, 0))
        model = FittedEquations(self._fast, self._box, data.histories)
        truth = np.array([self._share(name, value) for name, value in point.items()])
        model.prepare([truth])
        rng = np.random.default_rng(1)
        clean = self._measurements(noisy(recorded(self._study, point), 1e-9 * percent, 0)).values
        if of_model:
            found = model(truth)
            assert found is not None
            clean = found[0]
        plain = Weights(data.noise, np.zeros((0, len(clean))))
        samples = model.error_samples(truth, self._known)
        assert samples is not None
        time = model.reduced(model.point(truth)).output_times.time
        whole = Weights(data.noise, np.stack([model.at_instants(time, s) for s in samples]))
        holds, squares = np.zeros((2, 2)), np.zeros(2)
        for _ in range(draws):
            values = clean + data.noise * rng.normal(size=len(clean))
            for k, weights in enumerate((plain, whole)):
                best = minima(model, values, weights, [truth])[0]
                known = uncertainty(best.derivatives, weights)
                holds[k] += np.abs(best.place - truth) <= known.half_width
            slopes = self._box.slopes(truth) / np.array(list(point.values()))
            squares += (slopes * (best.place - truth)) ** 2
        return holds / draws, np.sqrt(squares / draws)

    def _share(self, name: str, value: float) -> float:
        low, high = self._box.ranges[name]
        if name == "reynolds":
            return float(np.log(value / low) / np.log(high / low))
        return (value - low) / (high - low)


def coverages(study: sphrom.Study, draws: int) -> None:
    """Print how many intervals hold."""
    coverage = Coverage(study)
    grid = [{"reynolds": r, "lid": s} for r in TEST["reynolds"] for s in TEST["lid"]]
    print("share of 95 % intervals that hold [%], of the Reynolds number and the lid's speed")
    for what, points, percent, of_model in (
        ("the model's own data, noise 1 %", [FIRST], 1.0, True),
        ("a full run, noise 1 %", [FIRST], 1.0, False),
        ("a full run, noise 5 %", [FIRST], 5.0, False),
        ("nine full runs, noise 1 %", grid, 1.0, False),
        ("nine full runs, noise 5 %", grid, 5.0, False),
    ):
        began = time.perf_counter()
        number = draws if len(points) == 1 else max(1, draws // 10)
        found = [coverage.at(point, percent, number, of_model) for point in points]
        without, with_model = 100.0 * np.mean([holds for holds, _ in found], axis=0)
        off = 100.0 * np.sqrt(np.mean([errors**2 for _, errors in found], axis=0))
        n_fits = 2 * number * len(points)
        each = 1e3 * (time.perf_counter() - began) / n_fits
        print(
            f"{what}: noise alone {without[0]:.0f} and {without[1]:.0f}, with the model's errors "
            f"{with_model[0]:.0f} and {with_model[1]:.0f}; root mean square errors {off[0]:.2f} "
            f"and {off[1]:.2f} % ({number * len(points)} draws, {each:.0f} ms a fit)"
        )


def main() -> None:
    """Make the runs, fit one draw, and count intervals."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--resolution", type=int, default=30)
    parser.add_argument("--final-time", type=float, default=2.0)
    parser.add_argument("--modes", type=int, default=10)
    parser.add_argument("--noise", type=float, default=1.0, help="of the first fit [%%]")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("runs/bench-fit"))
    asked = parser.parse_args()
    content = case(asked.resolution, asked.final_time, asked.modes)
    study = sphrom.Study(content, out=asked.out, quiet=True)
    study.run(until="operators")
    first_fit(study, asked.noise)
    coverages(study, asked.draws)


if __name__ == "__main__":
    main()
