"""The rows that a stopped trade keeps are used as they were written, or not at all."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from sphrom.errors import ArtifactError
from sphrom.trade.trade import Journal


@pytest.fixture
def open_journal(tmp_path: Path):
    """Open the journal of one case, and note its warnings."""
    warnings: list[str] = []
    report = SimpleNamespace(info=lambda _: None, warn=warnings.append)

    def journal(resume: bool = True) -> Journal:
        context = SimpleNamespace(report=report, resume=resume, force=False)
        workspace = SimpleNamespace(
            folder=lambda _: tmp_path, context=context, case_text="case", threads=1
        )
        return Journal(workspace, ())

    return journal, warnings


def test_measured_seconds_are_kept(open_journal) -> None:
    journal, warnings = open_journal
    journal().seconds("full", lambda: 0.1 + 0.2)
    assert journal().seconds("full", lambda: 9.0) == 0.1 + 0.2
    assert not warnings
    with pytest.raises(ArtifactError, match="a trade was stopped after 1 rows"):
        journal(resume=False)


@pytest.mark.parametrize(("old", "new"), [("1.25", "1.75"), ("1.25", "null"), ("full", "fool")])
def test_rows_that_were_changed_are_found_again(open_journal, tmp_path, old, new) -> None:
    journal, warnings = open_journal
    journal().seconds("full", lambda: 1.25)
    path = tmp_path / "progress.json"
    path.write_text(path.read_text().replace(old, new))
    assert journal().seconds("full", lambda: 9.0) == 9.0
    assert warnings == [f"{path} is of another case or damaged: not used"]


def test_a_write_that_was_killed_leaves_nothing_in_the_end(open_journal, tmp_path) -> None:
    journal, _ = open_journal
    journal().remove()  # There is nothing to remove yet.
    (tmp_path / ".progress.json.123.tmp").write_text("{")
    kept = journal()
    kept.seconds("full", lambda: 1.25)
    (tmp_path / ".progress.json.456.tmp").write_text("{")
    kept.remove()
    assert not list(tmp_path.iterdir())
