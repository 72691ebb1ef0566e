"""Reproduce one experiment of Rodriguez et al.: as printed and corrected, figure by figure.

Runs `cases/<scene>.yaml` and `cases/<scene>_paper.yaml`, draws the paper's figures, and writes one
page: each figure by its number, and each claim of the text beside what the runs have. Says first
how long it takes and how much disk it needs. What was stopped goes on where it was.

    python scripts/reproduce.py taylor-green
    python scripts/reproduce.py open-cavity --coarser 2

`--coarser` divides the resolution and keeps the snapshots' times; 2 is half size. What is as
printed can have a factor of its own (`--printed-coarser`).
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

import paper_docs
import paper_page

from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml, read_yaml
from sphrom.compare.figures import FOLDER
from sphrom.console import Reporter
from sphrom.errors import ResourceError, SphromError
from sphrom.kernels import ask_for_threads
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, needs, reduced_steps
from sphrom.store.workspace import Target, Workspace

CASES = Path(__file__).parent.parent / "cases"
SCENES = ("taylor-green", "lid-driven-cavity", "open-cavity")
READINGS = {"": "corrected", "_paper": "as printed"}
"""The ends of the names of both cases, and what they are."""
KEPT = {
    "results": ("compare",),
    "runs": ("fom", "pod", "fit-psi", "operators", "compare"),
    "all": ("fom", "map", "pod", "fit-psi", "operators", "rom", "compare"),
}
"""Stages whose files stay once a case's figures are drawn, by what --keep says."""
FILES = {
    "fom": ("packing.h5", "spin-up-*.h5", "fom-*.h5"),
    "map": ("map-*.h5",),
    "pod": ("pod.h5",),
    "fit-psi": ("psi.h5",),
    "operators": ("operators.h5",),
    "rom": ("rom-*.h5",),
}
DISK_LIMIT = 60.0
"""[GB]"""
UNSTABLE = 4
"""Exit code of runs that became unstable: as printed, some are."""


@dataclass(frozen=True)
class Run:
    """One of the two cases of an experiment."""

    reading: str
    file: Path
    case: Case
    out: Path

    @property
    def failure_file(self) -> Path:
        """What says why there is nothing to compare, where the full model became unstable."""
        return self.out / "unstable.txt"


def main() -> int:
    """Run an experiment and write its page."""
    arguments = _arguments()
    ask_for_threads(arguments.threads)
    try:
        runs = list(_runs(arguments))
        to_do = [run for run in runs if not _finished(run)]
        _announce(runs, to_do, arguments)
        for run in to_do:
            _run(run, arguments)
        command = _command(arguments)
        page = paper_page.write(arguments.out, arguments.scene, runs, command)
        if arguments.docs is not None:
            paper_docs.write(arguments.docs, arguments.out, arguments.scene, runs, command)
    except SphromError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(f"wrote {page}")
    return 0


def _command(arguments: argparse.Namespace) -> str:
    """Return the command that makes the same results, wherever they were put."""
    size = [] if arguments.coarser == 1.0 else [f"--coarser {arguments.coarser:g}"]
    if arguments.printed_coarser is not None and arguments.reading != "corrected":
        size += [f"--printed-coarser {arguments.printed_coarser:g}"]
    given = [f"--set {override}" for override in arguments.overrides]
    given += [f"--reading {shlex.quote(arguments.reading)}"] if arguments.reading else []
    return " ".join(["python scripts/reproduce.py", arguments.scene, *size, *given])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("--coarser", type=float, default=1.0, metavar="FACTOR")
    parser.add_argument(
        "--printed-coarser",
        type=float,
        metavar="FACTOR",
        help="for what is as printed, instead of --coarser",
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    parser.add_argument("--out", type=Path, help="folder, runs/reproduce/<scene> unless given")
    parser.add_argument("--keep", choices=KEPT, default="runs", help="what stays of each case")
    parser.add_argument("--reading", choices=list(READINGS.values()), help="of the two, only this")
    parser.add_argument("--docs", type=Path, help="also write the documentation's page there")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--disk", type=float, default=DISK_LIMIT, metavar="GB")
    parser.add_argument("--dry", action="store_true", help="say what it would cost, and stop")
    arguments = parser.parse_args()
    for name, factor in (
        ("--coarser", arguments.coarser),
        ("--printed-coarser", arguments.printed_coarser),
    ):
        if factor is not None and not 1.0 <= factor <= 10.0:
            parser.error(f"{name}: must be between 1 and 10; got {factor:g}")
    size = "" if arguments.coarser == 1.0 else f"-{arguments.coarser:g}-times-coarser"
    arguments.out = arguments.out or Path("runs/reproduce") / f"{arguments.scene}{size}"
    return arguments


def _runs(arguments: argparse.Namespace) -> Iterator[Run]:
    """Yield both cases of an experiment, coarser where that is asked for."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    for end, reading in READINGS.items():
        if arguments.reading not in (None, reading):
            continue
        source = CASES / f"{arguments.scene.replace('-', '_')}{end}.yaml"
        text, factor = source.read_text(encoding="utf-8"), arguments.coarser
        if reading == "as printed" and arguments.printed_coarser is not None:
            factor = arguments.printed_coarser
        if factor != 1.0:
            text = dump_yaml(coarser(read_yaml(text).value, factor))
        file = arguments.out / source.name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
        case = load_case(file, arguments.overrides)
        yield Run(reading, file, case, arguments.out / reading.replace(" ", "-"))


def coarser(case: dict[str, Any], factor: float) -> dict[str, Any]:
    """Return a case with fewer particles and longer steps, its snapshots at the same times."""
    resolution = round(case["discretization"]["resolution"] / factor)
    every = case["snapshots"]["every"]
    interval = every * case["time"]["step"]
    fewer = ceil(every / factor)
    return {
        **case,
        "discretization": {**case["discretization"], "resolution": resolution},
        "time": {**case["time"], "step": interval / fewer},
        "snapshots": {"every": fewer},
        "rom": [_coarser_model(model, interval, factor) for model in case["rom"]],
    }


def _coarser_model(model: dict[str, Any], interval: float, factor: float) -> dict[str, Any]:
    step = model.get("time_step")
    if not isinstance(step, float):
        return model
    return {**model, "time_step": interval / ceil(round(interval / step) / factor)}


def _finished(run: Run) -> bool:
    """Whether a case's figures are drawn from a valid comparison, or its full model is unstable."""
    if run.failure_file.is_file():
        return run.failure_file.stat().st_mtime >= run.file.stat().st_mtime
    workspace = _workspace(run)
    if workspace.reason_to_make(workspace.comparison()) is not None:
        return False
    compared = workspace.comparison().path.stat().st_mtime
    pictures = [run.out / FOLDER / f"{f.name}.png" for f in run.case.compare.figures]
    return all(p.is_file() and p.stat().st_mtime >= compared for p in pictures)


def _workspace(run: Run) -> Workspace:
    return Workspace(StageContext(run.case, run.out, False, None, Reporter(quiet=True)))


def _announce(runs: Sequence[Run], to_do: Sequence[Run], arguments: argparse.Namespace) -> None:
    """Say what it costs, in time and on disk. Raises ResourceError where that is too much."""
    kept, peak, total = 0.0, 0.0, 0.0
    for run in runs:
        disk = {name: need.disk for name, need in needs(run.case).items()}
        stays = sum(disk.get(name, 0) for name in KEPT[arguments.keep])
        peak = max(peak, kept + (sum(disk.values()) if run in to_do else stays))
        kept += stays
        seconds = _seconds(run) if run in to_do else 0.0
        total += seconds
        state = f"about {_hours(seconds)}" if run in to_do else "done"
        print(f"{run.case.name}, {run.reading}: {state}, {sum(disk.values()) / 1e9:.1f} GB, of "
              f"which {stays / 1e9:.1f} GB stay (--keep {arguments.keep})")  # fmt: skip
    print(f"in all about {_hours(total)} on one core, at most "
          f"{peak / 1e9:.1f} GB at a time")  # fmt: skip
    free = shutil.disk_usage(arguments.out).free
    if to_do and peak > 1e9 * arguments.disk:
        raise ResourceError(
            f"it would take {peak / 1e9:.1f} GB of disk, more than the {arguments.disk:g} GB that "
            "--disk allows: --keep results keeps less of the first case"
        )
    if to_do and peak > free + sum(f.stat().st_size for f in arguments.out.rglob("*.h5*")):
        raise ResourceError(
            f"it would take {peak / 1e9:.1f} GB of disk, and {free / 1e9:.1f} GB are free: choose "
            "another folder with --out"
        )
    if arguments.dry:
        raise SystemExit(0)


def _seconds(run: Run) -> float:
    """Return how long the steps that are still to do take about on one core [s]."""
    case, workspace = run.case, _workspace(run)

    def missing(target: Target) -> bool:
        return workspace.reason_to_make(target) is not None

    plan = case.plan.steps
    runs = sum(missing(workspace.full_run(point)) for point in case.plan.points)
    steps = float((plan.n_steps + plan.n_spin_up_steps) * runs)
    for model in (m for m in case.rom if not m.from_operators):
        runs = sum(missing(workspace.reduced_run(model, p)) for p in case.plan.rom_points(model))
        steps += reduced_steps(case, model) * runs
    return steps * full_seconds(case, 1) / (plan.n_steps + plan.n_spin_up_steps)


def _hours(seconds: float) -> str:
    return f"{seconds / 3600.0:.1f} hours" if seconds > 5400.0 else f"{seconds / 60.0:.0f} minutes"


def _run(run: Run, arguments: argparse.Namespace) -> None:
    """Run a case whole, draw its figures, and remove what doesn't stay."""
    began = time.time()
    options = [str(run.file), "--out", str(run.out), "--force"]
    options += [part for text in arguments.overrides for part in ("--set", text)]
    if arguments.threads:
        options += ["--threads", str(arguments.threads)]
    run.failure_file.unlink(missing_ok=True)
    told = _sphrom(["run", *options, "--resume"], (0, UNSTABLE))
    workspace = _workspace(run)
    if workspace.reason_to_make(workspace.comparison()) is None:
        _sphrom(["figures", *options], (0,))
    else:
        run.failure_file.write_text(told, encoding="utf-8")
    gone = [name for name in FILES if name not in KEPT[arguments.keep]]
    for pattern in (pattern for name in gone for pattern in FILES[name]):
        for file in run.out.glob(pattern):
            file.unlink()
    print(f"{run.case.name}: done in {_hours(time.time() - began)}")


def _sphrom(arguments: Sequence[str], allowed: Sequence[int]) -> str:
    """Run a command, and return its errors. Ends with its exit code unless that is allowed."""
    command = [sys.executable, "-m", "sphrom", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            sys.stderr.write(line)
            lines.append(line)
    if process.returncode not in allowed:
        raise SystemExit(process.returncode)
    return "".join(line for line in lines if line.startswith("error:"))


if __name__ == "__main__":
    sys.exit(main())
