"""Kill runs at random moments, resume them, and check that nothing was lost.

Each round takes an empty folder, starts a command with `--resume`, kills it with SIGINT, SIGTERM or
SIGKILL at a random moment, and starts it again until it ends by itself. After every kill no file
under an artifact's name may be damaged or differ from that of a run that was never stopped, and no
run may go on from an earlier step than it has gone on from before; at the end all artifacts have to
be equal to the bit.

    python scripts/torture.py --seconds 600 --kills 100
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from sphrom.artifacts import open_artifact
from sphrom.errors import ArtifactError

SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}
"""What kills, and the exit code that follows."""
EARLY = {signal.SIGINT: {1, -2, 130}, signal.SIGTERM: {-15, 143}, signal.SIGKILL: {-9}}
"""The codes that follow while Python itself is still starting, or already ending."""
SCHEMAS = {
    "packing": "packing", "spin": "state", "fom": "trajectory", "map": "reference-snapshots",
    "pod": "basis", "psi": "spline", "operators": "operators", "rom": "trajectory",
    "compare": "comparison",
}  # fmt: skip
GOES_ON = re.compile(r"^(\S+): goes on from its checkpoint at step (\d+) of", re.MULTILINE)


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
SCENARIOS: list[tuple[str, dict[str, Any]]] = [
    (
        "run",
        case(
            "vortex",
            "taylor-green",
            24,
            time={"final_time": 3.0},
            snapshots={"every": 4},
            parameters={"train": {"reynolds": [100]}},
            rom=ON_PARTICLES,
        ),
    ),
    (
        "run",
        case(
            "lid",
            "lid-driven-cavity",
            20,
            time={"final_time": 3.0},
            snapshots={"every": 5},
            parameters={"train": {"reynolds": [100]}},
            rom=ON_PARTICLES,
        ),
    ),
    (
        "fom",
        case(
            "channel",
            "open-cavity",
            40,
            time={"final_time": 0.5, "spin_up": 0.3},
            snapshots={"every": 5},
            rom=[],
        ),
    ),
]


@dataclass
class Score:
    """What a session of torture counts."""

    kills: Counter[str] = field(default_factory=Counter)
    resumes: int = 0
    finished: int = 0
    losses: list[str] = field(default_factory=list)


def command(stage: str, folder: Path) -> list[str]:
    """Return a command that goes on where it was stopped."""
    return [
        sys.executable, "-m", "sphrom", stage, str(folder / "case.yaml"), "--resume",
        "--checkpoint-every", "0.05", "--out", str(folder / "out"), "--threads", "1",
    ]  # fmt: skip


def digests(folder: Path) -> dict[str, str]:
    """Return what the artifacts of a folder hold, verified. Raises ArtifactError."""
    found = {}
    for path in sorted(folder.glob("*.h5")):
        schema = SCHEMAS[re.split(r"\W", path.name)[0]]
        with open_artifact(path, f"sphrom/{schema}", made_by="") as artifact:
            artifact.verify_content()
            found[path.name] = artifact.content_sha256
    return found


def prepare(folder: Path, content: dict[str, Any]) -> None:
    """Make a folder with a case file alone."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "case.yaml").write_text(yaml.safe_dump(content))


@dataclass(frozen=True)
class Whole:
    """A command that was never stopped."""

    digests: dict[str, str]
    seconds: float
    start_seconds: float
    """What it takes when everything is there."""


def uninterrupted(stage: str, content: dict[str, Any], folder: Path) -> Whole:
    """Run a command to compile, then again from nothing, and once more with everything there."""
    taken = []
    for anew in (True, True, False):
        if anew:
            prepare(folder, content)
        started = time.monotonic()
        subprocess.run(command(stage, folder), check=True, capture_output=True)
        taken.append(time.monotonic() - started)
    return Whole(digests(folder / "out"), taken[1], taken[2])


class Round:
    """One command, killed until it ends."""

    def __init__(self, stage: str, folder: Path, whole: Whole, score: Score) -> None:
        self.stage, self.folder, self.whole, self.score = stage, folder, whole, score
        self.steps: dict[str, int] = {}

    def kill_once(self, random_: random.Random) -> bool:
        """Start the command and kill it; return whether it has ended by itself."""
        process = subprocess.Popen(
            command(self.stage, self.folder), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        number = random_.choice(list(SIGNALS))
        # Anywhere, but more often while it computes than while it starts.
        start, whole = self.whole.start_seconds, self.whole.seconds
        moment = random_.triangular(0.0, start + 0.5 * (whole - start), start)
        try:
            out, errors = process.communicate(timeout=moment)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
            out, errors = process.communicate(timeout=120)
        self.look(process.returncode, number, out, errors)
        return process.returncode == 0

    def look(self, code: int, number: signal.Signals, out: str, errors: str) -> None:
        """Count, and check what is there now."""
        name = f"{self.folder.name}, {number.name}"
        if code != 0:
            self.score.kills[number.name] += 1
            if code != SIGNALS[number] and code not in EARLY[number]:
                self.score.losses.append(f"{name}: exit code {code}: {errors.strip()}")
            if "Traceback" in errors and code == SIGNALS[number]:
                self.score.losses.append(f"{name}: {errors.strip()}")
        for target, step in GOES_ON.findall(out):
            self.score.resumes += 1
            if int(step) < self.steps.get(target, 0):
                self.score.losses.append(f"{name}: {target} fell back to step {step}")
            self.steps[target] = int(step)
        try:
            there = digests(self.folder / "out")
        except ArtifactError as error:
            self.score.losses.append(f"{name}: {error}")
            return
        for artifact, digest in there.items():
            if digest != self.whole.digests[artifact]:
                self.score.losses.append(f"{name}: {artifact} differs")

    def finish(self) -> None:
        """Check the end: everything is there, and nothing else."""
        self.score.finished += 1
        if digests(self.folder / "out") != self.whole.digests:
            self.score.losses.append(f"{self.folder.name}: the artifacts at the end differ")
        left = [p.name for pattern in ("*.h5.*", ".*") for p in (self.folder / "out").glob(pattern)]
        if left:
            self.score.losses.append(f"{self.folder.name}: left behind: {', '.join(left)}")


def main() -> int:
    """Torture for a while; exit code 1 if anything was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0, help="stop killing after these")
    parser.add_argument("--kills", type=int, default=1000, help="or after so many kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the score there too")
    asked = parser.parse_args()
    random_, score = random.Random(asked.seed), Score()
    deadline = time.monotonic() + asked.seconds
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        references = [
            uninterrupted(stage, content, base / f"whole-{content['name']}")
            for stage, content in SCENARIOS
        ]
        turn = 0
        while time.monotonic() < deadline and score.kills.total() < asked.kills:
            stage, content = SCENARIOS[turn % len(SCENARIOS)]
            folder = base / content["name"]
            prepare(folder, content)
            round_ = Round(stage, folder, references[turn % len(SCENARIOS)], score)
            while not round_.kill_once(random_):
                pass
            round_.finish()
            turn += 1
            print(
                f"{content['name']}: {score.kills.total()} kills, {score.resumes} resumes, "
                f"{len(score.losses)} losses", flush=True,
            )  # fmt: skip
    for loss in score.losses:
        print(f"lost: {loss}")
    by_signal = ", ".join(f"{count} {name}" for name, count in sorted(score.kills.items()))
    print(
        f"{score.kills.total()} kills ({by_signal}), {score.resumes} resumes from checkpoints, "
        f"{score.finished} commands ended, {len(score.losses)} losses"
    )
    if asked.json:
        asked.json.write_text(json.dumps(vars(score), indent=2, default=dict))
    return 1 if score.losses else 0


if __name__ == "__main__":
    sys.exit(main())
