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
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def table_after(text: str, heading: str) -> list[list[str]]:
    """Return the cells of the first table below a heading."""
    rows = re.search(r"^\|.*?(?=\n\n)", text.split(f"\n## {heading}\n")[1], re.DOTALL | re.M)
    assert rows is not None
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows[0].splitlines()]


def test_the_readme_and_the_first_page_show_the_same_program_and_table() -> None:
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/index.md")]
    programs = [re.search(r"```python\n.*?```\n\n```text.*?```", page, re.DOTALL) for page in pages]
    assert len({program and program[0] for program in programs}) == 1
    readme, first_page = (table_after(page, "Accuracy and speed") for page in pages)
    assert readme == first_page


def test_figures_of_the_readme_are_those_of_the_page_on_other_methods() -> None:
    rivals = (ROOT / "docs" / "rivals.md").read_text(encoding="utf-8")
    scenes = [table_after(rivals, scene) for scene in ("Taylor-Green", "Lid-driven cavity")]
    vortex, cavity = ({row[0].split(", pressure")[0]: row[1:] for row in rows} for rows in scenes)
    readme = table_after((ROOT / "README.md").read_text(encoding="utf-8"), "Accuracy and speed")
    columns = [(vortex, "Re 150"), (vortex, "Re 400"), (cavity, "Re 150"), (cavity, "Re 300")]
    for name, *cells in readme[2:]:
        stated = [table[name][table["ten modes"].index(column)] for table, column in columns]
        last = [table[name][table["ten modes"].index("one run [ms]")] for table in (vortex, cavity)]
        times = ", ".join(f"{float(time):g}" for time in last if time)
        assert cells == [*stated, vortex[name][-1], times]


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
