"""The house stays small enough to be held in the head: ceilings of its lines and modules."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINES, MODULES, CODE_LINES = 40_700, 190, 24_800
"""Ceilings of the package."""
TEST_LINES = 25_850
LARGEST_SHARE = 0.16
"""Of a package's lines in all."""
LEFT_OUT = (ast.Import, ast.ImportFrom)


def _code_lines(text: str) -> int:
    """Return the lines that are neither blank nor part of a docstring, an import or a comment."""
    other = {
        number
        for number, line in enumerate(text.splitlines(), 1)
        if not line.strip() or line.lstrip().startswith("#")
    }
    for node in ast.walk(ast.parse(text)):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, LEFT_OUT) or (is_text and isinstance(node.value.value, str)):
            other.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(text.splitlines()) - len(other)


def _texts(folder: str) -> dict[Path, str]:
    return {path: path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob("*.py")}


def test_the_package_stays_below_its_ceilings() -> None:
    texts = {path: text for path, text in _texts("sphrom").items() if text}
    lines = {path: len(text.splitlines()) for path, text in texts.items()}
    total = sum(lines.values())
    assert total <= LINES
    assert len(texts) <= MODULES
    assert sum(map(_code_lines, texts.values())) <= CODE_LINES
    packages: Counter[str] = Counter()
    for path, count in lines.items():
        packages[path.relative_to(ROOT / "sphrom").parts[0]] += count
    ((largest, most),) = packages.most_common(1)
    assert most <= LARGEST_SHARE * total, largest


def test_the_tests_stay_below_their_ceiling() -> None:
    assert sum(len(text.splitlines()) for text in _texts("tests").values()) <= TEST_LINES
