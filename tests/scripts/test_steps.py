"""How much a run depends on its step: nothing with the step that it has."""

from __future__ import annotations

import sys

import pytest

from sphrom.case.loader import load_case
from sphrom.console import Reporter
from sphrom.models import fom
from sphrom.setup.context import StageContext

pytestmark = pytest.mark.slow
CASE = """
name: cavity
scene: {kind: lid-driven-cavity}
discretization: {resolution: 12}
time: {SPIN_UP, final_time: 0.2, step: 5.0e-3}
snapshots: {every: 4}
parameters: {train: {reynolds: [50, 100]}}
rom: []
"""


@pytest.fixture(params=["", "spin_up: 0.1"], ids=["from rest", "after a spin-up"])
def stored(request, tmp_path):
    file = tmp_path / "case.yaml"
    file.write_text(CASE.replace("SPIN_UP, ", f"{request.param}, " if request.param else ""))
    fom.run(StageContext(load_case(file), tmp_path / "runs", False, None, Reporter(quiet=True)))
    return file, tmp_path / "runs"


def test_differences_vanish_with_the_step_of_the_stored_run(stored, capsys, monkeypatch, script):
    def differences(*options: str) -> dict[str, float]:
        command = ["steps.py", *map(str, stored), "--reynolds", "100", *options]
        monkeypatch.setattr(sys, "argv", command)
        assert script("steps").main() == 0
        lines = capsys.readouterr().out.splitlines()
        return {words[0]: float(words[-1]) for line in lines if len(words := line.split()) == 2}

    same = differences("--step", "5e-3")
    shorter = differences("--step", "1e-3", "--until", "0.16")
    assert set(same.values()) == {0.0}
    assert all(0.0 < value < 5.0 for value in shorter.values())
