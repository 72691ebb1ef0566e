"""Clauses that have to be read twice don't come back.

Texts are docstrings, comments and messages of the package, its pages, those of `docs`, and README;
code, formulas and headings are left out. A headless "what" is one that asks no indirect question,
that is, each "what" but those right after a verb such as "says" or a preposition.
"""

from __future__ import annotations

import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = re.compile(
    r"```.*?```|\$\$.*?\$\$|`[^`]*`|\$[^$\n]*\$|\]\([^)]*\)|^#+ .*?$|^\([\w-]+\)=$", re.S | re.M
)
QUOTES = re.compile(r"^[rfbu]*[\"']+|[\"']+$|^#+")
KINDS = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
ASKING = (
    "says?|said|sees?|saw|shows?|know|knows|known|tells?|told|asks?|explains?|describes?|about|on"
)
CEILINGS = {
    ("sphrom", "what"): 0,
    ("docs", "what"): 0,
    ("sphrom", "those that"): 6,
    ("docs", "those that"): 0,
}
"""Matches that are left in each folder."""
HEADLESS = {
    "what": re.compile(rf"(?<!\w)(?:(?:{ASKING}) what|(what))\b", re.IGNORECASE),
    "those that": re.compile(r"\b(those that)\b", re.IGNORECASE),
}
PATTERNS = {
    r"\bwhat (?:is|are) no\b|\b(?:is|are) no \w+'s\b": "Name the thing, and say what it is.",
    r"(?:^|[.:;] )(?:Whose|Whom) ": "A sentence begins with its subject.",
    r"(?:^|[.:;] )Of (?:what|which|more|whom)\b": "A sentence begins with its subject.",
    r"\b(?:is|are|was|were) had\b|\bcan be had\b": "A result is obtained or computed, not had.",
    r"\btold so\b": "Say who is told what.",
    r"\bfare[ds]?\b": "Say how large the error is.",
    r"\bheld against\b": "Figures are compared with each other.",
    r"\bas if it were none\b|\bof [a-z]+s none\b": "Say what happens without any.",
    r"\bfor a reason\b": "Give the reason.",
    r"\bleans?\b|\bleaned\b": "Say depends on, or uses.",
    r"\bnothing ever\b|\bmeans nothing\b": "Say that it has no effect, or is refused.",
    r"\bnot? asked after\b|\bisn't asked after\b": "Say which values aren't read.",
    r"\bis what is\b|\bwhat is what\b": "Name the subject.",
}


@cache
def _texts(folder: str) -> dict[str, str]:
    """Return the words of each file, on one line."""
    files = [ROOT / "README.md"] if folder == "docs" else []
    files += [p for end in ("md", "py") for p in (ROOT / folder).rglob(f"*.{end}")]
    return {str(path.relative_to(ROOT)): " ".join(_words(path).split()) for path in files}


def _words(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        text = " ".join(QUOTES.sub("", token.string) for token in tokens if token.type in KINDS)
    return CODE.sub(" ", text)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_no_text_has_to_be_read_twice(pattern: str) -> None:
    texts = (_texts("sphrom") | _texts("docs")).items()
    found = [
        f"{name}: ...{text[max(0, match.start() - 40) : match.end() + 40]}..."
        for name, text in texts
        for match in re.finditer(pattern, text)
    ]
    assert found == [], PATTERNS[pattern]


@pytest.mark.parametrize(("folder", "words"), CEILINGS)
def test_headless_clauses_become_fewer(folder: str, words: str) -> None:
    found = [len([m for m in HEADLESS[words].findall(t) if m]) for t in _texts(folder).values()]
    assert sum(found) <= CEILINGS[folder, words]
