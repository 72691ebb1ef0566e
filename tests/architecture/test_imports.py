"""Imports only go down, and a command line that only helps loads no numerics."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("importlinter", reason="import-linter is not installed")

ROOT = Path(__file__).parents[2]
HEAVY = ("numba", "scipy", "h5py", "matplotlib", "numpy", "xarray", "rich")


def test_the_contracts_of_the_project_hold() -> None:
    """In a process of its own: the linter leaves a terminal's settings behind."""
    code = "from importlinter import cli; raise SystemExit(cli.lint_imports(no_cache=True))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("module", ["sphrom", "sphrom.cli.app", "sphrom.errors"])
def test_the_command_line_starts_without_numerics(module: str, printed) -> None:
    code = f"import {module}, sys; print(*[m for m in {HEAVY!r} if m in sys.modules])"
    assert printed(code) == "\n"


def test_a_case_is_checked_without_kernels_and_files(tmp_path: Path, printed) -> None:
    path = tmp_path / "case.yaml"
    path.write_text("name: x\nscene: {kind: taylor-green}\n")
    code = (
        f"import sys; sys.argv = ['sphrom', 'case', 'check', {str(path)!r}, '--quiet']\n"
        "from sphrom.__main__ import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(*[m for m in ('numba', 'scipy', 'h5py', 'matplotlib', 'rich') if m in sys.modules])"
    )
    assert printed(code) == "\n"
