"""Mutate what sphrom reads, and see that a user meets lines and exit codes only.

Each mutant goes through the command line within a process of its own: a case file through
`sphrom case check`, an artifact through the stage that reads it and through the reader itself,
files of other programs through `import`, a stopped run's checkpoints through `fom --resume`, tables
through `report`, and a damaged kernel cache through `map`. No mutant may show a traceback, end in
another exit code than those that the help tells, crash or hang the process, or leave a part of an
artifact behind. Damage must either be refused, or give to the bit what was there before.

    python scripts/fuzz.py --cases 1000 --artifacts 1200 --imports 300 --checkpoints 250 \\
        --tables 200 --caches 50
"""

from __future__ import annotations

import argparse
import copy
import multiprocessing
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml
from mutations import Mutation, change_bytes, change_structure, change_values, zero_chunk
from typer.testing import CliRunner

from sphrom.artifacts import open_artifact
from sphrom.cli.app import app
from sphrom.errors import SphromError
from sphrom.kernels.jit import code_cache
from sphrom.stages import STAGES

PATIENCE = 10.0
"""Seconds that a mutant may take, unless --patience says more, as on a busy machine."""
COMPILING = 300.0
"""Seconds for a process that may have to compile."""
CASE: dict[str, Any] = {
    "name": "fuzzed",
    "scene": {"kind": "taylor-green"},
    "fluid": {"mach_number": 0.1},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.08, "step": "auto"},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150]}},
    "basis": {"n_modes": 3, "subsets": {"low": {"reynolds": [100]}}},
    "psi": {"order": 3},
    "rom": [
        {"name": "galerkin", "n_modes": 3, "parameters": [150]},
        {"name": "fast", "n_modes": 3, "parameters": [150], "evaluation": "operators"},
    ],
    "compare": {"plots": False, "grid": 8, "line_points": 11},
}
READERS = {
    "packing.h5": ("packing", "fom", "fom-reynolds150.h5"),
    "fom-reynolds100.h5": ("trajectory", "map", "map-reynolds100.h5"),
    "map-reynolds200.h5": ("reference-snapshots", "pod", "pod.h5"),
    "pod.h5": ("basis", "fit-psi", "psi.h5"),
    "psi.h5": ("spline", "rom", "rom-galerkin-reynolds150.h5"),
    "operators.h5": ("operators", "rom", "rom-fast-reynolds150.h5"),
    "rom-galerkin-reynolds150.h5": ("trajectory", "compare", "compare.h5"),
    "rom-fast-reynolds150.h5": ("coordinates", "compare", "compare.h5"),
}
"""Of each artifact its schema, a stage that reads it, and what that makes of it."""
MADE_ANEW = {"rom": "rom-*"}
"""What a stage makes, where its results are made of one another's inputs."""
SCHEMAS = {"compare": "comparison"} | {
    name.partition("-")[0].removesuffix(".h5"): schema for name, (schema, *_) in READERS.items()
}
"""Of each kind of artifact, by how its name begins."""
MODULES = (
    "sphrom.case.checks",
    "sphrom.case.loader",
    "sphrom.setup.cost",
    "sphrom.exchange.import_",
    "sphrom.report.report",
    *(f"sphrom.{STAGES[name].partition(':')[0]}" for _, name, _ in READERS.values()),
)
NASTY: list[Any] = [
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**30, -(10**30), 0.0, -0.0, 1e-300, 1e300,
    float("nan"), float("inf"), -float("inf"), "", "auto", "1e-5", "nan", "../etc/passwd",
    "a\0b", "\x1b[31m", "\U0001f40c", "x" * 5000, [], {}, [[]], [None], [1] * 2000, {"a": {"b": 1}},
]  # fmt: skip
TEXTS = [
    b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\t", b": ", b"- ", b"&a ", b"*a",
    b"!!python/object:os.system",
    b"!!python/object/apply:os.system ['touch hacked']",
    b"<<: ", b"%YAML 9.9\n", b"---\n", b"...\n",
    b"|\n", b">\n", b"{", b"}", b"[", b"]", b"'", b'"', b"#", b"\r", b"\xc2\x85", b"? ", b"@", b"`",
    b"1e400", b"9" * 500, b"\n" * 200, b" " * 200, b"- - - - - - - - - - - - -\n", b"~", b".nan",
]  # fmt: skip


# Case files ---------------------------------------------------------------------------------------


def mutated_case(random_: random.Random) -> bytes:
    """Return a case file with some of its values, keys or bytes changed."""
    case = copy.deepcopy(CASE)
    for _ in range(random_.choice((0, 1, 1, 2))):
        _change_value(case, random_)
    content = yaml.safe_dump(case, sort_keys=False, allow_unicode=random_.random() < 0.5).encode()
    for _ in range(random_.choice((0, 0, 0, 1, 2, 5))):
        content = _change_text(content, random_)
    return content


def _change_value(case: dict[str, Any], random_: random.Random) -> None:
    """Change a value, drop or add a key, or put a section elsewhere."""
    container, key = random_.choice(list(_places(case)))
    action = random_.randrange(5)
    if action == 0 and isinstance(container, dict):
        container[f"{key}x"] = container.pop(key)
    elif action == 1:
        del container[key]
    elif action == 2:
        container[key] = copy.deepcopy(random_.choice(list(CASE.values())))
    elif action == 3 and isinstance(container[key], int | float):
        with suppress(OverflowError):
            container[key] *= random_.choice((-1, 0, 1e-6, 0.1, 1.0001, 3, 10, 1000, 1e9))
    else:
        container[key] = copy.deepcopy(random_.choice(NASTY))


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    keys = value if isinstance(value, dict) else range(len(value))
    for key in list(keys):
        yield value, key
        if isinstance(value[key], dict | list):
            yield from _places(value[key])


def _change_text(content: bytes, random_: random.Random) -> bytes:
    at = random_.randrange(len(content) + 1)
    upto = min(len(content), at + random_.choice((1, 1, 5, 40)))
    middle = random_.choice(
        (b"", bytes([random_.randrange(256)]), random_.choice(TEXTS), 2 * content[at:upto])
    )
    return content[:at] + middle + content[upto:]


def check_case(content: bytes, folder: Path) -> str:
    """Check a case file; return how that ended, and raise AssertionError where it shouldn't."""
    path = folder / "case.yaml"
    path.write_bytes(content)
    code = run("case", "check", path)
    assert code in (0, 2, 5), f"exit code {code}"
    assert sorted(p.name for p in folder.iterdir()) == ["case.yaml"], "something was made"
    return f"exit code {code}"


# Artifacts ----------------------------------------------------------------------------------------


MUTATIONS: dict[str, tuple[Mutation, float]] = {
    "bytes": (change_bytes, 0.35),
    "structure": (change_structure, 0.2),
    "values": (change_values, 0.2),
    "zeroed chunk": (zero_chunk, 0.1),
}
"""Ways to damage artifacts, and how often each is taken, relative to the others."""


def mutated(path: Path, random_: random.Random) -> str:
    """Damage an artifact, and return how."""
    shares = [share for _, share in MUTATIONS.values()]
    (how,) = random_.choices(list(MUTATIONS), shares)
    MUTATIONS[how][0](path, random_)
    return how


def check_artifact(folder: Path, name: str, whole: dict[str, str]) -> str:
    """Let a stage read a mutant; return how that ended, and raise AssertionError where it can't."""
    schema, stage, result = READERS[name]
    before = {path.name for path in folder.iterdir()}
    code = run(stage, folder.parent / "case.yaml", "--out", folder, "--threads", 1)
    assert code in (0, 3, 4, 5), f"exit code {code}"
    after = {path.name for path in folder.iterdir()} - before
    hidden = sorted(n for n in after if n.startswith(".") or ".h5." in n)
    assert not hidden, f"left behind: {hidden}"
    assert code in (0, 4) or result not in after, f"exit code {code}, but {result} is there"
    if code == 0:
        made = digest(folder / result, schema_of(result))
        assert made == whole[result], f"{result} differs"
    with suppress(SphromError):
        found = digest(folder / name, schema)
        assert found == whole[name], "read as if nothing had changed"
    return f"exit code {code}"


def digest(path: Path, schema: str) -> str:
    """Return the digest of an artifact, after reading all of it."""
    with open_artifact(path, f"sphrom/{schema}", made_by="") as artifact:
        for dataset in artifact.datasets:
            artifact.read(dataset)
        artifact.verify_content()
        return artifact.content_sha256


def schema_of(name: str) -> str:
    """Return the schema of an artifact with a name."""
    if name in READERS:
        return READERS[name][0]
    return SCHEMAS[name.partition("-")[0].removesuffix(".h5")]


# Files of other programs --------------------------------------------------------------------------

IMPORTED = "fom-reynolds100.h5"
OPTIONS = {
    "npz": ("--velocity", "u,v"),
    "hdf5": ("--velocity", "u,v"),
    "vtu": ("--pressure", "pressure"),
    "pvd": (),
    "vtkhdf": (),
}
"""By kind of file, what its fields are called."""


def write_foreign(whole: Path, folder: Path) -> None:
    """Write the snapshots of a run as other programs do."""
    for kind in OPTIONS:
        (folder / kind).mkdir(parents=True)
    with open_artifact(whole / IMPORTED, "sphrom/trajectory", made_by="") as run_:
        names = ("position", "velocity", "density_fluctuation")
        series = [run_.read("time"), *map(run_.read, names)]
        rho = run_.number("reference_density")
        for i, (time_, position, velocity, fluctuation) in enumerate(zip(*series, strict=True)):
            (x, y), (u, v) = position.T, velocity.T
            fields = {"x": x, "y": y, "u": u, "v": v, "rho": rho + fluctuation}
            np.savez_compressed(folder / "npz" / f"a_{i}.npz", **fields, time=time_)
            with h5py.File(folder / "hdf5" / f"a_{i}.hdf5", "w") as file:
                file.create_group("solver_data").attrs["t"] = time_
                for name, values in fields.items():
                    file[f"particles/fluid/arrays/{name}"] = values
    case = folder.parent / "case.yaml"
    assert run("export", case, "--out", whole, "--only", "reynolds=100") == 0
    for path in (whole / "export").glob("fom-reynolds100*"):
        shutil.move(path, folder / "pvd")
    for path in folder.glob("pvd/**/*.vtu"):
        shutil.copy(path, folder / "vtu")
    shutil.copy(whole / IMPORTED, folder / "vtkhdf" / "run.vtkhdf")


def check_import(folder: Path, kind: str, values: dict[str, bytes] | None) -> str:
    """Import a mutant; an archive's checksums must find what is damaged.

    `values` are those of undamaged archives, once they are known.
    """
    files = sorted((folder / kind).rglob(f"*.{kind}"))
    code = run("import", folder.parent / "case.yaml", *files, "--only", "reynolds=100", "--out",
               folder / "runs", "--threads", 1, *OPTIONS[kind])  # fmt: skip
    assert code in (0, 2, 3, 5), f"exit code {code}"
    made = folder / "runs" / IMPORTED
    assert made.exists() == (code == 0), f"exit code {code}, but {made.name} is there"
    if code == 0 and kind == "npz" and values is not None:
        assert values_of(made) == values, "other values"
    return f"exit code {code}"


def values_of(path: Path) -> dict[str, bytes]:
    """Return the bytes of the datasets of a trajectory."""
    with open_artifact(path, "sphrom/trajectory", made_by="") as artifact:
        return {name: artifact.read(name).tobytes() for name in artifact.datasets}


def fuzz_imports(count: int, seed: int, base: Path) -> Counter[str]:
    """Import mutated files of other programs, and return how often what happened."""
    whole, foreign, folder = base / "whole", base / "foreign", base / "imports"
    ended = guarded(lambda: str(write_foreign(whole, foreign)), COMPILING)
    assert ended == "None", ended

    def place(kind: str) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(foreign / kind, folder / kind)
        (folder / "runs").mkdir()
        shutil.copy(whole / "packing.h5", folder / "runs")

    place("npz")
    ended = guarded(lambda: check_import(folder, "npz", None), COMPILING)
    assert ended == "exit code 0", ended
    values = values_of(folder / "runs" / IMPORTED)
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"import {seed} {i}")
        kind = random_.choice(list(OPTIONS))
        place(kind)
        path = random_.choice(sorted((folder / kind).rglob("*.*")))
        change_bytes(path, random_)
        ended = guarded(lambda k=kind: check_import(folder, k, values))
        found[_told(f"import {i} ({path.name})", ended)] += 1
    return found


# Checkpoints --------------------------------------------------------------------------------------

LONG = ("--set", "time.final_time=0.4", "--only", "reynolds=100", "--threads", 1)


def stop_run(base: Path) -> tuple[Path, str]:
    """Kill a run between its checkpoints; return its folder, and the digest of a whole run."""
    stopped = base / "stopped"
    for folder in (base / "long", stopped):
        folder.mkdir()
        shutil.copy(base / "whole" / "packing.h5", folder)
    arguments = ("fom", base / "case.yaml", *LONG, "--out")
    ended = guarded(lambda: f"exit code {run(*arguments, base / 'long')}", COMPILING)
    assert ended == "exit code 0", ended
    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            run(*arguments, stopped, "--checkpoint-every", 0)
        os._exit(0)
    deadline = time.monotonic() + COMPILING
    while not (stopped / f"{IMPORTED}.part-4").exists() and time.monotonic() < deadline:
        time.sleep(0.001)
    os.kill(child, 9)
    os.waitpid(child, 0)
    assert (stopped / f"{IMPORTED}.checkpoint").exists()
    return stopped, digest(base / "long" / IMPORTED, "trajectory")


def check_checkpoint(folder: Path, whole: str) -> str:
    """Resume a run from damaged files."""
    code = run("fom", folder.parent / "case.yaml", *LONG, "--out", folder, "--resume")
    assert code in (0, 3), f"exit code {code}"
    if code == 0:
        assert digest(folder / IMPORTED, "trajectory") == whole, "another result"
    return f"exit code {code}"


def fuzz_checkpoints(count: int, seed: int, base: Path) -> Counter[str]:
    """Resume from mutated checkpoints, and return how often what happened."""
    stopped, whole = stop_run(base)
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"checkpoint {seed} {i}")
        folder = base / "resumed"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(stopped, folder)
        path = random_.choice(sorted(folder.glob(f"{IMPORTED}.*")))
        how = mutated(path, random_)
        ended = guarded(lambda f=folder: check_checkpoint(f, whole))
        found[_told(f"checkpoint {i} ({path.name}, {how})", ended)] += 1
    return found


# Tables -------------------------------------------------------------------------------------------


def check_tables(folder: Path) -> str:
    """Write the page of mutated tables, or none."""
    code = run("report", folder.parent / "case.yaml", "--out", folder)
    assert code in (0, 3), f"exit code {code}"
    assert (folder / "report.html").exists() == (code == 0)
    return f"exit code {code}"


def fuzz_tables(count: int, seed: int, base: Path) -> Counter[str]:
    """Report mutated tables, and return how often what happened."""
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"table {seed} {i}")
        folder = base / "tables"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(base / "whole", folder)
        path = random_.choice([folder / "compare.json", *sorted(folder.glob("tables/*.csv"))])
        change_bytes(path, random_)
        ended = guarded(lambda f=folder: check_tables(f))
        found[_told(f"table {i} ({path.name})", ended)] += 1
    return found


# Kernel caches ------------------------------------------------------------------------------------


def check_cache(folder: Path, cache: Path, whole: str) -> str:
    """Map with a damaged cache: it must cost time only."""
    result = subprocess.run(
        [sys.executable, "-m", "sphrom", "map", folder.parent / "case.yaml", "--out", folder,
         "--threads", "1"],
        capture_output=True, text=True, timeout=COMPILING, check=False,
        env={**os.environ, "SPHROM_CACHE": str(cache)},
    )  # fmt: skip
    assert "Traceback" not in result.stderr, result.stderr.splitlines()[-1]
    assert result.returncode == 0, f"exit code {result.returncode}: {result.stderr}"
    assert digest(folder / "map-reynolds100.h5", "reference-snapshots") == whole, "another result"
    return "exit code 0"


def fuzz_caches(count: int, seed: int, base: Path) -> Counter[str]:
    """Map with mutated kernel caches, and return how often what happened."""
    name = "map-reynolds100.h5"
    whole = digest(base / "whole" / name, "reference-snapshots")
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"cache {seed} {i}")
        folder, cache = base / "cached", base / "cache"
        kept = code_cache().folder
        assert kept is not None
        for place, source in (
            (folder, base / "whole"),
            (cache / kept.parent.name / kept.name, kept),
        ):
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(source, place)
        (folder / name).unlink()
        paths = [p for p in sorted(cache.rglob("*")) if p.is_file() and p.stat().st_size]
        path = random_.choice(paths)
        change_bytes(path, random_)
        ended = guarded(lambda f=folder, c=cache: check_cache(f, c, whole), COMPILING)
        found[_told(f"cache {i} ({path.name})", ended)] += 1
    return found


# The run ------------------------------------------------------------------------------------------


def run(*arguments: object) -> int:
    """Run a command within this process; what isn't an exit code is raised."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert "Traceback" not in result.output, result.output
    if result.exit_code:
        lines = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
        assert lines, "an exit code without a line"
        assert all(line.startswith("error: ") for line in lines), lines
    return int(result.exit_code)


def guarded(work: Callable[[], str], patience: float | None = None) -> str:
    """Do work in a child; return how it ended, a crash or a hang included."""
    reader, writer = multiprocessing.Pipe(duplex=False)
    child = os.fork()
    if child == 0:
        try:
            writer.send(work())
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            writer.send(f"FAULT {type(error).__name__}: {error} ({where.filename}:{where.lineno})")
        finally:
            os._exit(0)
    writer.close()
    try:
        return str(reader.recv()) if reader.poll(patience or PATIENCE) else "FAULT it hangs"
    except EOFError:
        return "FAULT it crashed"
    finally:
        with suppress(ProcessLookupError):
            os.kill(child, 9)
        os.waitpid(child, 0)


def fuzz_cases(count: int, seed: int, base: Path) -> Counter[str]:
    """Check mutated case files, and return how often what happened."""
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"case {seed} {i}")
        folder = base / "cases"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        content = mutated_case(random_)
        with chdir(folder):
            ended = guarded(lambda content=content, folder=folder: check_case(content, folder))
        found[_told(f"case {i}", ended)] += 1
    return found


def make_whole(base: Path) -> None:
    """Run the case whose artifacts are damaged."""
    (base / "case.yaml").write_text(yaml.safe_dump(CASE))
    arguments = ("run", base / "case.yaml", "--out", base / "whole", "--threads", 1)
    made = guarded(lambda: f"exit code {run(*arguments)}", COMPILING)
    assert made == "exit code 0", made


def fuzz_artifacts(count: int, seed: int, base: Path) -> Counter[str]:
    """Check mutated artifacts, and return how often what happened."""
    source = base / "whole"
    whole = {path.name: digest(path, schema_of(path.name)) for path in source.glob("*.h5")}
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"artifact {seed} {i}")
        name = random_.choice(list(READERS))
        folder = base / "mutants"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
        for path in folder.glob(MADE_ANEW.get(READERS[name][1], READERS[name][2])):
            path.unlink()
        how = mutated(folder / name, random_)
        ended = guarded(lambda n=name, f=folder: check_artifact(f, n, whole))
        found[_told(f"artifact {i} ({name}, {how})", ended)] += 1
    return found


def _told(name: str, ended: str) -> str:
    if ended.startswith("FAULT"):
        print(f"{name}: {ended}", flush=True)
        return "FAULT"
    return ended


KINDS: dict[str, tuple[int, Callable[[int, int, Path], Counter[str]]]] = {
    "cases": (1000, fuzz_cases),
    "artifacts": (1200, fuzz_artifacts),
    "imports": (300, fuzz_imports),
    "checkpoints": (250, fuzz_checkpoints),
    "tables": (200, fuzz_tables),
    "caches": (50, fuzz_caches),
}
"""What is mutated, and how often unless asked otherwise."""


def main() -> int:
    """Fuzz; exit code 1 when anything was found."""
    global PATIENCE
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for kind, (count, _) in KINDS.items():
        parser.add_argument(f"--{kind}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--patience", type=float, default=PATIENCE)
    asked = parser.parse_args()
    PATIENCE = asked.patience
    for module in MODULES:
        import_module(module)  # once, not in every child
    faults = 0
    with tempfile.TemporaryDirectory() as temporary:
        make_whole(Path(temporary))
        for kind, (_, fuzz) in KINDS.items():
            count = getattr(asked, kind)
            if count:
                found = fuzz(count, asked.seed, Path(temporary))
                told = ", ".join(f"{number} {ended}" for ended, number in sorted(found.items()))
                print(f"{count} mutated {kind}: {told}", flush=True)
                faults += found["FAULT"]
    return 1 if faults else 0


if __name__ == "__main__":
    LAYER = {"NUMBA_THREADING_LAYER": "workqueue"}
    if not LAYER.items() <= os.environ.items():  # numba has begun OpenMP, which ends children
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **LAYER})
    sys.exit(main())
