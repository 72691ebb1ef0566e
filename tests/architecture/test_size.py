"""The house stays small enough to be held in the head: ceilings of its tokens and modules."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOKENS, MODULES = 354_900, 275
"""Ceilings of the package; tokens don't count lines, so that a second line costs nothing."""
TEST_LINES = 32_700
LARGEST_SHARE = 0.16
"""Of a package's tokens in all."""
LONGEST = 450
"""Lines of a module."""
SPLATS = 70
"""Ceiling of calls with a local tuple as positional arguments, which only sinks."""
LAYOUT = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
)
"""Kinds of tokens that are no code."""


def _texts(folder: str) -> dict[Path, str]:
    return {path: path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob("*.py")}


def _tokens(text: str) -> int:
    """Return the number of tokens that are no layout, docstring, import or comment."""
    skipped: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        is_docstring = is_text and isinstance(node.value.value, str)
        if is_docstring or isinstance(node, ast.Import | ast.ImportFrom):
            skipped.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    found = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(token.type not in LAYOUT and token.start[0] not in skipped for token in found)


def test_the_package_stays_below_its_ceilings() -> None:
    counts = {path: _tokens(text) for path, text in _texts("sphrom").items() if text}
    total = sum(counts.values())
    assert total <= TOKENS
    assert len(counts) <= MODULES
    assert [path.name for path in counts if len(path.read_text().splitlines()) > LONGEST] == []
    packages: Counter[str] = Counter()
    for path, count in counts.items():
        packages[path.relative_to(ROOT / "sphrom").parts[0]] += count
    ((largest, most),) = packages.most_common(1)
    assert most <= LARGEST_SHARE * total, largest


def test_the_tests_stay_below_their_ceiling() -> None:
    assert sum(len(text.splitlines()) for text in _texts("tests").values()) <= TEST_LINES


def _assigns_apart(node: ast.AST) -> bool:
    """Whether a statement assigns unrelated results of calls or attributes to several names."""
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
        and any(isinstance(value, ast.Call | ast.Attribute) for value in node.value.elts)
    )


def _is_splat(node: ast.AST) -> bool:
    """Whether a call passes a name's items as positional arguments."""
    parts = node.args if isinstance(node, ast.Call) else []
    return any(isinstance(p, ast.Starred) and isinstance(p.value, ast.Name) for p in parts)


def test_a_line_has_one_assignment() -> None:
    """Swaps and plain values may stand together; what is computed has a line of its own."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, text in _texts("sphrom").items()
        for node in ast.walk(ast.parse(text))
        if _assigns_apart(node)
    ]
    assert not found


def test_calls_name_their_arguments() -> None:
    nodes = (node for text in _texts("sphrom").values() for node in ast.walk(ast.parse(text)))
    assert sum(map(_is_splat, nodes)) <= SPLATS
