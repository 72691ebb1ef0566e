"""What reduced models cost beside the full one, on both roads, measured in one run.

Trains on a short Taylor-Green vortex at each resolution, then times in this process: steps of the
full model, the online loop of models on the reference points over one second, and steps of models
on moving particles. They take turns on one thread, and the least processor time counts. Whole
`sphrom rom` commands are timed apart. Prints tables and writes JSON. Artifacts are kept in
--folder, where a second run finds them.

    python scripts/bench_reduced.py --resolutions 50 100 200 --modes 2 5 10 20
    python scripts/bench_reduced.py --resolutions 32 --modes 2 5 --repeats 5   # seconds
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from sphrom.case.loader import load_case
from sphrom.case.model_sections import PointModelSection
from sphrom.case.models import Case
from sphrom.compare.costs import full_run_timer, largest_step, taking_turns
from sphrom.console import SilentReporter
from sphrom.kernels.jit import set_threads
from sphrom.machine import one_blas_thread, seconds_of
from sphrom.models.contract import model_of
from sphrom.models.points.fast_model import FastModel
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.reference_model import Integrator, ReferenceModel, automatic
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

DURATION = 1.0
"""Of the runs that are compared [s]."""
N_SNAPSHOTS = 201
"""Of those runs: every 5 ms, the paper's times."""
N_TRAINING_SNAPSHOTS = 100
"""To learn from, about, if there are as many steps."""
CASE_STEP = 0.125
"""The step of the published runs over the spacing [s/m]: 1.25 ms at 100 x 100."""
TRAIN = ("fom", "map", "pod", "fit-psi", "operators")

Row = dict[str, Any]


def sphrom(stage: str, case: Path, *options: str) -> float:
    """Run a stage and return what the whole command took [s]."""
    command = [sys.executable, "-m", "sphrom", stage, str(case), "--out", str(case.parent)]
    started = time.perf_counter()
    subprocess.run([*command, "--quiet", *options], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def prepare(
    resolution: int, modes: list[int], training_time: float, folder: Path, splines: str
) -> Path:
    """Write a case and train on it; return the case's path."""
    models = [
        {"name": "fast", "evaluation": "operators", "n_modes": max(modes), "calibrated": True},
        {"name": "galerkin", "n_modes": min(5, max(modes))},
        {"name": "apg", "n_modes": min(5, max(modes)), "projection": "apg"},
    ]
    case: Row = {
        "name": f"bench-{resolution}",
        "scene": {"kind": "taylor-green"},
        "discretization": {"resolution": resolution, "smoothing_length_ratio": 4.0},
        "time": {"final_time": training_time},
        "snapshots": {"every": 1},
        "basis": {"n_modes": max(modes)},
        "rom": models,
    }
    if splines == "b-spline":
        case |= {"reference": {"points": "lattice"}, "psi": {"kind": splines}}
    n_steps = Case.model_validate(case).plan.steps.n_steps
    case["snapshots"] = {"every": max(1, n_steps // N_TRAINING_SNAPSHOTS)}
    kind = "" if splines == "polyharmonic" else f"-{splines}"
    path = folder / f"{resolution}-{max(modes)}-{training_time:g}{kind}" / "case.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    for stage in TRAIN:
        sphrom(stage, path)
    return path


def timers(
    workspace: Workspace, modes: list[int], faithful: bool
) -> dict[str | int, Callable[[], float]]:
    """Return what times full runs, models on the reference points, and runs on particles."""
    case = workspace.case
    (point,) = case.plan.train_points
    step = case.plan.steps.time_step
    found: dict[str | int, Callable[[], float]] = {"full": full_run_timer(workspace, point, step)}
    for n_modes in modes:
        found[n_modes] = partial(seconds_of, integrator_of(workspace, n_modes)[1].run)
    for model in case.rom if faithful else ():
        if not model.from_operators:
            found[model.projection] = model_of(workspace, model).timer(point, step)
    return found


def integrator_of(workspace: Workspace, n_modes: int) -> tuple[ReferenceModel, Integrator]:
    """Return a model on the reference points, and what integrates it over the runs' duration."""
    (point,) = workspace.case.plan.train_points
    section = PointModelSection(
        name="fast", evaluation="operators", n_modes=n_modes, calibrated=True
    )
    reduced = FastModel(workspace, section).at(point)
    interval, largest = DURATION / (N_SNAPSHOTS - 1), reduced.output_times.largest_norm
    if reduced.linear is None:
        raise SystemExit("a model without training states")
    output_times = OutputTimes(interval, N_SNAPSHOTS, largest_norm=largest)
    integrator = automatic(replace(reduced, output_times=output_times, amplitude=None))
    if not np.isnan(integrator.run().diverged_at):
        raise SystemExit(f"M = {n_modes}: the run diverged")
    return reduced, integrator


def full_row(case: Case, seconds: float) -> Row:
    """Return what a run of the full model takes at several steps, from one step [s]."""
    automatic = case.plan.steps.time_step
    own = CASE_STEP * case.plan.particle_spacing
    courant = {"time_step_auto": automatic, "time_step_case": own}
    courant["time_step_largest"] = largest_step(case)
    runs = {
        name.replace("time_step", "run"): DURATION / dt * seconds for name, dt in courant.items()
    }
    return {"resolution": case.discretization.resolution, "step": seconds, **courant, **runs}


def fast_row(workspace: Workspace, n_modes: int, loop: float, full: Row) -> Row:
    """Return the online loop of a model on the reference points beside full runs."""
    reduced, integrator = integrator_of(workspace, n_modes)
    return {
        "resolution": full["resolution"],
        "n_modes": n_modes,
        "n_steps": integrator.steps.n_steps,
        "limit": reduced.step_limit,
        "loop": loop,
        **{f"speed_up_{at}": full[f"run_{at}"] / loop for at in ("case", "auto", "largest")},
    }


def commands(path: Path, n_modes: int) -> Row:
    """Time whole `rom` commands, once the first has compiled."""
    model = f"{{name: fast, evaluation: operators, calibrated: true, n_modes: {n_modes}"
    row = {}
    for output in ("none", "snapshots"):
        option = ("--force", "--set", f"rom=[{model}, output: {output}}}]")
        row[f"command_{output}"] = min(sphrom("rom", path, *option) for _ in range(3))
    return row


def faithful_row(workspace: Workspace, projection: str, seconds: float, full: Row) -> Row:
    """Return a step of a model on moving particles beside a full one."""
    (section,) = [
        m for m in workspace.case.rom if not m.from_operators and m.projection == projection
    ]
    with workspace.open(workspace.splines()) as splines:
        fitting = splines.number("wall_seconds")
    return {
        "resolution": full["resolution"],
        "projection": projection,
        "n_modes": section.n_modes,
        "step": seconds,
        "over_full": seconds / full["step"],
        "fit_psi": fitting,
    }


def show(
    console: Console, title: str, rows: list[Row], columns: dict[str, tuple[str, str]]
) -> None:
    """Print rows; columns are a key each, with its heading and format."""
    if not rows:
        return
    table = Table(title=title)
    for heading, _ in columns.values():
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*(format(row[key], form) for key, (_, form) in columns.items()))
    console.print(table)


def show_all(console: Console, results: dict[str, Any]) -> None:
    """Print all tables."""
    show(console, "full model, T = 1 s", results["full"], {
        "resolution": ("N^(1/2)", "d"), "step": ("step [s]", ".4g"),
        "time_step_case": ("case dt [s]", ".3g"), "run_case": ("run [s]", ".3g"),
        "time_step_auto": ("auto dt [s]", ".3g"), "run_auto": ("run [s]", ".3g"),
        "time_step_largest": ("largest dt [s]", ".3g"), "run_largest": ("run [s]", ".3g"),
    })  # fmt: skip
    show(console, "on reference points: online loop, T = 1 s", results["fast"], {
        "resolution": ("N^(1/2)", "d"), "n_modes": ("M", "d"), "n_steps": ("steps", "d"),
        "loop": ("loop [s]", ".3g"), "speed_up_case": ("full at case dt /", ",.0f"),
        "speed_up_auto": ("at auto dt /", ",.0f"),
        "speed_up_largest": ("at largest dt /", ",.0f"),
    })  # fmt: skip
    show(console, "whole `sphrom rom` command, training time", results["commands"], {
        "resolution": ("N^(1/2)", "d"), "n_modes": ("M", "d"),
        "command_none": ("coordinates [s]", ".3g"),
        "command_snapshots": ("snapshots [s]", ".3g"),
    })  # fmt: skip
    show(console, "on moving particles", results["faithful"], {
        "resolution": ("N^(1/2)", "d"), "projection": ("projection", "s"), "n_modes": ("M", "d"),
        "step": ("step [s]", ".4g"), "over_full": ("over full step", ".2f"),
        "fit_psi": ("fit-psi once [s]", ".3g"),
    })  # fmt: skip
    for row in results["independence"]:
        console.print(
            f"M = {row['n_modes']}: loop at {row['fine']} x {row['fine']} over {row['coarse']} x "
            f"{row['coarse']}: {row['ratio']:.2f}; step by step {row['ratio_per_step']:.2f}"
        )


def independence(fast: list[Row]) -> list[Row]:
    """Return what a loop takes at twice a resolution, over what it takes there."""
    found = {(row["resolution"], row["n_modes"]): row for row in fast}
    return [
        {
            "n_modes": n_modes,
            "coarse": resolution,
            "fine": 2 * resolution,
            "ratio": fine["loop"] / row["loop"],
            "ratio_per_step": fine["loop"] / fine["n_steps"] / (row["loop"] / row["n_steps"]),
        }
        for (resolution, n_modes), row in found.items()
        if (fine := found.get((2 * resolution, n_modes))) is not None
    ]


def main() -> None:
    """Read the options, and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resolutions", type=int, nargs="+", default=[50, 100, 200])
    parser.add_argument("--modes", type=int, nargs="+", default=[2, 5, 10, 20])
    parser.add_argument("--repeats", type=int, default=20, help="in which all take turns")
    parser.add_argument("--faithful", type=int, nargs="*", default=[100], help="resolutions")
    parser.add_argument("--commands", type=int, nargs="*", default=[100], help="resolutions")
    parser.add_argument("--training-time", type=float, default=0.2, help="[s]")
    parser.add_argument("--splines", choices=("polyharmonic", "b-spline"), default="polyharmonic")
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--folder", type=Path, default=Path("runs/bench_reduced"))
    parser.add_argument("--json", type=Path, default=Path("runs/bench_reduced.json"))
    parser.add_argument("--prepare", action="store_true", help="train only, measure nothing")
    arguments = parser.parse_args()
    with one_blas_thread():  # as the commands do
        measure(arguments)


def measure(arguments: argparse.Namespace) -> None:
    """Train, measure, print and write what was asked for."""
    paths = {
        n: prepare(n, arguments.modes, arguments.training_time, arguments.folder, arguments.splines)
        for n in arguments.resolutions
    }
    if arguments.prepare:
        return
    threads = set_threads(arguments.threads)
    results: dict[str, Any] = {"cores": os.cpu_count(), "threads": threads}
    results["splines"] = arguments.splines
    results |= {kind: [] for kind in ("full", "fast", "commands", "faithful")}
    for resolution, path in paths.items():
        context = StageContext(load_case(path), path.parent, False, threads, SilentReporter())
        workspace = Workspace(context)
        faithful = resolution in arguments.faithful
        turns = taking_turns(timers(workspace, arguments.modes, faithful), arguments.repeats)
        seconds = {name: float(each.min()) for name, each in turns.items()}
        for name in seconds.keys() - set(arguments.modes):  # of runs in the case's own steps
            seconds[name] /= workspace.case.plan.steps.n_steps
        full = full_row(workspace.case, seconds["full"])
        results["full"].append(full)
        for n_modes in arguments.modes:
            results["fast"].append(fast_row(workspace, n_modes, seconds[n_modes], full))
        for projection in ("galerkin", "apg") if faithful else ():
            row = faithful_row(workspace, projection, seconds[projection], full)
            results["faithful"].append(row)
        if resolution in arguments.commands:
            n_modes = min(5, max(arguments.modes))
            row = commands(path, n_modes)
            results["commands"].append({"resolution": resolution, "n_modes": n_modes, **row})
    results["independence"] = independence(results["fast"])
    show_all(Console(), results)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
