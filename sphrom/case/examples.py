"""The cases that come with the program: demos, experiments of the paper, a gallery of flows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

from sphrom.errors import CaseError

_END_OF_CLAUSE = re.compile(r"(?<!et al)\.(?:\s|$)|;")
FOLDER = Path(__file__).parent.parent / "cases"


def examples() -> Mapping[str, Path]:
    """Return the case files by name, those of the gallery at the end."""
    found = [*sorted(FOLDER.glob("*.yaml")), *sorted(FOLDER.glob("gallery/*.yaml"))]
    return {path.stem: path for path in found}


def title(path: Path) -> str:
    """Return what a case file says of itself in its first clause."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    return _END_OF_CLAUSE.split(comment, maxsplit=1)[0]


def example(name: str) -> Path:
    """Return the case file of a name. Raises CaseError for a name that none has."""
    known = examples()
    if name not in known:
        close = get_close_matches(name, known, n=1, cutoff=0.3)
        hint = f"did you mean {close[0]}?" if close else "`sphrom case examples` lists them"
        raise CaseError(f"no case that comes with sphrom is called {name!r}; {hint}")
    return known[name]
