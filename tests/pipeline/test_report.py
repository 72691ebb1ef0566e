"""The report of a case is one page that a browser shows without a network."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import numpy as np
import pytest

from sphrom.report.animation import as_png

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
WITH_FIGURES = ("--set", "compare.plots=true")


def browse(page: Path, folder: Path, *arguments: str) -> str:
    """Open a page in a headless browser that reaches no host, and return what it prints."""
    result = subprocess.run(
        [
            str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
            "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={folder}",
            "--virtual-time-budget=2000", "--window-size=1100,1500", *arguments,
            page.resolve().as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )  # fmt: skip
    return result.stdout


def test_report_shows_tables_animation_and_case(place, sphrom) -> None:
    result = sphrom("report", "tiny.yaml")
    assert result.exit_code == 0, result.output
    text = (place / "report.html").read_text()
    assert "http" not in text.replace("http-equiv", "")
    assert "No figures were drawn: compare.plots is off." in text
    assert "reynolds=150: speed above, pressure below" in text
    assert text.count("<table>") >= 5
    for name in ("galerkin", "apg", "reynolds=150", "singular value", "fom-reynolds100.h5"):
        assert name in text
    assert "resolution: 16" in text


def test_headline_comes_first_and_predictions_before_training(place, sphrom) -> None:
    figures = ("--set", "compare.plots=true")
    assert sphrom("compare", "tiny.yaml", *figures, "--force").exit_code == 0
    assert sphrom("report", "tiny.yaml", *figures).exit_code == 0
    text = (place / "report.html").read_text()
    assert '<dl class="headline">' in text.partition("<nav>")[0]
    assert "At reynolds=150, which was not simulated for training, galerkin" in text
    titles = re.findall("<h2>(.*?)</h2>", text)
    assert titles == ["Predicted", "Trained", "Errors", "Modes", "Costs", "The case"]
    headings = re.findall("<h3>(.*?)</h3>", text)
    assert headings == ["reynolds=150", "reynolds=100", "reynolds=200"]


def test_figures_are_described_in_words(place, sphrom) -> None:
    figures = ("--set", "compare.plots=true")
    assert sphrom("compare", "tiny.yaml", *figures, "--force").exit_code == 0
    assert sphrom("report", "tiny.yaml", *figures).exit_code == 0
    described = re.findall('<img alt="([^"]+)"', (place / "report.html").read_text())
    assert len(set(described)) == len(described) > 10
    overview = next(text for text in described if "reynolds=200" in text and "half-way" in text)
    assert re.search(r"apg is off by [\d.]+ % in velocity and [\d.]+ % in pressure", overview)


def test_training_is_shown_where_there_is_one(place, sphrom) -> None:
    (place / "training").mkdir()
    (place / "training" / "training.csv").write_text("stage,estimate [%]\n1,0.25\n")
    pixels = as_png(np.zeros((1, 1, 3), dtype=np.uint8))
    (place / "training" / "training.png").write_bytes(pixels)
    assert sphrom("report", "tiny.yaml").exit_code == 0
    text = (place / "report.html").read_text()
    assert "<h2>The training</h2>" in text
    assert base64.b64encode(pixels).decode() in text


def test_report_tells_errors_and_their_ranges_apart(place, sphrom) -> None:
    assert sphrom("report", "tiny.yaml").exit_code == 0
    text = " ".join((place / "report.html").read_text().split())
    first, second = (text.index(words) for words in ("the relative L2 norm over", "by Eq. 4.1,"))
    norm = text.index("pressure line relative l2 [%]")
    by_range = text.index("pressure line eq41 by field range mean [%]")
    assert first < norm < second < by_range


def test_report_holds_every_figure_that_compare_drew(place, sphrom) -> None:
    assert sphrom("compare", "tiny.yaml", *WITH_FIGURES, "--force").exit_code == 0
    assert sphrom("report", "tiny.yaml", *WITH_FIGURES).exit_code == 0
    drawn = len(list((place / "plots").glob("*.png")))
    text = (place / "report.html").read_text()
    assert drawn > 10
    assert len(re.findall(r'<img alt="[^"]*" src="data:image/png', text)) == drawn + 1


def test_figures_of_a_trade_are_shown_too(place, sphrom) -> None:
    (place / "trade").mkdir()
    (place / "trade" / "models.csv").write_text("model,error [%]\nfull,0.25\n")
    pixels = as_png(np.zeros((1, 1, 3), dtype=np.uint8))
    for name in ("trade.png", "extremes.png"):
        (place / "trade" / name).write_bytes(pixels)
    assert sphrom("report", "tiny.yaml").exit_code == 0
    text = (place / "report.html").read_text()
    assert "<td>0.250</td>" in text
    assert text.count(base64.b64encode(pixels).decode()) == 2


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed to open the page in")
def test_browser_shows_the_page_and_runs_the_animation(place, sphrom, tmp_path) -> None:
    from matplotlib.image import imread

    assert sphrom("report", "tiny.yaml").exit_code == 0
    page = place / "report.html"
    document = browse(page, tmp_path / "profile", "--dump-dom")
    # The player has written the time of the frame that it shows.
    assert re.search(r"<output>t = [\d.e-]+ s</output>", document)
    shot = tmp_path / "shot.png"
    browse(page, tmp_path / "profile", f"--screenshot={shot}")
    pixels = imread(shot)[..., :3]
    # Text, lines and what could not be shown are grey; fields fill much of the window.
    assert np.mean(np.ptp(pixels, axis=2) > 0.1) > 0.1


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed to open the page in")
@pytest.mark.parametrize("width", [400, 1280])
def test_page_is_no_wider_than_the_window(place, sphrom, tmp_path, width: int) -> None:
    assert sphrom("report", "tiny.yaml").exit_code == 0
    # A browser's window has a least width, a frame in it has none.
    text = escape((place / "report.html").read_text())
    page = tmp_path / "frame.html"
    page.write_text(
        f'<!DOCTYPE html><iframe srcdoc="{text}" width="{width}" height="900"></iframe><script>'
        "const frame = document.querySelector('iframe');"
        "frame.onload = () => { const root = frame.contentDocument.documentElement;"
        "document.title = root.clientWidth + ' holds ' + root.scrollWidth; };</script>"
    )
    document = browse(page, tmp_path / "profile", "--dump-dom")
    found = re.search(r"<title>(\d+) holds (\d+)</title>", document)
    assert found is not None
    wide, held = map(int, found.groups())
    assert width - 20 <= wide <= width  # less a bar to scroll by
    assert held <= wide


@pytest.mark.parametrize(
    ("gone", "says"),
    [
        ("compare.h5", "make it with `sphrom compare CASE`"),
        ("compare.json", "make it again with `sphrom compare CASE --force`"),
    ],
)
def test_what_is_missing_is_said(place, sphrom, gone: str, says: str) -> None:
    (place / gone).unlink()
    result = sphrom("report", "tiny.yaml")
    assert result.exit_code == 3
    assert gone in result.stderr
    assert says in result.stderr


DAMAGES = {
    "empty": lambda _: b"",
    "binary": lambda _: bytes(range(256)),
    "cut": lambda whole: whole[: len(whole) // 2 - 7],
    "not UTF-8": lambda whole: whole.replace(b"a", b"\xe4"),
    "foreign": lambda _: b"a,b\n1,2\n",
}


@pytest.mark.parametrize("name", ["compare.json", "tables/errors.csv", "tables/stages.csv",
                                  "tables/singular_values.csv", "tables/timings.csv"])  # fmt: skip
def test_damaged_tables_are_said_and_no_page_is_written(place, sphrom, name: str) -> None:
    path = place / name
    whole = path.read_bytes()
    for damage in DAMAGES.values():
        path.write_bytes(damage(whole))
        result = sphrom("report", "tiny.yaml")
        (line,) = result.stderr.splitlines()
        assert line.startswith(f"error: {path} is damaged (")
        assert line.endswith("make it again with `sphrom compare CASE --force`")
        assert result.exit_code == 3
        assert not (place / "report.html").exists()


def test_damaged_table_of_a_trade_names_the_trade(place, sphrom) -> None:
    (place / "trade").mkdir()
    (place / "trade" / "models.csv").write_text("model,error [%]\nfull\n")
    result = sphrom("report", "tiny.yaml")
    assert "make it again with `sphrom trade CASE --force`" in result.stderr
    assert result.exit_code == 3
