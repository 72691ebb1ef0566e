"""Build sdist and wheel, install the wheel for some Pythons, and use it in an empty folder.

    python scripts/try_wheel.py python3.11 python3.12 python3.13

The wheel is built from the sdist, installed with the versions of `constraints.txt` that it carries,
and runs what the README says: a case of its own, one of those that come with it, and Python. Each
Python takes a fresh environment, which needs a package index.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COMMANDS = (
    ("sphrom", "--version"),
    ("sphrom", "case", "new", "taylor-green", "-o", "vortex.yaml"),
    ("sphrom", "case", "check", "vortex.yaml"),
    ("sphrom", "case", "examples"),
    ("sphrom", "case", "examples", "taylor_green_demo"),
    ("sphrom", "run", "taylor_green_demo.yaml", "--set", "discretization.resolution=20",
     "--set", "discretization.smoothing_length_ratio=2.0", "--set", "time.final_time=0.1"),
    ("python", "-c", "import sphrom; print(sphrom.open('runs/taylor_green_demo/pod.h5').sizes)"),
    ("sphrom", "export", "taylor_green_demo.yaml", "--set", "discretization.resolution=20",
     "--set", "discretization.smoothing_length_ratio=2.0", "--set", "time.final_time=0.1"),
)  # fmt: skip
CLEAN = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}


def call(*command: object, **options: object) -> None:
    """Run a command that has to end well within ten minutes."""
    print("$", *command, flush=True)
    words = [str(word) for word in command]
    subprocess.run(words, check=True, timeout=600, env=CLEAN, **options)  # type: ignore[call-overload]


def environment(python: str, folder: Path) -> Path:
    """Make a virtual environment, and return the folder of its programs."""
    call(python, "-m", "venv", folder)
    return folder / "bin"


def built(folder: Path) -> Path:
    """Return a wheel that is built from an sdist, and the sdist is kept beside it."""
    programs = environment(sys.executable, folder / "builder")
    call(programs / "python", "-m", "pip", "install", "--quiet", "setuptools>=77")
    backend = "import sys, setuptools.build_meta as b; print(getattr(b, sys.argv[1])(sys.argv[2]))"
    call(programs / "python", "-c", backend, "build_sdist", folder, cwd=ROOT)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "source", filter="data")
    (source,) = (folder / "source").iterdir()
    source = source.rename(folder / "source" / "sphrom")
    call(programs / "python", "-c", backend, "build_wheel", folder, cwd=source)
    (wheel,) = folder.glob("*.whl")
    # An editable install has to work beside a folder that is called like the package.
    call(programs / "python", "-m", "pip", "install", "--quiet", "--no-deps",
         "--no-build-isolation", "-e", source)  # fmt: skip
    call(programs / "python", "-c", "import sphrom; print(sphrom.__version__)", cwd=source.parent)
    return wheel


def try_wheel(wheel: Path, python: str, folder: Path) -> None:
    """Install a wheel for a Python, and use it in an empty folder."""
    programs = environment(python, folder / "environment")
    with zipfile.ZipFile(wheel) as archive:
        (folder / "constraints.txt").write_bytes(archive.read("sphrom/constraints.txt"))
    call(programs / "python", "-m", "pip", "install", "--quiet", "-c", folder / "constraints.txt",
         wheel)  # fmt: skip
    empty = folder / "empty"
    empty.mkdir()
    for program, *arguments in COMMANDS:
        call(programs / program, *arguments, cwd=empty)


def main() -> None:
    """Try all Pythons that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pythons", nargs="*", default=[sys.executable])
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        wheel = built(folder)
        for number, python in enumerate(parser.parse_args().pythons):
            (folder / str(number)).mkdir()
            try_wheel(wheel, python, folder / str(number))
            print(f"{wheel.name} works with {python}")


if __name__ == "__main__":
    main()
