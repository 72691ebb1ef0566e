"""Estimated beside true errors, inside and outside of what reduced models were trained on.

Runs a case at more parameter values through the command line, prints estimate and error of every
model on the reference points side by side, and writes them as JSON. With `--beyond 2` every run
goes on for twice the trained time, which the full runs then do in a case of their own. A table
has the shares of true errors below one and two times their estimates: of the fields, and of each
component of all measurements.

    python scripts/estimates.py cases/taylor_green_demo.yaml --inside 105 125 150 175 195 \
        --outside 50 70 300 400

Without a case it takes the scenes of the gallery and of `bench_rivals.py`, coarser and shorter
than there, with models of 5, 10 and 20 modes and as many as training runs choose. Test values
lie at three places between the trained ones, and at one on either side of them.

    python scripts/estimates.py --beyond 2 --out runs/estimates
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bench_rivals import SCENES

from sphrom.arrays import Mask
from sphrom.case.loader import load_case
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.console import SilentReporter
from sphrom.metrics.histories import effectivity
from sphrom.metrics.measures import Quantities, mean_squares, since, variations
from sphrom.metrics.quantities import component_names
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import TimeSteps
from sphrom.store.stored_run import probes_of, sample_run
from sphrom.store.trajectory import measured_of
from sphrom.store.workspace import Workspace

Row = dict[str, Any]
FIELDS = ("velocity", "pressure")
INSIDE_FACTOR = 2.0
OUTSIDE_FACTORS = (0.5, 4.0)
"""What an estimate over the error is to be within, inside and outside of training."""
TOO_LARGE = 4.0
"""An estimate over the error from which it is useless."""
GALLERY = Path(__file__).parents[1] / "cases" / "gallery"
COARSE = {
    "cavity_with_fin": (34, 3.0), "cylinder": (8, 5.0), "cylinder_array": (24, 1.0),
    "eccentric_cylinder": (23, 2.0), "kolmogorov": (16, 15.0), "l_shaped_cavity": (28, 3.0),
    "taylor_couette": (12, 3.0),
}  # fmt: skip
"""Resolution and final time [s] of scenes of the gallery: coarser and shorter than there."""
MEASURE: dict[str, dict[str, Any]] = {
    "taylor-green": {
        "here": {"probe": [0.3, 0.15]}, "there": {"probe": [0.6, 0.85]},
        "flux": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1]}},
    },
    "lid-driven-cavity": {
        "lid": {"force_on": "top"}, "low": {"probe": [0.5, 0.2]}, "side": {"probe": [0.8, 0.5]},
        "flux": {"flow_rate": {"from": [0.5, 0], "to": [0.5, 0.5]}},
    },
    "two-cylinders": {
        "first": {"force_on": "first"}, "second": {"force_on": "second"},
        "gap": {"probe": [2.8, 3.2]}, "wake": {"probe": [2.8, 2.0]},
        "flux": {"flow_rate": {"from": [5.5, 0], "to": [5.5, 4]}},
    },
    "cavity-with-disc": {
        "disc": {"force_on": "disc"}, "low": {"probe": [0.5, 0.15]}, "side": {"probe": [0.8, 0.5]},
        "flux": {"flow_rate": {"from": [0.45, 0], "to": [0.45, 0.3]}},
    },
    "cavity_with_fin": {
        "fin": {"force_on": "fin"}, "lid": {"force_on": "top"},
        "left": {"probe": [0.2, 0.5]}, "right": {"probe": [0.8, 0.6]},
        "flux": {"flow_rate": {"from": [0.5, 0.6], "to": [0.5, 1]}},
    },
    "cylinder_array": {
        "drag": {"force_on": "cylinder"},
        "gap": {"probe": [0.1, 0.1]}, "above": {"probe": [0.5, 0.9]},
        "flux": {"flow_rate": {"from": [0, 0], "to": [0, 1]}},
    },
    "eccentric_cylinder": {
        "inner": {"force_on": "inner"},
        "wide": {"probe": [-0.6, 0]}, "narrow": {"probe": [0.8, 0]},
        "flux": {"flow_rate": {"from": [0.7, 0], "to": [1, 0]}},
    },
    "kolmogorov": {
        "here": {"probe": [3, 2]}, "there": {"probe": [9, 4.5]},
        "flux": {"flow_rate": {"from": [6, 0], "to": [6, 3]}},
    },
    "l_shaped_cavity": {
        "step": {"force_on": "step"}, "lid": {"force_on": "top"},
        "left": {"probe": [0.25, 0.25]}, "right": {"probe": [0.75, 0.75]},
        "flux": {"flow_rate": {"from": [0.5, 0.75], "to": [0.5, 1]}},
    },
    "taylor_couette": {
        "inner": {"force_on": "inner"}, "gap": {"probe": [0.75, 0]},
        "flux": {"flow_rate": {"from": [0.5, 0], "to": [1, 0]}},
    },
}  # fmt: skip
"""Measurements of the scenes that have none."""
INSIDE, OUTSIDE = (0.25, 0.45, 0.75), (0.65, 1.4)
"""Test values: places between the trained ones on a logarithmic scale; shares of the outer ones."""


def scenes() -> dict[str, dict[str, Any]]:
    """Return the content of a case for each scene that is run without a case."""
    found = {n: {"scene": {"kind": n}, **s} for n, s in SCENES.items() if n != "two-parameters"}
    for name, (resolution, final_time) in COARSE.items():
        found[name] = yaml.safe_load((GALLERY / f"{name}.yaml").read_text())
        found[name] |= {"discretization": {"resolution": resolution}, "snapshots": {"every": 5}}
        found[name]["time"] = {"final_time": final_time}
    fast = {"evaluation": "operators"}
    for name, content in found.items():
        content |= {"name": name, "basis": {"n_modes": 20}}
        content["scene"] = {"measure": MEASURE.get(name, {}), **content["scene"]}
        content["rom"] = [{"name": f"m{n}", **fast, "n_modes": n} for n in (5, 10, 20, "auto")]
        content.pop("compare", None)
    return found


def around(trained: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return test values inside and outside of trained ones."""
    low, high = min(trained), max(trained)
    inside = [low * (high / low) ** place for place in INSIDE]
    outside = [low * OUTSIDE[0], high * OUTSIDE[1]]
    return tuple([float(f"{v:.3g}") for v in values] for values in (inside, outside))


def sphrom(command: str, case: Path, out: Path, settings: dict[str, object]) -> Case:
    """Run a command of a case with keys changed; return the case."""
    words = [f"{key}={value}" for key, value in settings.items()]
    call = [sys.executable, "-m", "sphrom", command, str(case), "--out", str(out), "--quiet"]
    subprocess.run(
        [*call, *(word for each in words for word in ("--set", each))],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return load_case(case, words)


def compared(out: Path) -> list[Row]:
    """Return the estimates that `compare` found, with those of measurements."""
    found = json.loads((out / "compare.json").read_text())
    rows = {(row["compared"], row["parameters"]): row for row in found["estimates"]}
    for each in found["measures"]:
        row = rows.get((each["compared"], each["parameters"]))
        if row is not None and each["estimated"] and each["relative_l2"]:
            name = f"{each['measured']}_{each['quantity']}"
            row.setdefault("measured", {})[name] = {
                "quantity": each["quantity"],
                "estimate": each["estimated"],
                "error": each["relative_l2"],
            }
    return list(rows.values())


def beyond(case: Case, out: Path, long: Case, long_out: Path) -> list[Row]:
    """Run models beyond the trained time, and compare estimates with errors."""
    workspace = Workspace(StageContext(case, out, False, 1, SilentReporter()))
    truth = Workspace(StageContext(long, long_out, False, 1, SilentReporter()))
    plan = replace(case.plan.steps, n_steps=long.plan.steps.n_steps)
    return [
        {"compared": model.name, "parameters": point.label, "role": "beyond", **figures}
        for model in case.rom
        if model.from_operators
        for point in long.plan.points
        if (figures := run_beyond(workspace, truth, model, point, plan)) is not None
    ]


def run_beyond(
    workspace: Workspace,
    truth: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    plan: TimeSteps,
) -> Row | None:
    """Run one model beyond the trained time; return the figures of the later part."""
    case, probes = truth.case, probes_of(truth.case)
    fast = FastModel(workspace, model)
    reduced = fast.at(point)
    longer = replace(reduced.output_times, n_snapshots=plan.n_snapshots)
    run = fast.run(point, replace(reduced, output_times=longer))
    if run.estimate is None:
        return None
    estimates = np.stack((run.estimate.velocity, run.estimate.pressure), axis=1)
    samples = run.sampled(probes.all)
    with truth.open(truth.full_run(point)) as trajectory:
        full = sample_run(case, trajectory, probes.all)
        recorded = measured_of(case, trajectory)
    trained_until = workspace.case.plan.steps.end_time
    figures = effectivity(estimates, samples, full, probes, trained_until, trained_until)
    if figures is None:
        return None
    late = since(run.time, trained_until)
    return {**figures, "measured": of_measurements(run, recorded, late)}


def of_measurements(run: FastRun, full: Mapping[str, Quantities], late: Mask) -> dict[str, Row]:
    """Return estimates and errors of a run's measurements at late times, over their changes [%]."""
    found = {}
    for name, errors in run.measured_errors.items():
        for quantity in errors.keys() & full[name].keys():
            whole = full[name][quantity][late]
            sizes = variations(quantity, whole)
            missed = mean_squares(quantity, run.measured[name][quantity][late] - whole)
            expected = mean_squares(quantity, errors[quantity][late])
            for each in component_names(quantity):
                if sizes[each] > 0.0 and missed[each] > 0.0:
                    error, estimate = (
                        100.0 * (squares[each] / sizes[each]) ** 0.5
                        for squares in (missed, expected)
                    )
                    row = {"quantity": each, "estimate": estimate, "error": error}
                    found[f"{name}_{each}"] = row
    return found


def show(rows: Sequence[Row]) -> None:
    """Print a line a run, and how many are within the factors."""
    print(
        "model            parameters         role           velocity: estimate  error  ratio"
        "   pressure: estimate  error  ratio"
    )
    for row in rows:
        cells = "".join(
            f"{row[f'{f}_estimate']:18.3g}{row[f'{f}_error']:8.3g}{ratio(row, f):7.2f}   "
            for f in FIELDS
        )
        print(f"{row['compared']:16} {row['parameters']:18} {row['role']:12}{cells}")
    for name in dict.fromkeys(row["compared"] for row in rows):
        for role in dict.fromkeys(row["role"] for row in rows):
            some = [row for row in rows if (row["compared"], row["role"]) == (name, role)]
            for field in FIELDS if some else ():
                print(f"{name}, {role}, {field}: {verdict(some, role, field)}")


def ratio(row: Row, field: str) -> float:
    """Return estimate over error."""
    return float(row[f"{field}_estimate"] / row[f"{field}_error"])


def verdict(rows: Sequence[Row], role: str, field: str) -> str:
    """Say how many ratios are within what they should be."""
    least, most = 1.0 / INSIDE_FACTOR, INSIDE_FACTOR
    if role in ("extrapolated", "beyond"):
        least, most = OUTSIDE_FACTORS
    ratios = [ratio(row, field) for row in rows]
    within = sum(least <= each <= most for each in ratios)
    return (
        f"{within} of {len(ratios)} within {least:g} to {most:g}, "
        f"from {min(ratios):.2f} to {max(ratios):.2f}"
    )


def ratios(rows: Sequence[Row], role: str) -> dict[str, list[float]]:
    """Return errors over estimates, by field and by component of measurements."""
    found: dict[str, list[float]] = {}
    for row in rows:
        if row["role"] != role:
            continue
        for field in FIELDS:
            found.setdefault(field, []).append(1.0 / ratio(row, field))
        for each in row.get("measured", {}).values():
            name = f"measured {each['quantity'].replace('_', ' ')}"
            found.setdefault(name, []).append(each["error"] / each["estimate"])
    return found


def shares(rows: Sequence[Row]) -> str:
    """Return a Markdown table of how many true errors are below one and two times the estimate.

    Estimates above `TOO_LARGE` times the error are counted too.
    """
    parts = [
        "| | quantity | runs | below the estimate | below twice | below a quarter "
        "| error over estimate, 5 to 95 % |",
        "|---|---|---|---|---|---|---|",
    ]
    for role in dict.fromkeys(row["role"] for row in rows if row["role"] != "trained"):
        for name, values in sorted(ratios(rows, role).items()):
            found = np.array(values)
            low, high = np.quantile(found, [0.05, 0.95])
            below = (f"{100.0 * np.mean(found < n):.0f} %" for n in (1.0, 2.0, 1.0 / TOO_LARGE))
            cells = role, name, str(len(found)), *below, f"{low:.2g} to {high:.2g}"
            parts.append("| " + " | ".join(cells) + " |")
    return "\n".join(parts)


def measured(
    path: Path, out: Path, values: Sequence[float], settings: dict[str, object], times: float
) -> list[Row]:
    """Run a case at test values, and for so many times the trained time; return the figures."""
    settings = {**settings, "parameters.test.reynolds": list(values), "compare.plots": "false"}
    case = sphrom("run", path, out, settings)
    rows = compared(out)
    if times > 1.0:
        plan = case.plan.steps
        settings["time.step"] = repr(plan.time_step)
        settings["time.final_time"] = plan.start_time + times * (plan.end_time - plan.start_time)
        long_out = out.with_name(f"{out.name}-beyond")
        rows += beyond(case, out, sphrom("fom", path, long_out, settings), long_out)
    show(rows)
    return rows


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=Path, nargs="?")
    parser.add_argument("--inside", type=float, nargs="*", default=[])
    parser.add_argument("--outside", type=float, nargs="*", default=[])
    parser.add_argument("--beyond", type=float, default=1.0, help="times the trained time")
    parser.add_argument("--scenes", nargs="+", default=[], help="some of those without a case")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=None)
    arguments = parser.parse_args()
    settings: dict[str, object] = dict(each.split("=", 1) for each in arguments.set)
    if arguments.case is not None:
        out = arguments.out or Path("runs") / f"estimates-{arguments.case.stem}"
        values = [*arguments.inside, *arguments.outside]
        rows = measured(arguments.case, out, values, settings, arguments.beyond)
    else:
        out, rows = arguments.out or Path("runs/estimates"), []
        for name, content in scenes().items():
            if arguments.scenes and name not in arguments.scenes:
                continue
            path = out / f"{name}.yaml"
            path.parent.mkdir(parents=True, exist_ok=True)
            inside, outside = around(content["parameters"]["train"]["reynolds"])
            path.write_text(yaml.safe_dump(content))
            found = measured(path, out / name, inside + outside, settings, arguments.beyond)
            rows += [{"scene": name, **row} for row in found]
    print(shares(rows))
    (out / "estimates.json").write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
