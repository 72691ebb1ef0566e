"""The maps of docs/stability.md: three scenes and flows of one's own at their extremes.

Each case is run and mapped as `sphrom trade CASE --extremes` does. Beside it scipy's `solve_ivp`
integrates the rates of every fifth fast model or so, of those of other full models every second. It
says whether they diverge, and how far the project's own run is from its solution. Tables of the
limits are printed as Markdown.

    python scripts/stability.py --out runs/stability
    python scripts/stability.py --out runs/stability --turnovers 100

With `--turnovers` full runs of that many turnover times L/U, at half the resolution, say how
kinetic energy and the mean density change instead.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image, ImageColor
from scipy.integrate import solve_ivp

from sphrom.case.discretization_checks import coarser_resolution
from sphrom.case.loader import load_case
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.studies import at_resolution
from sphrom.console import Reporter
from sphrom.errors import UnstableError
from sphrom.models import fom
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.stable_ranges import FILE, MEMORY, STEP, StableRange
from sphrom.models.starts import scene_start
from sphrom.plots.panels import save
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA
from sphrom.reduction.reference_model import Integrator
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import FULL_MODEL
from sphrom.trade.extremes import Maps
from sphrom.trade.stability import COLOURS, ExtremeRun, draw_maps, publish

CASES, FIGURES = (Path(__file__).parents[1] / name for name in ("cases", "docs/figures"))
SHOWN = "lid-driven-cavity"
"""Whose map of Reynolds numbers stands alone, too."""
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "taylor-green": ("taylor_green_demo", {}),
    "lid-driven-cavity": ("lid_driven_cavity_demo", {}),
    "open-cavity": (
        "open_cavity_demo",
        {
            "discretization": {"resolution": 48},
            "parameters": {"train": {"reynolds": [1600, 2400]}, "test": {"reynolds": [2000]}},
        },
    ),
    "cavity-with-fin": ("gallery/cavity_with_fin", {}),
    "kolmogorov": (
        "gallery/kolmogorov",
        {
            "parameters": {
                "train": {
                    "points": [
                        {"reynolds": 18, "body_force": 1.0},
                        {"reynolds": 24, "body_force": 1.0},
                        {"reynolds": 32, "body_force": 1.0},
                        {"reynolds": 24, "body_force": 0.7},
                    ]
                },
                "test": {"points": [{"reynolds": 28, "body_force": 0.9}]},
            }
        },
    ),
    "lid-speed": (
        "lid_driven_cavity_demo",
        {
            "discretization": {"resolution": 30},
            "parameters": {
                "train": {
                    "points": [
                        {"reynolds": 100, "lid": 1.0},
                        {"reynolds": 200, "lid": 1.0},
                        {"reynolds": 200, "lid": 0.5},
                    ]
                },
                "test": {"points": [{"reynolds": 150, "lid": 0.8}]},
            },
        },
    ),
}
"""The case that each is made of, and what differs. The last two vary what drives the flow, too."""
STAGES = ("fom", "map", "pod", "fit-psi", "operators")
WIDTH = 740
"""Of pictures in the documentation [pixels]."""
ONE_IN = 5
TOLERANCE = 1e-8
"""Of scipy's integrator, relative."""


class Checked(Maps):
    """Maps of which another integrator checks some runs."""

    def __init__(self, context: StageContext, quick: bool) -> None:
        super().__init__(context, quick)
        self.checks: list[dict[str, Any]] = []

    def integrated(
        self, found: ExtremeRun, model: FastModel, point: ParameterPoint, integrator: Integrator
    ) -> FastRun:
        """Run a fast model, and some of them by scipy, too."""
        run = super().integrated(found, model, point, integrator)
        key = f"{found.varied} {found.value:g} {found.model}"
        if zlib.crc32(key.encode()) % (2 if found.varied in FULL_MODEL else ONE_IN) == 0:
            about = {"varied": found.varied, "value": found.value, "model": found.model}
            self.checks.append(about | checked(integrator))
        return run


def checked(integrator: Integrator) -> dict[str, Any]:
    """Integrate the rates of a model by scipy, and compare with the project's steps.

    Raises RuntimeError where scipy's integrator gives up.
    """
    model, own = integrator.steps.model, integrator.steps.run()
    times, most = model.output_times.time, model.output_times.largest_square

    def rates(at: float, state: np.ndarray) -> np.ndarray:
        amplitude = 0.0 if model.amplitude is None else float(model.amplitude(np.array([at]))[0])
        return model.polynomial(state, amplitude)

    def left(at: float, state: np.ndarray) -> float:
        return most - float(state @ state)

    left.terminal = True  # type: ignore[attr-defined]
    absolute = TOLERANCE * float(np.sqrt(most))
    solved = solve_ivp(
        rates, (times[0], times[-1]), model.start, "LSODA", times, events=left,
        rtol=TOLERANCE, atol=absolute,
    )  # fmt: skip
    if solved.status < 0:
        raise RuntimeError(solved.message)
    states = np.reshape(solved.y, (len(model.start), -1)).T  # none where it diverges at once
    n_both = min(len(states), int(np.isfinite(own.coordinates).all(axis=1).sum()))
    both = own.coordinates[:n_both] - states[:n_both]
    difference = float(np.linalg.norm(both) / max(np.linalg.norm(states[:n_both]), absolute))
    unstable = len(states) < len(times)
    return {
        "diverges": unstable,
        "diverges_here": bool(np.isfinite(own.diverged_at)),
        "at": float(solved.t_events[0][0]) if unstable and len(solved.t_events[0]) else None,
        "at_here": None if np.isnan(own.diverged_at) else float(own.diverged_at),
        "difference": 100.0 * difference,
    }


def written(name: str, out: Path) -> Path:
    """Write the case of a scene, and return its path."""
    source, changes = SCENES[name]
    content = yaml.safe_load((CASES / f"{source}.yaml").read_text(encoding="utf-8"))
    n_modes = next(m["n_modes"] for m in content["rom"] if m.get("evaluation") == "operators")
    content.pop("sweep", None)
    content |= {
        "name": name,
        "basis": {"n_modes": 50},
        "operators": {"error_estimate": True},
        "rom": [{"name": "fast", "n_modes": n_modes, "evaluation": "operators"}],
        **changes,
    }
    path = out / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def mapped(name: str, out: Path) -> None:
    """Make the artifacts and the maps of a scene, and write what scipy says of some of its runs."""
    path, folder, started = written(name, out), out / name, time.perf_counter()
    for stage in STAGES:
        words = [sys.executable, "-m", "sphrom", stage, str(path), "--out", str(folder)]
        subprocess.run([*words, "--threads", "1"], check=True, stdout=subprocess.DEVNULL)
    context = StageContext(load_case(path), folder, False, 1, Reporter())
    maps = Checked(context, False)
    publish(Workspace(context), list(maps.runs()), maps.default, maps.own_values, maps.notes)
    text = json.dumps({"seconds": time.perf_counter() - started, "checks": maps.checks}, indent=1)
    (folder / "checks.json").write_text(text, encoding="utf-8")


def conserved(name: str, out: Path, turnovers: int) -> None:
    """Print how kinetic energy and mean density of a long full run change."""
    whole = load_case(written(name, out))
    case = at_resolution(whole, coarser_resolution(whole) or whole.discretization.resolution)
    workspace = Workspace(StageContext(case, out / f"{name}-long", False, 1, Reporter()))
    fom.ensure_packed(workspace)
    point = (case.plan.test_points or case.plan.train_points)[0]
    turnover = case.scene.length_scale / case.fluid.reference_speed
    density, begin = case.fluid.reference_density, scene_start(workspace, point)
    every = max(1, round(turnover / case.plan.step_target))
    steps = TimeSteps(turnover / every, turnovers * every, every)
    model, rows = particles.functional(case, point), []
    try:
        for _, state in march(model, begin.state, steps, density, Clock(), lambda done: None):
            energy = 0.5 * float(np.mean(np.sum(state[3:] ** 2, axis=0)))
            rows.append((energy, float(state[2].mean()) / density))
    except UnstableError as error:
        print(f"{name}: {error}")
    shown = [k for k in (0, 1, 2, 5, 10, 20, 50, 99, 100, turnovers) if k < len(rows)]
    energies = ", ".join(f"{rows[k][0]:.4g} at {k}" for k in shown)
    drift = max(abs(mean) for _, mean in rows)
    print(
        f"{name}, {case.discretization.resolution} across, {point.label}, {len(rows) - 1} turnover "
        f"times of {turnover:g} s: kinetic energy per mass [m2/s2] {energies}; largest mean of "
        f"(rho - rho0)/rho0 {drift:.2g}"
    )


def pictured(runs: Sequence[ExtremeRun], out: Path, name: str) -> None:
    """Draw maps as a small picture of the documentation, in the colours of states and letters."""
    save(draw_maps(runs), out / name)
    with Image.open(out / name) as picture:
        small = picture.convert("RGB")
    size = WIDTH, round(small.height * WIDTH / small.width)
    ink, states = (34, 34, 34), [ImageColor.getrgb(colour) for colour in COLOURS.values()]
    plain = [(255, 255, 255), *states]
    mixed = [tuple((a + b) // 2 for a, b in zip(ink, one, strict=True)) for one in plain]
    colours = [ink, *plain, *mixed]
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in colours for value in colour])
    few = small.resize(size, Image.Resampling.LANCZOS)
    few.quantize(palette=palette, dither=Image.Dither.NONE).save(FIGURES / name, optimize=True)


def drawn(name: str, out: Path) -> None:
    """Draw the maps of a scene for the documentation, and print its limits as Markdown."""
    document = json.loads((out / name / FILE).read_text(encoding="utf-8"))
    runs = [ExtremeRun(**row) for row in document["extremes"]]
    pictured(runs, out, f"stability-{name}.png")
    if name == SHOWN:
        pictured([run for run in runs if run.varied == REYNOLDS], out, "stability.png")
    checks = json.loads((out / name / "checks.json").read_text(encoding="utf-8"))
    counts = Counter(run.state for run in runs)
    fast = (run for run in runs if run.kind == "fast" and not run.told)
    silent = sum(max(run.errors or (0.0,)) > 100.0 for run in fast)
    print(f"\n{name}: {len(runs)} runs, {dict(counts)}, {silent} silent")
    print(f"{checks['seconds']:.0f} s, with what else ran on the machine")
    for title in dict.fromkeys(run.varied for run in runs):
        some = [each for each in checks["checks"] if each["varied"] == title]
        agree = sum(each["diverges"] == each["diverges_here"] for each in some)
        stable = [e["difference"] for e in some if not e["diverges"] and not e["diverges_here"]]
        print(f"{title}: {agree} of {len(some)} checks agree; differences {sorted(stable)[-3:]}")
        for each in some:
            if each["diverges"] != each["diverges_here"]:
                print(f"    {each}")
    print("| | model | right | stable | wrong below | wrong above | predicted |")
    print("|---|---|---|---|---|---|---|")
    for row in document["ranges"]:
        print("| " + " | ".join(_cells(StableRange(**row))) + " |")


def judge_predictions(out: Path, names: Sequence[str]) -> None:
    """Print how good predictions of limits are, and estimated errors outside of the trained values.

    A limit is good if it lies between the longest stable and the shortest unstable value.
    """
    documents = {n: json.loads((out / n / FILE).read_text(encoding="utf-8")) for n in names}
    for varied, method, size in (
        (STEP, RUNGE_KUTTA, "time_step"),
        (MEMORY, EXPONENTIAL, "memory_length"),
    ):
        counts: Counter[str] = Counter()
        for document in documents.values():
            for row in document["ranges"]:
                same = {key: row[key] for key in ("varied", "projection", "n_modes", "steps")}
                if row["varied"] == varied and (row["kind"], row["steps"]) == ("fast", method):
                    runs = [e for e in document["extremes"] if same.items() <= e.items()]
                    unstable = [e[size] for e in runs if e["state"] == "unstable"]
                    counts[_judgement(row["predicted"], row["stable_to"], unstable)] += 1
        print(f"{varied}, {method}: {dict(counts)}")
    for name, document in documents.items():
        outside = [e for e in document["extremes"] if e["kind"] == "fast" and e["extrapolated"]]
        for varied in dict.fromkeys(each["varied"] for each in outside):
            runs = [each for each in outside if each["varied"] == varied]
            medians = [_over_estimates(runs, field) for field in ("velocity", "pressure")]
            print(f"{name}, {varied}: median error over its estimate {np.round(medians, 2)}")


def _over_estimates(runs: Sequence[dict[str, Any]], field: str) -> float:
    """Return the median error of a field over its estimate; NaN without any."""
    told = [each for each in runs if each[f"{field}_estimate"] and each[f"{field}_error"]]
    return float(np.median([e[f"{field}_error"] / e[f"{field}_estimate"] for e in told]))


def _judgement(predicted: float | None, stable_to: float | None, unstable: list[float]) -> str:
    if not unstable:
        return "never unstable"
    if predicted is None or stable_to is None:
        return "no prediction"
    if predicted < stable_to:
        return "below the longest stable value"
    return "good" if predicted <= min(unstable) else "above the shortest unstable value"


def _cells(each: StableRange) -> tuple[str, ...]:
    def span(low: float | None, high: float | None) -> str:
        return "nowhere" if low is None else f"{low:.3g} to {high:.3g}"

    predicted = f"{each.predicted:.3g} ({each.predicted_by})" if each.predicted else ""
    model = f"{each.kind} {each.projection} {each.n_modes or ''} {each.steps}"
    right, stable = span(each.right_from, each.right_to), span(each.stable_from, each.stable_to)
    return each.varied, model, right, stable, each.below, each.above, predicted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/stability"))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--turnovers", type=int)
    parser.add_argument("--draw", action="store_true", help="only draw what is there")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.scenes:
        if given.turnovers:
            conserved(name, given.out, given.turnovers)
        elif given.draw:
            drawn(name, given.out)
        else:
            mapped(name, given.out)
            drawn(name, given.out)
    if not given.turnovers:
        judge_predictions(given.out, given.scenes)


if __name__ == "__main__":
    main()
