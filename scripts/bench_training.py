"""What `sphrom train` promises beside the truth, and its choice of runs beside equal spacing.

For three flows, several tolerances and seeds, it trains a model, and compares it with full runs on
a dense grid that it has not seen. Then models of as many full runs at equal spacing, in Re, log Re
and 1/Re, are compared with the same runs. Full runs are kept in the folder: a second call makes
none.

    python scripts/bench_training.py --out /tmp/training

Prints the tables of docs/training.md, and writes training.json with all figures.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import sphrom
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Region, fast_section, trained_at
from sphrom.console import SilentReporter
from sphrom.setup.context import StageContext
from sphrom.store.variants import Variant
from sphrom.train.surrogate import StageModel, make_full_runs

VELOCITY = 0
BUDGET = 9


@dataclass(frozen=True)
class Flow:
    """A flow, its region, and the settings that it is trained in."""

    scene: str
    resolution: int
    final_time: float
    region: dict[str, list[float]]
    tolerances: tuple[str, ...]
    dense: tuple[int, ...]
    """Full runs along each parameter that models are compared with."""
    modes: int = 10
    """Of the model."""

    def content(self, name: str, seed: int = 0) -> dict[str, Any]:
        """Return the case."""
        return {
            "name": name,
            "scene": {"kind": self.scene},
            "discretization": {"resolution": self.resolution},
            "time": {"final_time": self.final_time},
            "snapshots": {"every": 2},
            # The low end: points whose runs are there count as well, so none may be elsewhere.
            "parameters": {"train": {"reynolds": self.region["reynolds"][:1]}},
            "rom": [{"name": "fast", "evaluation": "operators", "n_modes": self.modes}],
            "compare": {"plots": False},
            "training": {**self.region, "budget": BUDGET, "seed": seed},
        }


FLOWS = {
    "taylor-green": Flow(
        "taylor-green", 25, 1.0, {"reynolds": [50, 1000]}, ("1%", "0.7%", "0.5%"), (24,)
    ),
    "cavity": Flow(
        "lid-driven-cavity", 20, 2.0, {"reynolds": [50, 400]}, ("6%", "5%", "4%"), (24,)
    ),
    "cavity-two": Flow(
        "lid-driven-cavity",
        20,
        2.0,
        {"reynolds": [50, 200], "lid": [0.5, 1.0]},
        ("4%", "3.5%", "3%"),
        (5, 5),
    ),
}
SPACINGS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "Re": (lambda v: v, lambda v: v),
    "log Re": (np.log, np.exp),
    "1/Re": (lambda v: 1.0 / v, lambda v: 1.0 / v),
}


class Bench:
    """One flow: its full runs, and models compared with them."""

    def __init__(self, name: str, flow: Flow, out: Path) -> None:
        self.flow, self.name, self.folder = flow, name, out / name
        self.case = sphrom.Study(flow.content(name), out=self.folder, quiet=True).case
        self.region = Region(self.case)
        self.context = StageContext(
            self.case, self.folder, False, 1, SilentReporter(), resume=True, bitwise=True
        )
        self.dense = [*self._grid("log Re", flow.dense, inner=True)]
        self.full_runs(self.dense)
        self._known: dict[tuple[ParameterPoint, ...], np.ndarray] = {}

    def full_runs(self, points: Sequence[ParameterPoint]) -> None:
        """Make the full runs that are not there."""
        corners = self.region.starts(())
        every = tuple(dict.fromkeys((*corners, *points)))
        variant = Variant(self.context, trained_at(self.case, every))
        if failed := make_full_runs(variant, points, 1, None):
            raise SystemExit(f"{self.name}: unstable full runs: {failed}")

    def _grid(
        self, spacing: str, counts: Sequence[int], inner: bool = False
    ) -> Iterator[ParameterPoint]:
        """Yield points of equal spacing: with the ends, or in the middles of as many parts."""
        axes = []
        for (name, (low, high)), count in zip(self.flow.region.items(), counts, strict=True):
            there, back = SPACINGS[spacing if name == "reynolds" else "Re"]
            shares = (np.arange(count) + 0.5) / count if inner else np.linspace(0.0, 1.0, count)
            found = back(there(low) + shares * (there(high) - there(low)))
            axes.append([float(f"{v:.4g}") for v in found])
        for values in product(*axes):
            named = dict(zip(self.flow.region, values, strict=True))
            others = tuple((n, named[n]) for n in self.region.names[1:])
            yield ParameterPoint(named["reynolds"], others)

    def errors(self, points: Sequence[ParameterPoint]) -> np.ndarray:
        """Return the true errors of velocity [%] of a model of some full runs, on the grid."""
        key = tuple(points)
        if key not in self._known:
            model = fast_section(self.case, self.case.training.model)
            assert model is not None
            stage = StageModel(self.context, model, points)
            found = [stage.compared(p)[0][VELOCITY] for p in self.dense if p not in key]
            self._known[key] = np.array(found)
        return self._known[key]

    def spaced(self, spacing: str) -> dict[int, float]:
        """Return the worst true error by the number of full runs at equal spacing."""
        if len(self.flow.region) == 1:
            shapes: list[tuple[int, ...]] = [(n,) for n in range(2, BUDGET + 1)]
        else:
            shapes = [(2, 2), (3, 2), (2, 3), (4, 2), (3, 3)]
        found: dict[int, float] = {}
        for shape in shapes:
            points = list(self._grid(spacing, shape))
            self.full_runs(points)
            n = len(points)
            found[n] = min(found.get(n, np.inf), float(self.errors(points).max()))
        return found

    def trained(self, seed: int) -> list[dict[str, Any]]:
        """Train at every tolerance, and return promise and truth."""
        shutil.rmtree(self.folder / "training", ignore_errors=True)
        rows = []
        for tolerance in self.flow.tolerances:
            content = self.flow.content(self.name, seed)
            study = sphrom.Study(content, out=self.folder, threads=1, report=lambda text: None)
            study.run_stage("train", tolerance=tolerance, workers=1)
            found = json.loads((self.folder / "training" / "training.json").read_text())
            stages, about = found["stages"], found["about"]
            points = [self.case_point(values) for values in about["trained"]]
            errors = self.errors(points)
            rows.append(
                {
                    "flow": self.name,
                    "tolerance": float(tolerance.rstrip("%")),
                    "seed": seed,
                    "ending": about["ending"],
                    "runs": len(points),
                    "promised": stages[-1]["worst_estimate"],
                    "factor": stages[-1]["factor"],
                    "floor": stages[-1]["floor"],
                    "true": float(errors.max()),
                    "stages": stages,
                    "trained": about["trained"],
                }
            )
        return rows

    def case_point(self, values: dict[str, float]) -> ParameterPoint:
        """Return the point of values by name."""
        others = tuple((name, values[name]) for name in self.region.names[1:])
        return ParameterPoint(values["reynolds"], others)

    def path(self, row: dict[str, Any]) -> dict[int, float]:
        """Return the worst true error by the number of full runs that training chose."""
        points = [self.case_point(values) for values in row["trained"]]
        first = min(stage["full_runs"] for stage in row["stages"])
        return {n: float(self.errors(points[:n]).max()) for n in range(first, len(points) + 1)}


def least(errors: dict[int, float], error: float) -> int | None:
    """Return the fewest runs whose worst error is no larger."""
    return min((n for n, found in errors.items() if found <= error), default=None)


def kept(row: dict[str, Any]) -> str:
    """Return what became of a promise, in words."""
    if row["ending"] != "within":
        return f"none ({row['ending']})"
    return "kept" if row["true"] <= row["tolerance"] else "broken"


def show_promises(rows: Sequence[dict[str, Any]]) -> None:
    """Print the promises of all settings, as a table in Markdown."""
    print("| flow | tolerance | seed | full runs | promised | true | promised / true | promise |")
    print("| --- | --: | --: | --: | --: | --: | --: | --- |")
    for row in rows:
        ratio = row["promised"] / row["true"]
        print(
            f"| {row['flow']} | {row['tolerance']:g} % | {row['seed']} | {row['runs']} | "
            f"{row['promised']:.2f} % | {row['true']:.2f} % | {ratio:.2f} | {kept(row)} |"
        )
    given = [row for row in rows if row["ending"] == "within"]
    good = sum(kept(row) == "kept" for row in given)
    ratios = [row["promised"] / row["true"] for row in given]
    within = sum(0.5 <= ratio <= 2.0 for ratio in ratios)
    print(
        f"\n{good} of {len(given)} promises kept, in {len(rows)} settings; promised over true from "
        f"{min(ratios):.2f} to {max(ratios):.2f}, {within} within 0.5 to 2\n"
    )


def show_spacing(name: str, spaced: dict[str, dict[int, float]], paths: list[Any]) -> None:
    """Print the worst true errors by number of runs, and the runs that training saves."""
    numbers = sorted({n for found in (*spaced.values(), *paths) for n in found})
    print(f"| {name}: full runs | " + " | ".join(map(str, numbers)) + " |")
    print("| --- |" + " --: |" * len(numbers))
    for label, found in [
        *((f"trained, seed {k}", path) for k, path in enumerate(paths)),
        *((f"equal spacing in {s}", found) for s, found in spaced.items()),
    ]:
        cells = (f"{found[n]:.2f} %" if n in found else "" for n in numbers)
        print(f"| {label} | " + " | ".join(cells) + " |")
    for spacing, found in spaced.items():
        saved = []
        for path in paths:
            for n, error in path.items():
                m = least(found, error)
                saved.append(f"{n} for {f'more than {max(found)}' if m is None else m}")
        print(f"\nRuns for those at equal spacing in {spacing}, at equal error: {', '.join(saved)}")
    print()


def main() -> None:
    """Train, compare, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/bench-training"))
    parser.add_argument("--flows", nargs="*", default=list(FLOWS), choices=list(FLOWS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--modes", type=int, default=10)
    parser.add_argument("--tolerances", nargs="*", help="in place of those of each flow")
    asked = parser.parse_args()
    rows, spacings = [], {}
    for name in asked.flows:
        flow = replace(FLOWS[name], modes=asked.modes)
        if asked.tolerances:
            flow = replace(flow, tolerances=tuple(asked.tolerances))
        bench = Bench(name, flow, asked.out)
        trained = [bench.trained(seed) for seed in range(asked.seeds)]
        spaced = {spacing: bench.spaced(spacing) for spacing in SPACINGS}
        paths = [bench.path(found[-1]) for found in trained]
        rows += [row for found in trained for row in found]
        spacings[name] = {"spaced": spaced, "trained": paths}
        show_spacing(name, spaced, paths)
    show_promises(rows)
    content = json.dumps({"settings": rows, "spacing": spacings}, indent=1)
    (asked.out / "training.json").write_text(content + "\n")


if __name__ == "__main__":
    main()
