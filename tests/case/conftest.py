from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.errors import CaseError

BASE = "name: small\nscene:\n  kind: taylor-green\n"


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Case]:
    """Load a case from text that is put after the least a case needs."""

    def load_text(text: str, *overrides: str, base: str = BASE, force: bool = False) -> Case:
        path = tmp_path / "case.yaml"
        path.write_text(base + text, encoding="utf-8")
        return load_case(path, overrides, force)

    return load_text


@pytest.fixture
def refusal(load: Callable[..., Case], tmp_path: Path) -> Callable[..., list[str]]:
    """Return the lines with which a case that is loaded so is refused, without its folder."""

    def refuse(*given: Any, **changes: Any) -> list[str]:
        with pytest.raises(CaseError) as caught:
            load(*given, **changes)
        assert caught.value.exit_code == 2
        return str(caught.value).replace(f"{tmp_path}/", "").split("\n")

    return refuse
