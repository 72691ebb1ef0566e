"""Kill commands at random moments, start them again, and check that nothing was lost.

Each round takes a folder in which what a command needs is there and what it makes is not, starts
the command, and at a random moment kills it (SIGINT, SIGTERM, SIGHUP, SIGKILL), stops it for a
while (SIGSTOP, SIGCONT) or fills its disk; then it starts it again until it ends by itself. One of
the commands is the first on a machine: it compiles. After every kill each file must be that of a
command that was never stopped, or not be there, and no run may go on from an earlier step than it
has gone on from before; at the end all has to be there, equal to the bit, and nothing else.

    python scripts/torture.py --seconds 1800 --kills 200

Disks that fill up are file systems of 20 MB, for which it has to be run as root.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import yaml

from sphrom.artifacts import open_artifact
from sphrom.errors import ArtifactError

KILLING = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9, signal.SIGHUP: -1}
"""What kills, and the exit code that follows."""
EARLY = {signal.SIGINT: {1, -2, 130}, signal.SIGTERM: {-15, 143}}
"""The codes that follow while Python itself is still starting, or already ending."""
FULL_DISK = {0, 3, 5}
"""The codes that may follow where the disk is full: a checkpoint alone does not end a run."""
DISK = "size=20M"
LONGEST = 600.0
"""Seconds after which a command counts as hanging."""
GOES_ON = re.compile(r"^(\S+): goes on from its checkpoint at step (\d+) of", re.MULTILINE)
MEASURED = re.compile(
    r"seconds|break_even|_front|speed_?up|recommend|trade/[^/]*\.(csv|png)|report\.html"
)
"""What depends on how long something took: it need not be equal from one time to the next."""
STEPS = ("--resume", "--checkpoint-every", "0.05")


def case(name: str, kind: str, resolution: int, **sections: Any) -> dict[str, Any]:
    """Return a case that takes seconds."""
    return {
        "name": name,
        "scene": {"kind": kind},
        "discretization": {"resolution": resolution},
        "compare": {"plots": False, "grid": 12, "line_points": 21},
        **sections,
    }


ON_PARTICLES = [
    {"name": "galerkin", "n_modes": 4},
    {"name": "apg", "projection": "apg", "n_modes": 4},
]
VORTEX = case(
    "vortex",
    "taylor-green",
    24,
    time={"final_time": 1.0},
    snapshots={"every": 4},
    parameters={"train": {"reynolds": [100]}},
    rom=[*ON_PARTICLES, {"name": "fast", "n_modes": 4, "evaluation": "operators"}],
    sweep={"model": "full", "reynolds": [110, 130, 150, 170, 190]},
    trade={"repeats": 1, "n_modes": [2, 3], "resolutions": [16]},
)
LID = case(
    "lid",
    "lid-driven-cavity",
    20,
    time={"final_time": 3.0},
    snapshots={"every": 5},
    parameters={"train": {"reynolds": [100]}},
    rom=ON_PARTICLES,
)
CHANNEL = case(
    "channel",
    "open-cavity",
    40,
    time={"final_time": 0.5, "spin_up": 0.3},
    snapshots={"every": 5},
    rom=[],
)


@dataclass(frozen=True)
class Scenario:
    """A command, and what is there when it starts."""

    command: str
    case: dict[str, Any]
    options: Sequence[str] = ()
    made: Sequence[str] = ("*",)
    """What it makes: patterns of files and folders in the artifacts' folder."""
    compiles: bool = False
    """Whether it finds no compiled kernels."""

    @property
    def name(self) -> str:
        """How it is called here."""
        return f"{'first ' * self.compiles}{self.command} {self.case['name']}"


SCENARIOS = (
    Scenario("run", VORTEX, STEPS),
    Scenario("run", LID, STEPS),
    Scenario("fom", CHANNEL, STEPS),
    Scenario("fom", VORTEX, STEPS, ("fom-*", "packing*"), compiles=True),
    Scenario("map", VORTEX, (), ("map-*",)),
    Scenario("pod", VORTEX, (), ("pod*",)),
    Scenario("fit-psi", VORTEX, (), ("psi*",)),
    Scenario("operators", VORTEX, (), ("operators*",)),
    Scenario("rom", VORTEX, STEPS, ("rom-*",)),
    Scenario("compare", VORTEX, (), ("compare*", "tables")),
    Scenario("sweep", VORTEX, ("--workers", "2"), ("sweep*",)),
    Scenario("trade", VORTEX, STEPS[1:], ("trade",)),
    Scenario("export", VORTEX, (), ("export",)),
    Scenario("report", VORTEX, (), ("report*",)),
)
"""In an order in which each finds what it needs of those before."""


@dataclass
class Score:
    """What a session of torture counts."""

    kills: Counter[str] = field(default_factory=Counter)
    by_command: Counter[str] = field(default_factory=Counter)
    resumes: int = 0
    finished: int = 0
    losses: list[str] = field(default_factory=list)


def leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield the numbers and texts within something, by their paths."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from leaves(item, f"{path}/{key}")
    else:
        yield path, repr(value)


def contents(folder: Path) -> dict[str, str]:
    """Return what the files of a folder hold: artifacts verified, tables value by value.

    Raises ArtifactError, OSError or ValueError where one is damaged.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if not path.is_file() or any(part.startswith(".") for part in Path(name).parts):
            continue
        if path.suffix == ".h5":
            with h5py.File(path) as file:
                schema = bytes(file.attrs["schema"]).decode()
            with open_artifact(path, schema, made_by="") as artifact:
                artifact.verify_content()
                found[name] = artifact.content_sha256
        elif path.suffix == ".json":
            found.update(leaves(json.loads(path.read_text()), name))
        elif path.suffix == ".csv":
            with path.open(newline="") as table:
                found.update(leaves(list(csv.reader(table)), name))
        elif ".h5." not in path.name:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@dataclass(frozen=True)
class Whole:
    """What a command makes that is never stopped."""

    contents: dict[str, str]
    """What it makes each time: no times, which are measured."""
    seconds: float
    start_seconds: float
    """What it takes when everything is there."""


class Place:
    """Where a scenario is run: its case, its artifacts, its compiled kernels."""

    def __init__(self, base: Path, scenario: Scenario, ready: Path | None) -> None:
        self.folder, self.scenario, self._ready = base, scenario, ready
        self.out = base / "disk" / "out"
        self.filler = base / "disk" / "filler"
        self._cache = base / "cache"

    def prepare(self) -> None:
        """Put there what the command needs, and nothing else."""
        self.filler.unlink(missing_ok=True)
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        self.forget_kernels()
        (self.folder / "case.yaml").write_text(yaml.safe_dump(self.scenario.case))
        if self._ready is not None and "*" not in self.scenario.made:
            shutil.copytree(self._ready, self.out, ignore=shutil.ignore_patterns(*OF_NO_INPUT))
            for pattern in self.scenario.made:
                for path in self.out.glob(pattern):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()

    def forget_kernels(self) -> None:
        """Compile anew."""
        shutil.rmtree(self._cache, ignore_errors=True)

    def start(self) -> subprocess.Popen[str]:
        """Start the command."""
        kernels = {"SPHROM_CACHE": str(self._cache)} if self.scenario.compiles else {}
        return subprocess.Popen(
            [
                sys.executable, "-m", "sphrom", self.scenario.command,
                str(self.folder / "case.yaml"), *self.scenario.options,
                "--out", str(self.out), *THREADS.get(self.scenario.command, ("--threads", "1")),
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, **kernels},
        )  # fmt: skip

    def fill(self) -> None:
        """Leave no room on the disk."""
        with contextlib.suppress(OSError), self.filler.open("wb", buffering=0) as stream:
            while True:
                stream.write(bytes(4096))


OF_NO_INPUT = ("trade", "export", "report*", "sweep*")
"""What no other command reads."""
THREADS = dict.fromkeys(("export", "report", "sweep"), ())
"""Commands that are not told how many threads to use."""


def uninterrupted(place: Place) -> Whole:
    """Run a command twice from nothing, and once more with everything there."""
    taken, made = [], []
    for anew in (True, True, False):
        if anew:
            place.prepare()
        started = time.monotonic()
        process = place.start()
        out, errors = process.communicate(timeout=LONGEST)
        if process.returncode != 0 and anew:
            raise SystemExit(f"{place.scenario.name} fails by itself: {out}{errors}")
        taken.append(time.monotonic() - started)
        made.append(contents(place.out))
    same = {
        name: held
        for name, held in made[0].items()
        if made[1].get(name) == held and not MEASURED.search(name)
    }
    return Whole(same, taken[1], min(taken[1:]))


class Round:
    """One command, killed until it ends."""

    def __init__(self, place: Place, whole: Whole, score: Score, ways: Sequence[str]) -> None:
        self.place, self.whole, self.score, self.ways = place, whole, score, ways
        self.steps: dict[str, int] = {}
        self.told = False
        """Whether a sweep has told in its table which runs failed, as on a full disk they do."""

    def kill_once(self, random_: random.Random) -> bool:
        """Start the command and kill it; return whether it has ended by itself."""
        way = random_.choice(self.ways)
        # Anywhere, but more often while it computes than while it starts.
        start, whole = self.whole.start_seconds, self.whole.seconds
        moment = random_.triangular(0.0, max(start, 0.7 * whole), start)
        process = self.place.start()
        try:
            out, errors = process.communicate(timeout=moment)
            way = ""
        except subprocess.TimeoutExpired:
            self.strike(process, way)
            try:
                out, errors = process.communicate(timeout=LONGEST)
            except subprocess.TimeoutExpired:
                process.kill()
                out, errors = process.communicate(timeout=LONGEST)
                self.lost(way, f"hangs: {errors.strip()}")
        self.place.filler.unlink(missing_ok=True)
        self.look(process.returncode, way, out, errors)
        return process.returncode == 0

    def strike(self, process: subprocess.Popen[str], way: str) -> None:
        """Kill the command, or do something else to it."""
        self.score.kills[way] += 1
        self.score.by_command[self.place.scenario.name] += 1
        if way == "full disk":
            self.place.fill()
        elif way == "SIGSTOP":
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            process.send_signal(signal.SIGCONT)
        else:
            process.send_signal(signal.Signals[way])

    def lost(self, way: str, what: str) -> None:
        """Note a loss."""
        self.score.losses.append(f"{self.place.scenario.name}, {way or 'alone'}: {what}")

    def look(self, code: int, way: str, out: str, errors: str) -> None:
        """Check what happened, and what is there now."""
        expected = {0}
        if way == "full disk":
            expected = FULL_DISK
        elif way not in ("", "SIGSTOP"):
            number = signal.Signals[way]
            expected = {0, KILLING[number], *EARLY.get(number, ())}
        told = code not in (1, -2)  # otherwise Python itself was still starting
        if code not in expected or (told and "Traceback" in errors):
            self.lost(way, f"exit code {code}: {errors.strip()}")
        for target, step in GOES_ON.findall(out):
            self.score.resumes += 1
            if int(step) < self.steps.get(target, 0):
                self.lost(way, f"{target} fell back to step {step}")
            self.steps[target] = int(step)
        try:
            there = contents(self.place.out)
        except (ArtifactError, OSError, ValueError, KeyError) as error:
            self.lost(way, repr(error))
            return
        self.told |= way == "full disk"
        for name, held in there.items():
            if self.told and code != 0 and name.startswith("sweep-"):
                continue
            if self.whole.contents.get(name, held) != held:
                self.lost(way, f"{name} differs")

    def finish(self) -> None:
        """Check the end: everything is there, and nothing half done."""
        self.score.finished += 1
        there = contents(self.place.out)
        gone = [name for name in self.whole.contents if name not in there]
        if gone:
            self.lost("end", f"missing: {', '.join(gone[:5])}")
        left = [p.name for pattern in ("*.h5.*", ".*") for p in self.place.out.rglob(pattern)]
        if left:
            self.lost("end", f"left behind: {', '.join(left)}")


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Mount a disk of 20 MB; give whether this user may."""
    folder.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", DISK, "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False, timeout=30)
        mounted = done.returncode == 0
    except FileNotFoundError:
        mounted = False
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=False, timeout=30)


def wanted(scenario: Scenario, asked: argparse.Namespace) -> bool:
    """Return whether a command is to be killed."""
    return not asked.only or scenario.name in asked.only


def of_its_case(scenario: Scenario) -> list[Scenario]:
    """Return the commands that need what one makes."""
    everything = scenario.made == ("*",)
    return [other for other in SCENARIOS if everything and other.case == scenario.case]


def torture(base: Path, asked: argparse.Namespace, score: Score, mounted: bool) -> None:
    """Run what never stops, then kill."""
    ways = [*(number.name for number in KILLING), "SIGSTOP", *(["full disk"] * mounted)]
    random_, chosen = random.Random(asked.seed), []
    ready: dict[str, Path] = {}
    for scenario in SCENARIOS:
        name = scenario.case["name"]
        if not any(wanted(other, asked) for other in (scenario, *of_its_case(scenario))):
            continue
        place = Place(base, scenario, ready.get(name))
        whole = uninterrupted(place)
        if name not in ready:
            ready[name] = base / f"ready-{name}"
            shutil.copytree(place.out, ready[name])
        if wanted(scenario, asked):
            chosen.append((place, whole))
        print(f"{scenario.name}: {whole.seconds:.1f} s undisturbed", flush=True)
    deadline = time.monotonic() + asked.seconds
    while time.monotonic() < deadline and score.kills.total() < asked.kills:
        place, whole = chosen[score.finished % len(chosen)]
        place.prepare()
        round_ = Round(place, whole, score, ways)
        while not round_.kill_once(random_):
            pass
        round_.finish()
        print(
            f"{place.scenario.name}: {score.kills.total()} kills, {score.resumes} resumes, "
            f"{len(score.losses)} losses", flush=True,
        )  # fmt: skip


def main() -> int:
    """Torture for a while; exit code 1 if anything was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0, help="stop killing after these")
    parser.add_argument("--kills", type=int, default=1000, help="or after so many kills")
    parser.add_argument("--only", action="append", help="such as `map vortex`; may be repeated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the score there too")
    asked = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also in a script's background
    score = Score()
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        with small_disk(base / "disk") as mounted:
            if not mounted:
                print("no disk can be mounted here: none will fill up")
            torture(base, asked, score, mounted)
    for loss in score.losses:
        print(f"lost: {loss}")
    for counter in (score.by_command, score.kills):
        print(", ".join(f"{count} {name}" for name, count in sorted(counter.items())))
    print(
        f"{score.kills.total()} kills, {score.resumes} resumes from checkpoints, "
        f"{score.finished} commands ended, {len(score.losses)} losses"
    )
    if asked.json:
        asked.json.write_text(json.dumps(vars(score), indent=2, default=dict))
    return 1 if score.losses else 0


if __name__ == "__main__":
    sys.exit(main())
