"""Imports only go down, help loads no numerics, and only families know the kind of a model."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from sphrom.models.contract import FAMILIES

pytest.importorskip("importlinter", reason="import-linter is not installed")

ROOT = Path(__file__).parents[2]
HEAVY = ("numba", "scipy", "h5py", "matplotlib", "numpy", "xarray", "rich")


def test_the_contracts_of_the_project_hold() -> None:
    """In a process of its own: the linter leaves a terminal's settings behind."""
    code = "from importlinter import cli; raise SystemExit(cli.lint_imports(no_cache=True))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=600
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


KINDS = ("has_surface", "from_operators", "evaluation")
"""Keys and properties of a case that decide on the family of its models."""
ROOMS = ("case", "setup", "sph", *(f"models/{name}" for name in FAMILIES))
"""Where a case, the full model and a family may ask for them."""


def _asks(node: ast.AST) -> bool:
    """Whether an expression asks for the kind of a model."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id == "isinstance" and any(
            isinstance(part, ast.Name) and part.id.startswith(("Fast", "Surface", "Particle"))
            for part in ast.walk(node.args[1])
        )
    return isinstance(node, ast.Attribute) and node.attr in KINDS


def test_nothing_outside_of_a_family_branches_on_the_kind_of_a_model() -> None:
    """Doors ask for an ability (`sphrom.models.contract`)."""
    package = ROOT / "sphrom"
    paths = {path.relative_to(package).as_posix(): path for path in package.rglob("*.py")}
    found = [
        f"{name}:{node.lineno}"
        for name, path in paths.items()
        if not name.startswith(ROOMS)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if _asks(node)
    ]
    assert found == []
