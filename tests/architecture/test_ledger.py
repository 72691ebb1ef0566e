"""The ledger of equations and the table of faults are complete, and what they name exists."""

from __future__ import annotations

import ast
import json
import pkgutil
import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from sphrom.case.loader import load_case

ROOT = Path(__file__).parents[2]
NUMBERS = [
    *(f"2.{n}" for n in range(1, 20)),
    *(f"3.{n}" for n in range(1, 24)),
    *(f"Alg. 3.{n}" for n in range(1, 6)),
    *(f"4.{n}" for n in range(1, 6)),
]
CASE = """
name: small
scene:
  kind: taylor-green
parameters:
  train:
    reynolds: [100]
rom:
  - name: galerkin
"""
FAULT = re.compile(r"^\| (?!fault|---)(.+?) \| (.+?) \| (.+?) \|$", re.MULTILINE)
TEST = re.compile(r"`((?:\w+/)?test_\w+\.py)::(test_\w+)`")
QUOTED = re.compile(r"`([^`]+)`")


class Row(NamedTuple):
    equation: str
    what: str
    function: str
    test: str
    deviation: str


def ledger() -> str:
    return (files("sphrom") / "equations.md").read_text(encoding="utf-8")


def rows() -> list[Row]:
    lines = [line for line in ledger().splitlines() if re.match(r"\| (Alg\. )?\d+\.\d+ \|", line)]
    return [Row(*(cell.strip() for cell in line.strip("|").split("|"))) for line in lines]


@cache
def functions_of(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_number_is_there_once_with_its_meaning_function_and_test() -> None:
    assert [row.equation for row in rows()] == NUMBERS
    for row in rows():
        assert row.what, row
        assert row.deviation, row
        assert QUOTED.findall(row.function), row
        assert QUOTED.findall(row.test), row


def test_functions_exist() -> None:
    for name in {name for row in rows() for name in QUOTED.findall(row.function)}:
        assert name.startswith("sphrom.")
        assert pkgutil.resolve_name(name).__module__.startswith("sphrom.")


def test_tests_exist() -> None:
    for row in rows():
        assert all(name.startswith("tests/") for name in QUOTED.findall(row.test)), row
    for name in re.findall(r"`(tests/[^`]+)`", ledger()):
        path, _, function = name.partition("::")
        assert (ROOT / path).is_file(), name
        assert function.startswith("test_"), name
        assert function in functions_of(ROOT / path), name


def test_every_fault_has_a_test_that_is_there() -> None:
    faults = FAULT.findall((ROOT / "tests" / "FAULTS.md").read_text(encoding="utf-8"))
    assert len(faults) > 35
    for fault, what_happens, tests in faults:
        named = TEST.findall(tests)
        assert what_happens
        assert named, fault
        for file, test in named:
            assert test in functions_of(ROOT / "tests" / file), f"{fault}: {file} has no {test}"


def test_options_are_keys_of_the_case(tmp_path: Path) -> None:
    """The first table's keys, with the values that they have and can have in a case file."""
    found = re.findall(r"^\| `([a-z_.\[\]]+)` \| `([\w-]+)`.*\| `(\w+)`", ledger(), re.MULTILINE)
    assert len(found) == 12
    path = tmp_path / "case.yaml"
    for key, printed, default in found:
        kind = "taylor-green" if key.startswith("scene.") else "lid-driven-cavity"
        path.write_text(CASE.replace("taylor-green", kind), encoding="utf-8")
        override = f"{key.replace('[]', '.0')}={printed}"
        for overrides, expected in (((), default), ((override,), printed)):
            value = load_case(path, overrides)
            for name in key.replace("[]", "").split("."):
                value = getattr(value[0] if isinstance(value, tuple) else value, name)
            assert json.dumps(value).strip('"') == expected, key
