"""What the program shows goes through one place, which makes control characters visible."""

from __future__ import annotations

import ast
from pathlib import Path

import sphrom

ROOT = Path(sphrom.__file__).parent
CONSOLE = "console.py"
OWN_TEXTS = {"cli/cases.py": 2}
"""Where the program prints a case, a template or a schema."""
WRITERS = ("print", "echo", "secho", "print_exc", "print_exception")
STREAMS = ("stdout", "stderr")


def calls(path: Path) -> list[str]:
    """Return what a module calls to write to the terminal."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            owner = getattr(getattr(node.func, "value", None), "attr", "")
            if name in WRITERS or (name.startswith("write") and owner in STREAMS):
                found.append(name)
    return found


def test_only_the_console_writes_to_the_terminal():
    modules = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}
    found = {name: len(calls(path)) for name, path in modules.items()}
    assert found.pop(CONSOLE) > 0
    assert {name: number for name, number in found.items() if number} == OWN_TEXTS
