"""What a case is refused for: one line, with file, line, key and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

VORTEX = "name: small\nscene:\n  kind: taylor-green\n"
LID = "name: box\nscene:\n  kind: lid-driven-cavity\n"
BASES = {
    "vortex": VORTEX,
    "lid": LID,
    "cavity": "name: open\nscene:\n  kind: open-cavity\n",
    "three snapshots": f"{VORTEX}time: {{step: 1.0e-3, final_time: 0.02}}\n",
    "two training runs": f"{VORTEX}parameters: {{train: {{reynolds: [100, 200]}}}}\n",
    "two models": f"{VORTEX}rom: [{{name: slow}}, {{name: fast, evaluation: operators}}]\n",
    "draws": f"{LID}parameters: {{train: {{reynolds: [50, 200], lid: [0.5, 1]}}}}\n"
    "rom: [{name: fast, evaluation: operators}]\n",
}
"""The cases of the groups of `refusals.txt`."""


def refusals() -> Iterator[tuple[str, str, str]]:
    """Yield a case, the text that is added to it, and the words that refuse it."""
    group = ""
    table = Path(__file__).with_name("refusals.txt").read_text(encoding="utf-8")
    for row in filter(None, table.splitlines()[1:]):
        if row.startswith("[") and row.endswith("]") and "=>" not in row:
            group = row[1:-1]
        else:
            given, words = row.split("  =>  ")
            yield BASES[group], given.replace("\\n", "\n"), words


@pytest.mark.parametrize(("base", "given", "words"), refusals())
def test_refusals(refusal, base: str, given: str, words: str) -> None:
    text, *changes = given.split("--set ")
    (line,) = refusal(f"{text.strip()}\n", *map(str.strip, changes), base=base)
    for each in words.split(" ... "):
        assert each in line
    if not changes:
        place = re.match(r"case\.yaml:(\d+): ", line)
        assert place is not None
        assert 0 < int(place[1]) - base.count("\n") <= text.count("\n") + 1
