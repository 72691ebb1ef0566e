"""Tests wait with limits, so that none hangs for ever."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
WAITING = {"communicate", "join", "wait"}
"""Methods that wait for ever where they are given nothing."""
RUNNING = {"check_call", "check_output", "run"}
"""Functions of `subprocess` that do without a `timeout`."""


def waits(source: str) -> Iterator[int]:
    """Give the lines of calls that may wait for ever."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of, name = ast.unparse(node.func.value), node.func.attr
            given = {keyword.arg for keyword in node.keywords}
            if name in WAITING and not node.args and not given:
                yield node.lineno
            if of == "subprocess" and name in RUNNING and not given & {"timeout", None}:
                yield node.lineno


def test_every_wait_has_a_limit() -> None:
    found = {path.name: list(waits(path.read_text())) for path in TESTS.rglob("*.py")}
    assert {name: lines for name, lines in found.items() if lines} == {}
