"""The built pages in a browser: the first screen, the sidebar, and where searches lead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
SCREEN = 800
"""Height of a small screen [pixels]."""
PICTURE_WITHIN = 770
"""The first page shows a picture above this line [pixels]."""
QUERIES = {
    "uncertainty": "uncertainty.html",
    "GPU": "speed.html",
    "speedup": "fast-models.html#what-it-costs",
    "Monte Carlo": "uncertainty.html",
    "surrogate model": "fast-models.html",
    "digital twin": "portable.html",
    "inverse problem": "fitting.html",
    "optimization": "recipes.html#optimise-with-scipy",
    "control": "tutorials/control.html",
    "docker": "installing.html",
    "real-time": "portable.html#a-page-that-answers",
    "DualSPHysics": "other-programs.html#runs-of-other-programs",
    "neural network": "rivals.html",
    "restart": "stopping.html",
    "slurm": "cluster.html",
    "how many modes": "modes.html",
    "free surface": "free-surfaces.html",
    "drag": "forces.html",
    "final_time": "case-file.html#time",
    "n_modes": "case-file.html#rom",
    "Study": "python/study.html",
    "pressure": "fast-models.html#pressure",
    "uncert": "uncertainty.html",
    "turbulence": "method.html#what-it-cant-do",
}
"""The first result of a query. Some words are on no page, and one is typed in part."""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages, built once; every warning is an error."""
    pytest.importorskip("sphinx")
    folder = tmp_path_factory.mktemp("pages")
    subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", ROOT / "docs", folder],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, timeout=1200,
    )  # fmt: skip
    return folder


def results(browser: Any, built: Path, query: str) -> list[list[str]]:
    """Return the address, the title and the text of each page that a search finds."""
    browser.open(built / "search.html", query=f"?q={query.replace(' ', '+')}")
    found: list[list[str]] = browser.value(
        "[...document.querySelectorAll('#results > li')].map(row =>"
        "[row.children[0].getAttribute('href'), ...[...row.children].map(x => x.textContent)])"
    )
    assert all(address.startswith("file:") for address in browser.requests)
    assert browser.problems == []
    return found


def test_searches_lead_to_the_right_page(built, browser) -> None:
    first = {query: results(browser, built, query)[0] for query in QUERIES}
    assert {query: address for query, (address, _, _) in first.items()} == QUERIES
    assert all(title and text for _, title, text in first.values())


def test_the_changelog_is_the_last_result_and_each_result_has_a_text(built, browser) -> None:
    found = results(browser, built, "pressure")
    assert found[-1][0].startswith("changelog.html")
    assert len({address.split("#")[0] for address, _, _ in found}) == len(found) > 10
    assert all(title and text for _, title, text in found)


def test_words_that_no_page_has_are_told(built, browser) -> None:
    assert results(browser, built, "xyzzy") == []
    assert "No page has" in browser.value("document.getElementById('found').textContent")


def test_the_first_screen_has_a_model_that_runs(built, browser) -> None:
    browser.open(built / "index.html", width=1280, height=SCREEN)
    place = "document.querySelector('iframe.live').getBoundingClientRect()"
    assert browser.value(f"{place}.top") < PICTURE_WITHIN / 2
    browser.open(built / "index.html", width=400)
    assert browser.value("document.documentElement.scrollWidth") <= 400


@pytest.mark.parametrize("page", ["index", "uncertainty", "stability", "case-file"])
def test_the_sidebar_fits_a_small_screen(page: str, built: Path, browser: Any) -> None:
    browser.open(built / f"{page}.html", width=1280, height=SCREEN)
    groups = browser.value("[...document.querySelectorAll('summary')].map(x => x.textContent)")
    assert [name for name in groups if name in ("Learn", "Do", "Understand", "Look up")] == groups
    assert len(groups) == 4
    bottom = "document.querySelector('.sidebar-tree').getBoundingClientRect().bottom"
    assert browser.value(bottom) <= SCREEN
