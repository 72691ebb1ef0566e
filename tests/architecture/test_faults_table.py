"""The table of faults names, for each, a test that is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests" / "FAULTS.md"
ROW = re.compile(r"^\| (?!fault|---)(.+?) \| (.+?) \| (.+?) \|$", re.MULTILINE)
NAMED = re.compile(r"`((?:\w+/)?test_\w+\.py)::(test_\w+)`")


def functions_of(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_fault_has_a_test_that_is_there() -> None:
    rows = ROW.findall(TABLE.read_text(encoding="utf-8"))
    assert len(rows) > 35
    for fault, what_happens, tests in rows:
        named = NAMED.findall(tests)
        assert what_happens
        assert named, fault
        for file, test in named:
            path = ROOT / "tests" / file
            assert path.is_file(), f"{fault}: {file}"
            assert test in functions_of(path), f"{fault}: {file} has no {test}"
