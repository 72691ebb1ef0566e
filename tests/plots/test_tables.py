"""Tables come back as they went in, and never hold a figure that is not one."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from sphrom.errors import ArtifactError
from sphrom.plots.tables import format_figure, headings, read_csv, read_json, write_csv, write_json


@dataclass(frozen=True)
class Row:
    model: str
    n_modes: int
    velocity_peak: float | None = field(metadata={"unit": "%"})


ROWS = [Row("Galerkin, M = 5", 5, 0.1 + 0.2), Row("APG", 10, None)]


def test_files_hold_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "errors.csv"
    write_csv(path, ROWS)
    head, rows = read_csv(path, MADE_BY)
    assert head == headings(Row) == ["model", "n_modes", "velocity_peak [%]"]
    assert rows == [["Galerkin, M = 5", "5", repr(0.1 + 0.2)], ["APG", "10", ""]]
    path = tmp_path / "compare.json"
    write_json(path, {"errors": ROWS}, "vortex", 2, judged_by="means")
    found = read_json(path, MADE_BY, {"errors": Row})
    about = found.pop("about")
    assert (about["case"], about["threads"], about["judged_by"]) == ("vortex", 2, "means")
    assert found == {"errors": ROWS}


MADE_BY = "sphrom compare CASE"
HOSTILE = "a\x1b[2J\x7f\x9b31m\u202eb\udcff"


def test_no_file_holds_what_a_terminal_obeys(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", [Row(HOSTILE, 1, None)])
    write_json(tmp_path / "a.json", {"errors": [Row(HOSTILE, 1, None)]}, HOSTILE, 1)
    for path in tmp_path.iterdir():
        assert path.read_text().replace("\n", "").isprintable()
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["errors"][0]["model"] == document["about"]["case"] == HOSTILE
    with (tmp_path / "a.csv").open(newline="") as stream:
        assert list(csv.reader(stream))[1][0] == r"a\x1b[2J\x7f\x9b31m\u202eb\udcff"


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_is_refused_and_the_old_file_kept(tmp_path: Path, bad: float) -> None:
    path = tmp_path / "table"
    path.write_text("old")
    with pytest.raises(ValueError, match=str(bad)):
        write_json(path, {"errors": [Row("x", 1, bad)]}, "vortex", 1)
    with pytest.raises(ValueError, match=str(bad)):
        write_csv(path, [Row("x", 1, bad)])
    assert path.read_text() == "old"


def test_figures_have_three_significant_digits() -> None:
    for value, text in {
        None: "–", "APG": "APG", 90_000: "90,000", 0.0: "0", 0.12345: "0.123", 9.996: "10.0",
        123456.0: "123,000", 0.000123: "1.23e-4", 9.9999e-4: "0.00100",
    }.items():  # fmt: skip
        assert format_figure(value) == text


HEAD = b"model,n_modes,velocity_peak [%]\n"
DAMAGED_TABLES = [
    b"", HEAD, HEAD + b"a,1,2,3\n", HEAD + b"a,1,nan\n", HEAD + b"\xff,1,2\n", HEAD + b'"a,1,2\n',
    HEAD + b"a" * 200_000 + b",1,2\n",
]  # fmt: skip
DAMAGED_DOCUMENTS = [
    b"", b"[]", b'{"about": {}, "errors": [3]}', b'{"about": {"date": "\xff"}}', b"[" * 100_000,
    b'{"about": ' + b"9" * 5000 + b"}", b'{"about": {}, "errors": [{"velocity": 1e999}]}',
    b'{"about": {}, "errors": [{"model": 1, "n_modes": 1, "velocity_peak": 2.0}]}',
]  # fmt: skip


def _read_rows(path: Path, made_by: str) -> object:
    return read_json(path, made_by, {"errors": Row})


@pytest.mark.parametrize(
    ("read", "content"),
    [*((read_csv, c) for c in DAMAGED_TABLES), *((_read_rows, c) for c in DAMAGED_DOCUMENTS)],
)
def test_what_is_damaged_or_foreign_is_refused(tmp_path: Path, read, content: bytes) -> None:
    path = tmp_path / "table"
    path.write_bytes(content)
    with pytest.raises(ArtifactError) as caught:
        read(path, MADE_BY)
    assert str(caught.value).startswith(f"{path} is damaged (")
    assert str(caught.value).endswith(": make it again with `sphrom compare CASE --force`")
    assert len(str(caught.value).splitlines()) == 1
    path.unlink()
    with pytest.raises(ArtifactError, match="is missing"):
        read(path, MADE_BY)
