from __future__ import annotations

import pytest
from typer.testing import CliRunner

from sphrom.cli.app import app


@pytest.fixture
def complete(tmp_path, monkeypatch, case_file):
    """What bash is told that a line, as far as it is written, may go on with."""
    monkeypatch.chdir(tmp_path)

    def ask(line: str) -> list[str]:
        environment = {
            "_SPHROM_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(line.split(" ")) - 1),
        }
        result = CliRunner().invoke(app, [], prog_name="sphrom", env=environment)
        assert result.stderr == ""
        return result.stdout.split()

    return ask


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("sphrom fit-", ["fit-psi"]),
        ("sphrom sweep small.yaml --sc", ["--scheduler"]),
        ("sphrom case new open", ["open-cavity"]),
        ("sphrom fom small.yaml --set time.s", ["time.spin_up=", "time.step="]),
        ("sphrom fom small.yaml --only r", [f"reynolds={r}" for r in (100, 200, 150)]),
        ("sphrom fom missing.yaml --only r", []),
    ],
)
def test_words_are_completed(complete, line, expected):
    assert complete(line) == expected
