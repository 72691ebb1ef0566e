"""The Make file of a study, run file by file as a user would."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FAST = {"name": "fast", "evaluation": "operators", "n_modes": 3}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_a_study_is_made_file_by_file(tmp_path, case_text, request):
    case = tmp_path / "tiny.yaml"
    case.write_text(case_text(rom=[FAST], sweep__reynolds=[110, 150]))
    fragment = Path(request.config.rootpath) / "cases" / "study.mk"

    def make(*arguments: str) -> str:
        result = subprocess.run(
            ["make", "-f", fragment, "CASE=tiny.yaml", "TRAIN=100 200", "MODEL=fast",
             f"SPHROM={sys.executable} -m sphrom", *arguments],
            cwd=tmp_path, capture_output=True, text=True, timeout=900,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        return result.stdout

    def stages(text: str) -> list[str]:
        return [line.split()[3] for line in text.splitlines() if " -m sphrom " in line]

    made = stages(make("-j2"))
    assert sorted(made[:4]) == ["fom", "fom", "map", "map"]
    assert made[4:] == ["pod", "fit-psi", "operators", "sweep"]
    assert len((tmp_path / "runs/tiny/sweep-fast.csv").read_text().splitlines()) == 3
    assert stages(make()) == []
    (tmp_path / "runs/tiny/psi.h5").touch()
    assert stages(make()) == ["operators", "sweep"]
