"""The start-up times of commands, and of a trained model that is opened from Python.

Trains a model of a case into --folder, unless it is there, and measures the processor time of each
part several times, in processes of their own. The least time counts. The compiled code must be kept
already: the first command on a machine compiles it.

    python scripts/bench_startup.py cases/lid_driven_cavity_demo.yaml --repeats 5

With --first, it measures the first command on a machine instead: `sphrom run` of the case with no
compiled code, then once more with the code that it compiled. The difference is the time of
compilation.

    python scripts/bench_startup.py cases/taylor_green_demo.yaml --first --repeats 3
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

import sphrom

OPENED = """
import json, sys, time
taken = {}
def part(name, repeats, do):
    started = time.process_time()
    for _ in range(repeats):
        result = do()
    taken[name] = (time.process_time() - started) / repeats
    return result
def load():
    import sphrom
    return sphrom.load(sys.argv[1])
part("import sphrom and open a model", 1, load)
model = part("open a model once more", 5, load)
values = json.loads(sys.argv[2])
part("first run with measurements", 1, lambda: model.at(**values).run().measures)
part("another run", 50, lambda: model.at(**values).run())
part("another run with measurements", 50, lambda: model.at(**values).run().measures)
print(json.dumps(taken))
"""


def processor_time(*words: str) -> float:
    """Return the processor time of a command [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(study: sphrom.Study, case: Path) -> dict[str, float]:
    """Return the processor time of each part [s]."""
    name = next(model.name for model in study.case.rom if model.from_operators)
    point = study.case.plan.points[-1]
    target = study.folder / f"rom-{name}-{point.file_label}.h5"
    target.unlink(missing_ok=True)
    module = (sys.executable, "-m", "sphrom")
    command = (*module, "rom", str(case), "--out", str(study.folder), "--quiet")
    chosen = (f"--only={name}", f"--only={point.label.replace(', ', ',')}")
    taken = {
        "sphrom --help": processor_time(*module, "--help"),
        "sphrom rom, one run": processor_time(*command, *chosen),
        "sphrom rom, nothing to do": processor_time(*command, *chosen),
    }
    opened = (sys.executable, "-c", OPENED, str(study.folder / f"model-{name}.h5"))
    values = json.dumps(point.as_dict())
    printed = subprocess.run([*opened, values], check=True, capture_output=True, text=True).stdout
    return taken | json.loads(printed)


def first_runs(case: Path) -> list[tuple[float, float]]:
    """Return elapsed and processor time [s] of a run without compiled code, and of one with it."""
    taken = []
    with TemporaryDirectory() as folder:
        os.environ["SPHROM_CACHE"] = folder
        for number in range(2):
            out = ("--out", f"{folder}/{number}", "--quiet")
            started = time.perf_counter()
            used = processor_time(sys.executable, "-m", "sphrom", "run", str(case), *out)
            taken.append((time.perf_counter() - started, used))
    return taken


def compare_first_runs(case: Path, repeats: int) -> None:
    """Print the times of first runs, and of runs with compiled code."""
    table = Table("repeat", "compiled code", "elapsed [s]", "processor time [s]")
    for repeat in range(repeats):
        for kept, row in zip(("none", "stored"), first_runs(case), strict=True):
            table.add_row(str(repeat + 1), kept, *(f"{value:.1f}" for value in row))
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--folder", type=Path, default=Path("runs/bench_startup"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--first", action="store_true")
    arguments = parser.parse_args()
    if arguments.first:
        compare_first_runs(arguments.case, arguments.repeats)
        return
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    study = sphrom.Study(arguments.case, out=arguments.folder, threads=1, quiet=True)
    study.run(until="operators")
    rows = [measure(study, arguments.case) for _ in range(arguments.repeats)]
    table = Table("part", "processor time [ms]")
    for name in rows[0]:
        table.add_row(name, f"{1e3 * min(row[name] for row in rows):.3g}")
    Console().print(table)


if __name__ == "__main__":
    main()
