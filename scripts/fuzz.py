"""Mutate case files and artifacts, and see that a user meets lines and exit codes only.

Each mutant goes through the command line within a process of its own making: a case file through
`sphrom case check`, an artifact through the stage that reads it and through the reader itself. No
mutant may show a traceback, end in another exit code than those that the help tells, crash or hang
the process, or leave a part of an artifact behind. A mutant whose bytes were damaged must either be
refused, or give to the bit what the artifact gave that it was made from.

    python scripts/fuzz.py --cases 1000 --artifacts 500
"""

from __future__ import annotations

import argparse
import copy
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
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
from typer.testing import CliRunner

from sphrom.artifacts import open_artifact
from sphrom.cli.app import app
from sphrom.errors import SphromError

PATIENCE = 60.0
"""Seconds that a mutant may take."""
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
    "rom": [{"name": "galerkin", "n_modes": 3, "parameters": [150]}],
    "compare": {"plots": False, "grid": 8, "line_points": 11},
}
READERS = {
    "packing.h5": ("packing", "fom", "fom-reynolds150.h5"),
    "fom-reynolds100.h5": ("trajectory", "map", "map-reynolds100.h5"),
    "map-reynolds200.h5": ("reference-snapshots", "pod", "pod.h5"),
    "pod.h5": ("basis", "fit-psi", "psi.h5"),
    "psi.h5": ("spline", "rom", "rom-galerkin-reynolds150.h5"),
    "rom-galerkin-reynolds150.h5": ("trajectory", "compare", "compare.h5"),
}
"""Of each artifact its schema, a stage that reads it, and what that makes of it."""
SCHEMAS = {"compare": "comparison"} | {
    name.partition("-")[0].removesuffix(".h5"): schema for name, (schema, *_) in READERS.items()
}
"""Of each kind of artifact, by how its name begins."""
MODULES = (
    "sphrom.case.checks",
    "sphrom.case.loader",
    "sphrom.stages.check",
    *(f"sphrom.stages.{name.replace('-', '_')}" for _, name, _ in READERS.values()),
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


def damage_bytes(path: Path, random_: random.Random) -> None:
    """Flip bits, cut, fill, copy or insert some bytes."""
    content = bytearray(path.read_bytes())
    for _ in range(random_.choice((1, 1, 2, 8))):
        at = random_.randrange(len(content))
        if random_.random() < 0.3:  # where HDF5 has its structures
            at = random_.randrange(min(4096, len(content)))
        length = random_.choice((1, 4, 8, 64, 512))
        action = random_.randrange(6)
        if action == 0:
            content[at] ^= 1 << random_.randrange(8)
        elif action == 1:
            content[at : at + length] = bytes(len(content[at : at + length]))
        elif action == 2:
            content[at : at + length] = b"\xff" * len(content[at : at + length])
        elif action == 3:
            start = random_.randrange(len(content))
            content[at : at + length] = content[start : start + length]
        elif action == 4:
            content[at:at] = random_.randbytes(length)
        else:
            del content[random_.choice((at, at, 0)) :]
        if not content:
            break
    path.write_bytes(content)


def change_structure(path: Path, random_: random.Random) -> None:
    """Change what the file holds, as another program could."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
        )
        name = random_.choice(names)
        random_.choice(STRUCTURES)(file, name, random_)


def _replace(file: h5py.File, name: str, **dataset: Any) -> None:
    del file[name]
    file.create_dataset(name, **dataset)


def _with_nan(file: h5py.File, name: str, _: random.Random) -> None:
    values = np.array(file[name], dtype=float) if name != "case" else np.zeros(3)
    values[...] = np.nan
    _replace(file, name, data=values)


def _outside(file: h5py.File, name: str, random_: random.Random) -> None:
    kind = random_.randrange(4)
    shape = file[name].shape
    del file[name]
    if kind == 0:
        file[name] = h5py.ExternalLink("/etc/hostname", "/x")
    elif kind == 1:
        file[name] = h5py.SoftLink("/" + name)
    elif kind == 2:
        file.create_dataset(
            name, shape or (1,), "f8", external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
        )
    else:
        layout = h5py.VirtualLayout(shape or (1,), "f8")
        layout[...] = h5py.VirtualSource("/etc/hostname", "x", shape or (1,))
        file.create_virtual_dataset(name, layout)


def _attribute(file: h5py.File, _: str, random_: random.Random) -> None:
    key = random_.choice(list(file.attrs))
    value = random_.choice(
        (np.nan, -1, 0, 1e300, np.bytes_(b"\xff\0x"), np.bytes_("2.0"), "vlen", np.zeros(9), None)
    )
    del file.attrs[key]
    if value is not None:
        file.attrs[key] = value


STRUCTURES: list[Callable[[h5py.File, str, random.Random], None]] = [
    _with_nan,
    _outside,
    _attribute,
    lambda file, name, _: file.__delitem__(name),
    lambda file, name, _: _replace(file, name, data=["text", "more"]),
    lambda file, name, _: _replace(file, name, data=np.zeros(3, [("a", "f8")])),
    lambda file, name, _: _replace(file, name, data=h5py.Empty("f8")),
    lambda file, name, _: _replace(file, name, shape=(10**6, 10**6), dtype="f8", chunks=(1, 1000)),
    lambda file, name, _: _replace(
        file, name, shape=(10**12,), dtype="f8", chunks=(10**6,), compression="gzip"
    ),
    lambda file, name, _: _replace(file, name, data=np.zeros(5), compression="gzip"),
    lambda file, name, _: _replace(file, name, data=np.zeros((2, 3, 4, 5))),
    lambda file, name, _: _replace(file, name, data=np.zeros(0)),
    lambda file, name, _: _replace(file, name, data=np.zeros((3, 2), "i4")),
    lambda file, _, __: file.create_group("/".join(["deep"] * 900)),
    lambda file, _, __: file.__setitem__("loop", file["/"]),
    lambda file, _, __: file.create_dataset("link", (1,), h5py.ref_dtype),
    lambda file, name, _: None,
]


def check_artifact(folder: Path, name: str, damaged: bool, whole: dict[str, str]) -> str:
    """Let a stage read a mutant; return how that ended, and raise AssertionError where it can't."""
    schema, stage, result = READERS[name]
    before = {path.name for path in folder.iterdir()}
    code = run(stage, folder.parent / "case.yaml", "--out", folder, "--threads", 1)
    assert code in (0, 3, 4, 5), f"exit code {code}"
    after = {path.name for path in folder.iterdir()} - before
    hidden = sorted(n for n in after if n.startswith(".") or ".h5." in n)
    assert not hidden, f"left behind: {hidden}"
    assert code in (0, 4) or result not in after, f"exit code {code}, but {result} is there"
    if code == 0 and damaged:
        made = digest(folder / result, schema_of(result))
        assert made == whole[result], f"{result} differs"
    with suppress(SphromError):
        digest(folder / name, schema)
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
    return SCHEMAS[name.partition("-")[0].removesuffix(".h5")]


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


def guarded(work: Callable[[], str]) -> str:
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
        return str(reader.recv()) if reader.poll(PATIENCE) else "FAULT it hangs"
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


def fuzz_artifacts(count: int, seed: int, base: Path) -> Counter[str]:
    """Check mutated artifacts, and return how often what happened."""
    source = base / "whole"
    (base / "case.yaml").write_text(yaml.safe_dump(CASE))
    made = guarded(
        lambda: f"exit code {run('run', base / 'case.yaml', '--out', source, '--threads', 1)}"
    )
    assert made == "exit code 0", made
    whole = {path.name: digest(path, schema_of(path.name)) for path in source.glob("*.h5")}
    found: Counter[str] = Counter()
    for i in range(count):
        random_ = random.Random(f"artifact {seed} {i}")
        name = random_.choice(list(READERS))
        folder = base / "mutants"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
        (folder / READERS[name][2]).unlink()
        damaged = random_.random() < 0.6
        (damage_bytes if damaged else change_structure)(folder / name, random_)
        ended = guarded(lambda n=name, d=damaged, f=folder: check_artifact(f, n, d, whole))
        found[_told(f"artifact {i} ({name}, {'bytes' if damaged else 'structure'})", ended)] += 1
    return found


def _told(name: str, ended: str) -> str:
    if ended.startswith("FAULT"):
        print(f"{name}: {ended}", flush=True)
        return "FAULT"
    return ended


def main() -> int:
    """Fuzz; exit code 1 when anything was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--artifacts", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    for module in MODULES:
        import_module(module)  # once, not in every child
    faults = 0
    with tempfile.TemporaryDirectory() as temporary:
        for what, count, fuzz in (
            ("case files", asked.cases, fuzz_cases),
            ("artifacts", asked.artifacts, fuzz_artifacts),
        ):
            found = fuzz(count, asked.seed, Path(temporary))
            told = ", ".join(f"{number} {ended}" for ended, number in sorted(found.items()))
            print(f"{count} mutated {what}: {told}", flush=True)
            faults += found["FAULT"]
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
