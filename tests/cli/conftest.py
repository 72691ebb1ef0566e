from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import Result

from sphrom.setup.context import StageContext
from sphrom.stages import STAGES


@pytest.fixture
def sphrom(
    sphrom: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., Result]:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return sphrom


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[StageContext]]:
    """Put a recorder in the place of every stage; a test may make it raise."""
    called: dict[str, list[StageContext]] = {name: [] for name in STAGES}
    for name in STAGES:
        stage = ModuleType(f"sphrom.recorder_{name}")
        note = called[name].append
        stage.run = lambda context, note=note, **_: note(context)  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, stage.__name__, stage)
        monkeypatch.setitem(STAGES, name, f"recorder_{name}")
    return called


@pytest.fixture
def case_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(
        "name: small\nscene: {kind: taylor-green}\n"
        "parameters: {train: {reynolds: [100, 200]}, test: {reynolds: [150]}}\n"
    )
    return path
