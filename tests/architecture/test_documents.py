"""README and the pages of `docs`: they are short enough, and what they link to is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "sphrom").glob("*.md"),
    ROOT / "tests" / "FAULTS.md",
]
LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)")


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 200


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_to_files_lead_somewhere(document: Path) -> None:
    links = LINK.findall(document.read_text(encoding="utf-8"))
    assert [link for link in links if not (document.parent / link).exists()] == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda path: path.stem)
def test_no_line_is_left_out_as_a_comment(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    assert re.findall(r"^\s*%.*", text, re.MULTILINE) == [], "a line of a page can't begin with %"


def test_names_of_the_notation_are_in_the_package() -> None:
    notation = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8")
    package = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "sphrom").rglob("*.py"))
    names = {
        part for name in re.findall(r"(?<!\})`([\w.]+)`", notation) for part in name.split(".")
    }
    assert names - set(re.findall(r"\w+", package)) == set()
