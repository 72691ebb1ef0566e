"""Reduced models of a sloshing tank: errors, fillings, a hundred periods, and response curves.

Every part runs `cases/gallery/sloshing.yaml`, or variants of it, and prints a table of Markdown;
`response` and `filling-map` draw the pictures of docs/free-surfaces.md, too.

    python scripts/sloshing.py errors fillings noslip long record response filling-map
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from small_picture import write_small

from sphrom import Study
from sphrom.errors import UnstableError
from sphrom.plots.panels import Curve, Field, Frame, Panel, draw_grid, save

ROOT = Path(__file__).parents[1]
CASE, FIGURES = ROOT / "cases" / "gallery" / "sloshing.yaml", ROOT / "docs" / "figures"
RATE = math.sqrt(math.pi * math.tanh(0.5 * math.pi))
"""Of the first mode in a tank one metre wide, filled half a metre, at a gravity of one [rad/s]."""
PERIOD = 2.0 * math.pi / RATE
SIZES = (2, 3, 5, 7, 10, 20)
FINE = {"discretization": {"resolution": 32}, "snapshots": {"every": 40}}
"""64 x 32 particles."""
RATIOS = {
    "parameters": {
        name: {"points": [{"reynolds": 250, "ratio": r, "strength": 0.03} for r in ratios]}
        for name, ratios in {"train": (0.8, 0.9), "test": (0.85,)}.items()
    }
}
"""Two training runs, and a frequency between."""
N_RUNS = 1000


def merged(whole: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return a case with changes; lists of parameter points are replaced."""
    found = dict(whole)
    for key, value in changes.items():
        own = found.get(key)
        nested = isinstance(own, dict) and isinstance(value, dict) and key != "parameters"
        found[key] = merged(own, value) if nested else value
    return found


def study_of(
    folder: Path, name: str, *changes: dict[str, Any], sizes: Iterable[int] = (5,)
) -> Study:
    """Return a study of a variant of the case, all of whose stages were run."""
    case = yaml.safe_load(CASE.read_text(encoding="utf-8"))
    models = [{"name": f"fast{m}", "evaluation": "operators", "n_modes": m} for m in sizes]
    for change in ({"rom": models, "compare": {"plots": False}}, *changes):
        case = merged(case, change)
    study = Study(case, out=folder / name, threads=1)
    study.run()
    return study


def table(study: Study, sizes: Iterable[int], point: str) -> None:
    """Print the errors at a parameter point: calibrated, not calibrated, of the nearest states."""
    with (study.folder / "tables" / "measures.csv").open() as file:
        measures = [row for row in csv.DictReader(file) if point in row["parameters"]]
    with (study.folder / "tables" / "errors.csv").open() as file:
        errors = [row for row in csv.DictReader(file) if point in row["parameters"]]
    print(
        "| modes | kind | elevation | velocity | wall pressure | force |\n|---|---|---|---|---|---|"
    )
    for size in sizes:
        own = [row for row in measures if row["compared"] == f"fast{size}"]
        kept = own[0]["n_modes"] if own else "-"
        for kind in ("fast{}", "fast{}, not calibrated", f"best possible, all M={kept}"):
            name, found = kind.format(size), {}
            for row in measures:
                if row["compared"] == name and row["relative_l2 [%]"]:
                    found[row["measured"], row["quantity"]] = float(row["relative_l2 [%]"])
            velocity = [
                r["velocity_field_relative_l2 [%]"] for r in errors if r["compared"] == name
            ]
            figures = [found.get(("surface", "elevation")), *map(float, filter(None, velocity[:1]))]
            figures += [found.get(("wall", "pressure")), found.get(("side", "force_x"))]
            shown = " | ".join("-" if f is None else f"{f:.2g}" for f in figures)
            print(
                f"| {size} ({kept}) | {name.partition(',')[2].strip() or 'calibrated'} | {shown} |"
            )


def errors(folder: Path) -> None:
    """Print errors between two trained frequencies, and what the full and a fast run cost."""
    study = study_of(folder, "errors", FINE, RATIOS, sizes=SIZES)
    table(study, SIZES, "ratio=0.85")
    with (study.folder / "tables" / "timings.csv").open() as file:
        for row in csv.DictReader(file):
            if "0.85" in row["parameters"]:
                full, own = (float(row[f"{n}_seconds [s]"]) for n in ("full", "reduced"))
                print(f"{row['model']}: {full:.3g} s and {own:.3g} s, {full / own:.3g} times")


def fillings(folder: Path) -> None:
    """Print errors at a filling between two that are trained."""
    strength = {"reynolds": 250, "ratio": 0.85, "strength": 0.03}
    levels = [{**strength, "filling": level} for level in (0.40625, 0.5, 0.59375)]
    points = {"train": {"points": levels[::2]}, "test": {"points": levels[1:2]}}
    scene = {"constants": {"filling": 0.5}, "fluid": {"level": "filling"}}
    sizes = (3, 5, 10)
    study = study_of(folder, "fillings", FINE, {"scene": scene, "parameters": points}, sizes=sizes)
    table(study, sizes, "filling=0.5")


def noslip(folder: Path) -> None:
    """Print errors where fluid sticks to the walls, at a Reynolds number of 1,000."""
    points = {
        name: {"points": [{**each, "reynolds": 1000} for each in part["points"]]}
        for name, part in RATIOS["parameters"].items()
    }
    change = {"scene": {"slip": "none"}, "parameters": points}
    table(study_of(folder, "noslip", FINE, change, sizes=(5, 10)), (5, 10), "ratio=0.85")


def long(folder: Path) -> None:
    """Print the elevation's range over the last of a hundred periods."""
    study = study_of(folder, "errors", FINE, RATIOS, sizes=SIZES)
    interval = study.case.plan.steps.snapshot_interval
    for size in SIZES:
        for ratio in (0.8, 0.85, 0.9):
            model = study.model(f"fast{size}", reynolds=250, ratio=ratio, strength=0.03)
            end = interval * round(100.0 * PERIOD / interval)
            try:
                heights = model.run(end).measures["gauge_elevation"].to_numpy()
            except UnstableError as error:
                print(f"M = {size}, ratio {ratio}: {error}")
                continue
            tenth = len(heights) // 10
            ranges = [np.ptp(heights[part]) for part in (slice(tenth), slice(-tenth, None))]
            print(
                f"M = {size}, ratio {ratio}: range {ranges[0]:.4f} m first, {ranges[1]:.4f} m last"
            )


def record(folder: Path) -> None:
    """Print the errors under an irregular history of a model that was trained by two sines."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(1)
    t = np.arange(0.0, 37.21, 0.2)
    ratios = np.linspace(0.7, 1.3, 13)[:, None]
    sines = np.sin(ratios * RATE * t + random.uniform(0.0, 2.0 * math.pi, ratios.shape))
    waves = np.exp(-(((ratios - 0.95) / 0.2) ** 2)) * sines
    values = waves.sum(axis=0) * np.minimum(1.0, 0.5 * t)
    values *= 0.006 / math.sqrt(np.mean(values**2))  # m/s2
    table_of = folder / "record.csv"
    rows = np.stack((t, values), axis=1)
    np.savetxt(table_of, rows, delimiter=",", header="time,acceleration", comments="")
    recorded = {
        "scene": {
            "constants": {"gain": 0.0},
            "histories": {"record": {"file": str(table_of.resolve()), "value": "acceleration"}},
            "body_force": ["strength*sin(ratio*1.6974449*t) + gain*record(t)", 0],
        },
        "discretization": {"resolution": 14},
        "snapshots": {"every": 14},
        "parameters": {
            name: {
                "points": [
                    {"reynolds": 250, "ratio": r, "strength": s, "gain": g} for r, s, g in at
                ]
            }
            for name, at in {
                "train": ((0.88, 0.01, 0.0), (1.12, 0.01, 0.0)),
                "test": ((0.88, 0.0, 1.0),),
            }.items()
        },
    }
    table(study_of(folder, "record", recorded, sizes=(4,)), (4,), "gain=1")


def linear_theory(ratio: np.ndarray, strength: float, viscosity: float) -> np.ndarray:
    """Return the amplitude of the steady oscillation at the wall [m], of potential flow."""
    n = np.arange(1, 40, 2)[:, None]
    rates = n * math.pi * np.tanh(0.5 * n * math.pi)
    forcing = rates * 4.0 * strength / (n * math.pi) ** 2
    damping = 4.0j * viscosity * (n * math.pi) ** 2 * ratio * RATE
    return np.abs(np.sum(forcing / (rates - (ratio * RATE) ** 2 + damping), axis=0))


def response(folder: Path) -> None:
    """Draw the amplitude at the wall over frequency at two strengths, beside linear theory."""
    study = study_of(folder, "response")
    ratios, strengths = np.linspace(0.7, 1.3, N_RUNS // 2), (0.0004, 0.004)
    found = amplitudes(
        study, {"ratio": np.tile(ratios, 2), "strength": np.repeat(strengths, N_RUNS // 2)}
    )
    curves = []
    for strength, own in zip(strengths, np.split(found, 2), strict=True):
        theory = linear_theory(ratios, strength, math.sqrt(0.5) * 0.5 / 250.0)
        label = f"{strength:g} m/s2"
        curves.append(Curve(f"linear theory, {label}", ratios, theory / strength, "exact"))
        curves.append(Curve(f"fast model, {label}", ratios, own / strength))
        peak, expected = (ratios[np.nanargmax(each)] for each in (own, theory))
        print(f"{label}: peak at {peak:.4f} of the first mode, linear theory {expected:.4f}; "
              f"heights {np.nanmax(own):.4g} and {theory.max():.4g} m")  # fmt: skip
    panel = Panel("", "frequency over the first mode's [–]", "amplitude / strength [s2]", curves)
    picture(draw_grid([[panel]]), folder / "sloshing-response.png")


def amplitudes(study: Study, points: dict[str, Any]) -> np.ndarray:
    """Return half the range of the elevation over the last ten of forty periods [m]."""
    interval = study.case.plan.steps.snapshot_interval
    until = {"rom.0.until": interval * round(40.0 * PERIOD / interval)}
    case = study.folder / "case.yaml"
    case.write_text(study.case.text, encoding="utf-8")
    model = Study(case, set=until, out=study.folder, threads=1).model("fast5")
    started = time.perf_counter()
    found = model.run_many({"reynolds": 250.0, **points})
    print(f"{len(found['run'])} runs of forty periods: {time.perf_counter() - started:.0f} s")
    late = found["gauge_elevation"].to_numpy()[:, -len(found["time"]) // 4 :]
    return 0.5 * (late.max(axis=1) - late.min(axis=1))


def filling_map(folder: Path) -> None:
    """Draw the amplitude at the wall over frequency and filling."""
    weak = {"reynolds": 250, "strength": 0.003}
    trained = [{**weak, "ratio": r, "filling": d} for d in (0.4, 0.6) for r in (0.9, 1.0)]
    test = [{**weak, "ratio": 0.95, "filling": 0.5}]
    points = {"train": {"points": trained}, "test": {"points": test}}
    scene = {"constants": {"filling": 0.5}, "fluid": {"level": "filling"}}
    study = study_of(folder, "filling-map", {"scene": scene, "parameters": points})
    ratios, levels = np.linspace(0.7, 1.3, 40), np.linspace(0.4, 0.6, 25)
    grid = [each.ravel() for each in np.meshgrid(ratios, levels)]
    found = amplitudes(study, {"ratio": grid[0], "filling": grid[1], "strength": 0.003})
    label = "amplitude at the wall [m]"
    title = f"{label}, strength 0.003 m/s2"
    field = Field(title, label, found.reshape(len(levels), len(ratios)))
    figure = draw_grid([[field]], Frame((0.7, 1.3, 0.4, 0.6), None))
    figure.axes[0].set(xlabel="frequency over that of a half-full tank [–]", ylabel="depth [m]")
    picture(figure, folder / "sloshing-filling.png")


def picture(figure: Any, path: Path) -> None:
    """Write a picture, and a small copy for the documentation."""
    save(figure, path)
    write_small(path, FIGURES / path.name)


PARTS: dict[str, Callable[[Path], None]] = {
    "errors": errors,
    "fillings": fillings,
    "noslip": noslip,
    "long": long,
    "record": record,
    "response": response,
    "filling-map": filling_map,
}


def main() -> None:
    """Run the parts that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="+", choices=PARTS)
    parser.add_argument("--out", type=Path, default=Path("runs/sloshing"))
    given = parser.parse_args()
    for name in given.parts:
        print(f"\n{name}\n")
        PARTS[name](given.out)


if __name__ == "__main__":
    main()
