"""What pages and README show of case files is accepted as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from sphrom.case.loader import load_case

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"```yaml\n(.*?)```", re.DOTALL)
LEAST: dict[str, Any] = {"name": "shown", "scene": {"kind": "taylor-green"}}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHOWN = [
    pytest.param(fence[1], id=f"{page.relative_to(ROOT)}-{number}")
    for page in PAGES
    for number, fence in enumerate(FENCE.finditer(page.read_text(encoding="utf-8")), 1)
]


@pytest.mark.parametrize("text", SHOWN)
def test_a_case_that_a_page_shows_is_one(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    shown = yaml.safe_load(text)
    load_case({**LEAST, **shown}, {}, force=False)
