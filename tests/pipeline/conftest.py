"""A small case taken through the command line, as a user would; finished once, copied by tests."""

from __future__ import annotations

import copy
import csv
import hashlib
import math
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import Result

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.setup.context import StageContext
from sphrom.sph import time_loop
from sphrom.store.workspace import Workspace
from sphrom.sweep.batches import RunRecord, SweptModel

CASE: dict[str, Any] = {
    "name": "tiny",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.08, "courant_number": 0.75},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150]}},
    "rom": [
        {"name": "galerkin", "n_modes": 3},
        {"name": "apg", "projection": "apg", "n_modes": 3},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
}
_OF_POINTS = {
    "fom": ("trajectory", "fom"),
    "map": ("reference-snapshots", "map"),
    "rom-apg": ("trajectory", "rom"),
    "rom-galerkin": ("trajectory", "rom"),
}
MADE_BY = {
    "packing.h5": ("packing", "fom"),
    "pod.h5": ("basis", "pod"),
    "psi.h5": ("spline", "fit-psi"),
    "compare.h5": ("comparison", "compare"),
    **{
        f"{name}-reynolds{re}.h5": _OF_POINTS[name] for re in (100, 150, 200) for name in _OF_POINTS
    },
}
"""Schema and command of every artifact of the case."""
ERRORS = tuple(
    f"{quantity}_{measure}_peak"
    for quantity in ("velocity", "pressure")
    for measure in ("line_eq41_by_line_range", "field_relative_l2")
)


def rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="session")
def case_text() -> Callable[..., str]:
    """The case as YAML, with sections changed by `key__of__section=value`."""

    def write(**changes: Any) -> str:
        case = copy.deepcopy(CASE)
        for path, value in changes.items():
            *sections, key = path.split("__")
            place = case
            for section in sections:
                place = place.setdefault(section, {})
            place[key] = value
        return yaml.safe_dump(case, sort_keys=False)

    return write


@pytest.fixture(scope="session")
def made(
    tmp_path_factory: pytest.TempPathFactory, sphrom: Callable[..., Result]
) -> Callable[[dict[str, Any]], Path]:
    """Run a case once a session.

    Gives the artifacts' folder, `runs/<name>`; above it are `<name>.yaml`, `stdout.txt` and
    `stderr.txt`.
    """
    folders: dict[str, Path] = {}

    def make(case: dict[str, Any]) -> Path:
        text = yaml.safe_dump(case, sort_keys=False)
        if text not in folders:
            folder = tmp_path_factory.mktemp(case["name"])
            path, out = folder / f"{case['name']}.yaml", folder / "runs" / case["name"]
            path.write_text(text)
            result = sphrom("run", path, "--out", out, "--threads", 1, "--verbose", code=0)
            (folder / "stdout.txt").write_text(result.stdout)
            (folder / "stderr.txt").write_text(result.stderr)
            folders[text] = out
        return folders[text]

    return make


@pytest.fixture(scope="session")
def finished(
    tmp_path_factory: pytest.TempPathFactory,
    case_text: Callable[..., str],
    sphrom: Callable[..., Result],
) -> tuple[Path, Result]:
    """A folder with `tiny.yaml` and, below `runs/tiny`, all that `run` makes of it."""
    folder = tmp_path_factory.mktemp("finished")
    case = folder / "tiny.yaml"
    case.write_text(case_text())
    return folder, sphrom("run", case, "--out", folder / "runs" / "tiny", "--threads", 1, code=0)


@pytest.fixture
def copied(
    made: Callable[[dict[str, Any]], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[dict[str, Any]], Path]:
    """Copy what `made` made to damage it and to work in; gives the artifacts' folder."""

    def copy_of(case: dict[str, Any]) -> Path:
        shutil.copytree(made(case).parents[1], tmp_path / "copy")
        monkeypatch.chdir(tmp_path / "copy")
        return Path("runs") / case["name"]

    return copy_of


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Any]], Path]:
    """Write nothing but a case's file into a folder to work in; gives the artifacts' folder."""

    def write(case: dict[str, Any]) -> Path:
        (tmp_path / f"{case['name']}.yaml").write_text(yaml.safe_dump(case, sort_keys=False))
        monkeypatch.chdir(tmp_path)
        return Path("runs") / case["name"]

    return write


@pytest.fixture(scope="session")
def workspace_of() -> Callable[[Path], Workspace]:
    """The workspace of an artifacts' folder of `made`."""

    class Quiet:
        info = warn = table = lambda *_: None

    def read(out: Path) -> Workspace:
        case = load_case(out.parents[1] / f"{out.name}.yaml")
        return Workspace(StageContext(case, out, False, 1, Quiet()))  # type: ignore[arg-type]

    return read


@pytest.fixture(scope="session")
def refused(sphrom: Callable[..., Result]) -> Callable[..., str]:
    """Run a command to an exit code, and return the one line that a user sees; warnings aside."""

    def line_of(*arguments: object, code: int = 3) -> str:
        text = sphrom(*arguments, code=code).stderr
        (line,) = [each for each in text.splitlines() if not each.startswith("warning: ")]
        assert line.startswith("error: ")
        return line

    return line_of


@pytest.fixture(scope="session")
def flip() -> Callable[..., None]:
    """Change one bit of a file, at a share of its length."""

    def change(path: Path, share: float = 0.5) -> None:
        content = bytearray(path.read_bytes())
        content[int(share * len(content))] ^= 0x10
        path.write_bytes(content)

    return change


@pytest.fixture
def stop_at(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Raise an exception within the step of a number, of the first run that comes to it."""
    step_taken = time_loop.watched_step

    def arrange(number: int, error: type[BaseException] = KeyboardInterrupt) -> None:
        left = [number]

        def stopped(rates: Any, state: Any, steps: Any, step: int) -> Any:
            if left and step == left[0]:
                left.clear()
                rates(state * 1.0, steps.time(step))  # within the step: neighbours were searched
                raise error
            return step_taken(rates, state, steps, step)

        monkeypatch.setattr(time_loop, "watched_step", stopped)

    return arrange


@pytest.fixture
def place(
    finished: tuple[Path, Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """A copy of the finished folder to damage, and to work in; gives the artifacts' folder."""
    shutil.copytree(finished[0], tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    yield Path("runs/tiny")
    shutil.rmtree(tmp_path / "copy")


@pytest.fixture
def empty(tmp_path: Path, case_text: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with nothing but `tiny.yaml`, to work in; gives the artifacts' folder."""
    (tmp_path / "tiny.yaml").write_text(case_text())
    monkeypatch.chdir(tmp_path)
    return Path("runs/tiny")


@pytest.fixture(scope="session")
def content() -> Callable[[Path], str]:
    """The digest of what an artifact holds, verified; of files of the same bytes, once."""
    known: dict[str, str] = {}

    def digest(path: Path) -> str:
        whole = hashlib.sha256(path.read_bytes()).hexdigest()
        if whole not in known:
            with open_artifact(path, None, made_by="") as artifact:
                artifact.verify_content()
                known[whole] = artifact.content_sha256
        return known[whole]

    return digest


@pytest.fixture(scope="session")
def digests(content: Callable[[Path], str]) -> Callable[[Path], dict[str, str]]:
    """The digests of what the artifacts of a folder hold, verified, by file name."""
    return lambda folder: {path.name: content(path) for path in sorted(folder.glob("*.h5"))}


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[ParameterPoint]:
    """The points at which sweeps make runs, in this process."""
    points: list[ParameterPoint] = []
    run = SweptModel.run

    def note(self: SweptModel, point: ParameterPoint) -> RunRecord:
        points.append(point)
        return run(self, point)

    monkeypatch.setattr(SweptModel, "run", note)
    return points


@pytest.fixture(scope="session")
def wait_for() -> Callable[..., Any]:
    """Wait until there is something, while a process runs, and return it."""

    def wait(process: subprocess.Popen[Any], found: Callable[[], Any]) -> Any:
        deadline = time.monotonic() + 600.0
        while not (there := found()):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return there

    return wait


@pytest.fixture(scope="session")
def errors_of() -> Callable[[Path], list[dict[str, str]]]:
    """The rows of the table of errors in a folder."""

    def read(folder: Path) -> list[dict[str, str]]:
        with (folder / "tables" / "errors.csv").open(newline="") as file:
            return [_without_units(row) for row in csv.DictReader(file)]

    return read


def _without_units(row: dict[str, str]) -> dict[str, str]:
    return {name.partition(" ")[0]: value for name, value in row.items()}


@pytest.fixture(scope="session")
def peaks(
    errors_of: Callable[[Path], list[dict[str, str]]],
) -> Callable[..., tuple[float, float]]:
    """The largest velocity and pressure error [%] of a model against the full run; all finite."""

    def read(folder: Path, model: str) -> tuple[float, float]:
        rows = [r for r in errors_of(folder) if (r["compared"], r["against"]) == (model, "full")]
        assert rows
        assert all(r["status"] == "complete" for r in rows)
        assert all(math.isfinite(float(r[name])) for r in rows for name in ERRORS)
        velocity, pressure = (max(float(r[name]) for r in rows) for name in ERRORS[:2])
        return velocity, pressure

    return read


@pytest.fixture(scope="session")
def made_by() -> dict[str, tuple[str, str]]:
    """Schema and command of every artifact of the case."""
    return MADE_BY
