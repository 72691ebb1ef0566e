"""What interpolating files in time costs in accuracy, on a run of which every step is known.

A Taylor-Green vortex keeps all its steps of 1 ms. Some of them, at uneven times, are written as
another program's files, and imported again at even instants. What comes out is
compared with the steps themselves.

    python scripts/resampling.py --resolution 30 --out /tmp/resampling
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from typer.testing import CliRunner

from sphrom.artifacts import open_artifact
from sphrom.cli.app import app

Array = NDArray[np.float64]
N_STEPS, EVERY, STEP = 300, 15, 1e-3
GAPS = (5, 10, 20)
"""Steps between two files, on average: from half to one and a half of it."""
NAMES = ("time", "position", "velocity", "pressure", "density_fluctuation")


def run(*arguments: object) -> None:
    """Run a command, which has to end well."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


def write_case(path: Path, resolution: int, every: int) -> Path:
    """Write a case that keeps every so many steps."""
    case: dict[str, Any] = {
        "name": path.stem,
        "scene": {"kind": "taylor-green"},
        "discretization": {"resolution": resolution, "smoothing_length_ratio": 2.0},
        "time": {"final_time": N_STEPS * STEP, "step": STEP},
        "snapshots": {"every": every},
        "parameters": {"train": {"reynolds": [100]}},
        "rom": [{"name": "galerkin", "n_modes": 2}],
    }
    path.write_text(yaml.safe_dump(case))
    return path


def read(folder: Path) -> dict[str, Array]:
    """Read the run in a folder."""
    with open_artifact(folder / "fom-reynolds100.h5", "sphrom/trajectory", made_by="") as run_:
        return {name: run_.read(name) for name in NAMES}


def write_files(steps: dict[str, Array], kept: list[int], folder: Path) -> list[Path]:
    """Write some steps as another program's files."""
    folder.mkdir()
    for i in kept:
        (x, y), (u, v) = steps["position"][i].T, steps["velocity"][i].T
        fields = {"x": x, "y": y, "u": u, "v": v, "time": steps["time"][i]}
        fluctuation = steps["density_fluctuation"][i]
        np.savez(folder / f"a_{i:03}.npz", density_fluctuation=fluctuation, **fields)
    return sorted(folder.glob("*.npz"))


def uneven(gap: int, random: np.random.Generator) -> list[int]:
    """Return steps at uneven distances, from the first to the last."""
    kept = [0]
    while kept[-1] < N_STEPS:
        kept.append(min(N_STEPS, kept[-1] + int(random.integers(gap // 2, 3 * gap // 2 + 1))))
    return kept


def errors(found: dict[str, Array], steps: dict[str, Array], resolution: int) -> list[float]:
    """Return the errors of positions [spacings, r.m.s.], velocity and pressure [%, relative L2]."""
    truth = {name: values[::EVERY] for name, values in steps.items()}
    apart = found["position"] - truth["position"]
    apart -= np.round(apart)  # the shortest way round a box of one metre
    relative = []
    for name in ("velocity", "pressure"):
        mean = truth[name].mean(axis=1, keepdims=True)
        difference = found[name] - truth[name]
        difference -= difference.mean(axis=1, keepdims=True)
        relative.append(100.0 * np.linalg.norm(difference) / np.linalg.norm(truth[name] - mean))
    return [resolution * float(np.sqrt((apart**2).sum(axis=2).mean())), *map(float, relative)]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resolution", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("runs/resampling"))
    given = parser.parse_args()
    shutil.rmtree(given.out, ignore_errors=True)
    given.out.mkdir(parents=True)
    run("fom", write_case(given.out / "all.yaml", given.resolution, 1), "--out", given.out / "all")
    steps, random = read(given.out / "all"), np.random.default_rng(1)
    print("files, ms apart on average, position [spacings], velocity [%], pressure [%]")
    for gap in GAPS:
        kept, folder = uneven(gap, random), given.out / str(gap)
        files = write_files(steps, kept, given.out / f"files{gap}")
        case = write_case(given.out / f"every{gap}.yaml", given.resolution, EVERY)
        run("import", case, *files, "--out", folder)
        found = errors(read(folder), steps, given.resolution)
        print(len(kept), gap, *(f"{error:.2g}" for error in found))


if __name__ == "__main__":
    main()
