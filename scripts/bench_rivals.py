"""Models on the reference points beside what others would be made of the same training runs.

Trains on Taylor-Green, cavities and cylinders in a channel, predicts inside and outside of the
trained values and beyond the trained time. Compares, in relative L2 over points and time on the
reference points, sphrom's models, the best possible state, coordinates interpolated over the
parameter, and what opinf (operator inference), ezyrb (radial basis functions, Gaussian processes),
pydmd (parametric dynamic modes) and pysindy (sparse identification) make of the same coordinates.
These are installed from the package registry into an environment of their own. A second judge is a
full run whose particles are arranged otherwise: packed from another seed, or on a lattice in other
steps. Prints tables, and writes them as JSON and, for the documentation, as Markdown. Full runs are
kept in --folder, where a second run finds them.

    python scripts/bench_rivals.py --environment /tmp/rivals
    python scripts/bench_rivals.py --scenes taylor-green --modes 5 10
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bench_full import machine
from rich.console import Console
from rich.table import Table

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.case.model_sections import ALL, AUTO, PointModelSection
from sphrom.case.plan_times import lengthened
from sphrom.case.points import ParameterPoint
from sphrom.console import SilentReporter
from sphrom.kernels.jit import set_threads
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.reference.stored import read_basis, read_points
from sphrom.reduction.correction import spline_weights
from sphrom.reduction.own_pressure import JOINT
from sphrom.reduction.trial_basis import TrialBasis, project, reconstruct, truncate, weighted_mean
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.store.trajectory import snapshot_fields
from sphrom.store.workspace import Workspace

Array = np.ndarray
Errors = tuple[float, float]
"""Relative L2 of velocity, and of pressure less its mean [%]."""

PEER = Path(__file__).with_name("rival_models.py")
PACKAGES = ("opinf", "ezyrb", "pydmd", "pysindy")
SCENES: dict[str, dict[str, Any]] = {
    "taylor-green": {
        "discretization": {"resolution": 50, "smoothing_length_ratio": 2.0},
        "time": {"final_time": 1.0},
        "snapshots": {"every": 2},
        "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150, 70, 400]}},
    },
    "lid-driven-cavity": {
        "discretization": {"resolution": 40},
        "time": {"final_time": 2.0},
        "snapshots": {"every": 3},
        "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150, 70, 300]}},
    },
    "open-cavity": {
        "discretization": {"resolution": 48},
        "time": {"spin_up": 1.0, "final_time": 1.5},
        "parameters": {"train": {"reynolds": [1600, 2400]}, "test": {"reynolds": [2000, 1200]}},
    },
    "two-cylinders": {
        "scene": {
            "kind": "custom",
            "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
            "solids": {
                "first": {"circle": {"centre": [1.5, 1.8], "radius": 0.5}},
                "second": {"circle": {"centre": [4.0, 2.3], "radius": 0.4}},
            },
            "body_force": ["0.2*(1 - exp(-t*t))", 0],
            "reference_length": 1.0,
        },
        "discretization": {"resolution": 8},
        "time": {"final_time": 5.0},
        "snapshots": {"every": 5},
        "parameters": {"train": {"reynolds": [40, 75, 120]}, "test": {"reynolds": [60, 30, 160]}},
    },
    "cavity-with-disc": {
        "scene": {
            "kind": "custom",
            "box": {"lower": [0, 0], "upper": [1, 1]},
            "solids": {"disc": {"circle": {"centre": [0.45, 0.45], "radius": 0.15}}},
            "walls": {"top": {"velocity": ["16*x**2*(1 - x)**2", 0]}},
        },
        "discretization": {"resolution": 28},
        "time": {"final_time": 3.0},
        "snapshots": {"every": 5},
        "parameters": {"train": {"reynolds": [60, 140]}, "test": {"reynolds": [100, 40, 200]}},
    },
    "two-parameters": {
        "scene": {"kind": "lid-driven-cavity"},
        "discretization": {"resolution": 24},
        "time": {"final_time": 2.0},
        "snapshots": {"every": 3},
        "parameters": {
            "train": {"reynolds": [50, 100, 200], "lid": [0.5, 1.0]},
            "test": {
                "points": [
                    {"reynolds": r, "lid": v} for r, v in ((150, 0.75), (58, 0.55), (300, 0.8))
                ]
            },
        },
    },
}
"""Cases by scene; the first test value is inside of the trained ones, and judged twice."""
STAGES = ("fom", "map", "pod", "fit-psi", "operators")
LONGER = 2.0
"""Final time over the trained one of runs beyond training."""
TOO_LARGE = 1e3
"""Errors [%] from which a run has diverged."""
ESTIMATES = {"sphrom": "yes", "Gaussian process": "variance"}
"""Who says how far off a prediction may be."""


def install(environment: Path) -> Path:
    """Return the interpreter of an environment with the rivals, made if it isn't there yet."""
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        venv.create(environment, with_pip=True)
    imports = "import " + ", ".join(PACKAGES)
    if subprocess.run([python, "-c", imports], capture_output=True).returncode:
        command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*command, *PACKAGES], check=True)
    return python


def sphrom(stage: str, case: Path, out: Path, *options: str) -> None:
    """Run a command."""
    command = [sys.executable, "-m", "sphrom", stage, case, "--out", out, "--threads", "1"]
    subprocess.run([*command, "--quiet", *options], check=True, capture_output=True, text=True)


@dataclass
class Judge:
    """A full run on the reference points, and what is left of predictions of it."""

    density: Array
    velocity: Array
    weights: Array

    def errors(self, fields: tuple[Array, Array], kept: slice) -> Errors:
        """Return the errors of density fluctuations and velocities at some snapshots [%]."""
        density, velocity = fields[0][kept], fields[1][kept]
        off = density - self.density[kept]
        off = off - weighted_mean(off, self.weights)[:, None]
        size = self.density[kept]
        size = size - weighted_mean(size, self.weights)[:, None]
        moved = np.sum((velocity - self.velocity[kept]) ** 2, axis=2)
        speed = np.sum(self.velocity[kept] ** 2, axis=2)
        return self._ratio(moved, speed), self._ratio(off**2, size**2)

    def _ratio(self, squares: Array, whole: Array) -> float:
        return float(100.0 * np.sqrt((squares @ self.weights).sum() / (whole @ self.weights).sum()))


class Study:
    """A scene's training runs, judges, and models."""

    def __init__(self, scene: str, folder: Path, n_modes: int) -> None:
        self.scene = scene
        self.folder = folder / scene
        self.folder.mkdir(parents=True, exist_ok=True)
        self.path = self.folder / "case.yaml"
        fast = {"evaluation": "operators"}
        models = [{"name": "fast", **fast, "n_modes": n_modes}]
        models += [{"name": "chosen", **fast, "n_modes": AUTO}]
        given = {"name": scene, "scene": {"kind": scene}, **SCENES[scene], "rom": models}
        given["basis"] = {"n_modes": n_modes}
        self.path.write_text(yaml.safe_dump(given))
        for stage in STAGES:
            sphrom(stage, self.path, self.folder)
        self.case = load_case(self.path)
        context = StageContext(self.case, self.folder, False, 1, SilentReporter())
        self.workspace = Workspace(context)
        self.basis = read_basis(self.workspace, ALL)
        self.points = read_points(self.workspace)
        self.plan = self.case.plan.steps
        self.longer = lengthened(self.plan, self._later())

    def _later(self) -> float:
        return self.plan.start_time + LONGER * (self.plan.end_time - self.plan.start_time)

    @property
    def inside(self) -> ParameterPoint:
        """The value that is judged twice, and beyond the trained time."""
        return self.case.plan.test_points[0]

    def own(self, point: ParameterPoint) -> Judge:
        """Return the full run at a point."""
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            return Judge(
                mapped.read("density_fluctuation"), mapped.read("velocity"), self.basis.weights
            )

    def other(self) -> Judge:
        """Return a full run inside whose particles are arranged otherwise."""
        if self.case.plan.packed:
            options = ["--set", "discretization.packing.seed=1"]
        else:
            every = self.plan.every + 1
            step = self.plan.snapshot_interval / every
            options = ["--set", f"snapshots.every={every}", "--set", f"time.step={step!r}"]
        return self._mapped_here("other", options)

    def beyond(self) -> Judge:
        """Return a full run inside that is longer than the trained ones."""
        # An automatic step may be another one for another time.
        changes = {"time.final_time": self._later(), "time.step": self.plan.time_step}
        options = [word for key, value in changes.items() for word in ("--set", f"{key}={value!r}")]
        return self._mapped_here("longer", options)

    def _mapped_here(self, name: str, options: list[str]) -> Judge:
        out = self.folder / name
        only = self.inside.label.replace(" ", "")
        sphrom("fom", self.path, out, "--only", only, *options)
        to_points = particles.map_onto(self.case, self.points)
        file = out / f"fom-{self.inside.file_label}.h5"
        with open_artifact(file, "sphrom/trajectory", made_by="") as run:
            n = len(run.read("time"))
            fields = [to_points(*snapshot_fields(run, snapshot)) for snapshot in range(n)]
        density, velocity = (np.array(each) for each in zip(*fields, strict=True))
        return Judge(density, velocity, self.basis.weights)

    def fields(self, coordinates: Array, basis: TrialBasis | None = None) -> tuple[Array, Array]:
        """Return density fluctuations and velocities of coordinates, by default of joint modes."""
        return reconstruct(basis or truncate(self.basis, coordinates.shape[1]), coordinates)

    def projected(self, judge: Judge, n_modes: int) -> Array:
        """Return the best coordinates of a judge."""
        return project(truncate(self.basis, n_modes), judge.density, judge.velocity)


@dataclass(frozen=True)
class Prediction:
    """What a model predicts at every test value, over the longer time inside where it can."""

    name: str
    coordinates: list[Array]
    offline: float
    online: float
    estimates: list[Errors] | None = None
    basis: TrialBasis | None = None
    """The modes of the coordinates, if there are pressure modes among them."""
    pressure: str = JOINT
    """What held-out training runs chose."""


def ours(study: Study, n_modes: int | str, **keys: Any) -> Prediction:
    """Return the predictions of a model of the program, with the keys of a case."""
    section = PointModelSection(name="x", evaluation="operators", n_modes=n_modes, **keys)
    began = time.perf_counter()
    fast = FastModel(study.workspace, section)
    for point in study.case.plan.test_points:
        fast.at(point)
    offline = time.perf_counter() - began
    with study.workspace.open(study.workspace.operators()) as artifact:
        offline += artifact.number("wall_seconds")
    found, seconds, estimates = [], [], []
    for point in study.case.plan.test_points:
        reduced = fast.at(point)
        runs, taken = fast.at_point(point).integrator(reduced).timed(5)
        seconds.append(taken)
        run = FastRun(**vars(runs), model=fast, point=point, reduced=reduced)
        if (known := run.estimate) is not None:
            estimates.append((known.velocity_percent, known.pressure_percent))
        if point == study.inside:
            later = replace(reduced.output_times, n_snapshots=study.longer.n_snapshots)
            longer = fast.run(point, replace(reduced, output_times=later))
            found.append((run.states, longer.states))
        else:
            found.append((run.states, None))
    coordinates = [
        own if longer is None else np.concatenate((own, longer[len(own) :]))
        for own, longer in found
    ]
    model = fast.at_point(study.inside)
    words = [f"{key}: {str(value).lower()}" for key, value in keys.items()]
    if n_modes == AUTO:
        words.insert(0, f"n_modes: auto, {model.basis.n_modes}")
    name = ", ".join(("sphrom", *words))
    online = float(np.mean(seconds))
    (pressure,) = model.trained.pressure or (JOINT,)
    return Prediction(name, coordinates, offline, online, estimates, model.whole, pressure)


def with_joint_pressure(found: Prediction, n_modes: int) -> Iterator[Prediction]:
    """Yield a prediction without pressure modes, if it has any."""
    if found.pressure != JOINT:
        name = f"{found.name}, {JOINT} pressure instead of {found.pressure}"
        joint = [each[:, :n_modes] for each in found.coordinates]
        yield Prediction(name, joint, found.offline, found.online)


def interpolated(study: Study, training: Array, n_modes: int) -> Iterator[Prediction]:
    """Yield training coordinates interpolated over a function of the Reynolds number."""
    for name, of in (("1/Re", lambda r: 1.0 / r), ("log Re", np.log)):
        place = lambda p, of=of: np.array([of(p.reynolds), *p.factors.values()])  # noqa: E731
        places = np.array([place(p) for p in study.case.plan.train_points])
        spline_weights(places, places[0])  # loads what it needs
        began = time.perf_counter()
        found = [
            np.tensordot(spline_weights(places, place(p)), training, 1)
            for p in study.case.plan.test_points
        ]
        seconds = (time.perf_counter() - began) / len(found)
        yield Prediction(f"coordinates interpolated in {name}", found, 0.0, seconds)


def rivals(study: Study, python: Path, training: Array, n_modes: int) -> Iterator[Prediction]:
    """Yield what the packages predict from the same coordinates."""
    tested = study.case.plan.test_points
    if tested[0].factors:
        return  # they are given one parameter
    fast = FastModel(
        study.workspace, PointModelSection(name="x", evaluation="operators", n_modes=n_modes)
    )
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(
            source,
            places=[1.0 / point.reynolds for point in study.case.plan.train_points],
            tested=[1.0 / point.reynolds for point in tested],
            runs=training,
            starts=[fast.at(point).start for point in tested],
            step=study.plan.snapshot_interval,
            n_predicted=study.longer.n_snapshots,
        )
        subprocess.run(
            [python, PEER, source, target], check=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        found = np.load(target)
        for key in (k for k in found if k.endswith("/coordinates")):
            name = key.removesuffix("/coordinates")
            offline, online = found[f"{name}/seconds"]
            yield Prediction(name, list(found[key]), float(offline), float(online))


def rows_of(study: Study, python: Path, n_modes: int) -> list[dict[str, Any]]:
    """Return the errors of all models of a size."""
    training = np.stack(
        [study.projected(study.own(point), n_modes) for point in study.case.plan.train_points]
    )
    judges = {point.label: study.own(point) for point in study.case.plan.test_points}
    other, longer = study.other(), study.beyond()
    n = study.plan.n_snapshots
    inside = slice(0, n)
    beyond = slice(n, study.longer.n_snapshots)
    best = Prediction(
        "best possible", [study.projected(judge, n_modes) for judge in judges.values()], 0.0, 0.0
    )
    own = ours(study, n_modes)
    predictions = [
        best,
        own,
        *with_joint_pressure(own, n_modes),
        ours(study, AUTO),
        ours(study, n_modes, corrected=False),
        ours(study, n_modes, corrected=False, calibrated=False),
        *interpolated(study, training, n_modes),
        *rivals(study, python, training, n_modes),
    ]
    rows = []
    np.seterr(all="ignore")  # rivals diverge
    for found in predictions:
        row: dict[str, Any] = {
            "scene": study.scene,
            "n_modes": n_modes,
            "model": found.name,
            "offline_seconds": found.offline,
            "online_seconds": found.online,
            "estimate": ESTIMATES.get(found.name.split(",")[0], "no"),
        }
        for k, (label, judge) in enumerate(judges.items()):
            fields = study.fields(found.coordinates[k][inside], found.basis)
            row[label] = judge.errors(fields, inside)
            if found.estimates:
                row[f"{label}, estimated"] = found.estimates[k]
        first = found.coordinates[0]
        best_of = {
            "other": study.projected(other, n_modes),
            "longer": study.projected(longer, n_modes),
        }
        is_best = found is best
        row["other particles"] = other.errors(
            study.fields((best_of["other"] if is_best else first)[inside], found.basis), inside
        )
        whole = best_of["longer"] if is_best else first
        if len(whole) == study.longer.n_snapshots:
            row["beyond"] = longer.errors(study.fields(whole, found.basis), beyond)
        rows.append(row)
    return rows


def both(errors: Errors | None) -> str:
    """Return the errors of velocity and pressure as one cell."""
    if errors is None:
        return ""
    if not max(errors) < TOO_LARGE:
        return "unstable"
    return f"{errors[0]:.3g} | {errors[1]:.3g}"


def show(rows: list[dict[str, Any]]) -> None:
    """Print a table for each scene and number of modes: velocity | pressure [%]."""
    console = Console(width=200)
    for scene, n_modes in dict.fromkeys((row["scene"], row["n_modes"]) for row in rows):
        some = [row for row in rows if (row["scene"], row["n_modes"]) == (scene, n_modes)]
        cases = [key for key in some[0] if isinstance(some[0][key], tuple)]
        table = Table(title=f"{scene}, M = {n_modes}: relative L2 of velocity | pressure [%]")
        for name in ("model", *cases, "offline [s]", "online [ms]", "estimate"):
            table.add_column(name, justify="left" if name == "model" else "right")
        for row in some:
            cells = [both(row.get(key)) for key in cases]
            seconds = f"{row['offline_seconds']:.2g}", f"{1e3 * row['online_seconds']:.2g}"
            table.add_row(row["model"], *cells, *seconds, row["estimate"])
        console.print(table)


def markdown(rows: list[dict[str, Any]]) -> str:
    """Return the same tables for the documentation."""
    parts = []
    for scene, n_modes in dict.fromkeys((row["scene"], row["n_modes"]) for row in rows):
        some = [row for row in rows if (row["scene"], row["n_modes"]) == (scene, n_modes)]
        cases = [key for key in some[0] if isinstance(some[0][key], tuple | list)]
        names = [case.replace("reynolds=", "Re ") for case in cases]
        parts += [
            f"\n{scene}, M = {n_modes}:\n",
            "| " + " | ".join(("model", *names, "learns in [s]", "one run [ms]")) + " |",
            "|---" * (len(names) + 3) + "|",
        ]
        for row in some:
            cells = [both(row.get(key)).replace(" | ", " / ") for key in cases]
            seconds = f"{row['offline_seconds']:.2g}", f"{1e3 * row['online_seconds']:.2g}"
            parts.append("| " + " | ".join((row["model"], *cells, *seconds)) + " |")
    return "\n".join(parts) + "\n"


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environment", type=Path, help="folder to install rivals in, and to keep")
    parser.add_argument("--folder", type=Path, default=Path("runs/bench_rivals"))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--modes", type=int, nargs="+", default=[5, 10, 20])
    parser.add_argument("--json", type=Path, default=Path("runs/bench_rivals.json"))
    arguments = parser.parse_args()
    set_threads(1)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            python = install(arguments.environment or Path(folder))
            for scene in arguments.scenes:
                study = Study(scene, arguments.folder, max(arguments.modes))
                for n_modes in arguments.modes:
                    rows += rows_of(study, python, n_modes)
        except subprocess.CalledProcessError as error:
            sys.exit(f"{error}\n{error.stderr or ''}")
    show(rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.with_suffix(".md").write_text(markdown(rows))
    results = {"machine": machine(), "threads": 1, "rows": rows}
    arguments.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
