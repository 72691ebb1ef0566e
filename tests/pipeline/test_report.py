"""The report of a case is one page that a browser shows without a network."""

from __future__ import annotations

import base64
import io
import os
import re

import numpy as np
import pytest

from sphrom.report.report import as_png


def test_report_without_figures(place, sphrom) -> None:
    swept = ("--set", "sweep={name: other, model: full, reynolds: [100]}")
    sphrom("sweep", "tiny.yaml", *swept, "--workers", "1", code=0)
    (place / "export").mkdir()
    for name in ("galerkin", "apg"):
        (place / f"model-{name}.h5").touch()
    for name in ("galerkin", "apg", "removed"):
        (place / "export" / f"model-{name}.html").touch()
    os.utime(place / "export" / "model-apg.html", (0, 0))  # the model was trained again since
    sphrom("report", "tiny.yaml", code=0)
    text = (place / "report.html").read_text()
    assert '<a href="export/model-galerkin.html">Run model-galerkin in the browser</a>' in text
    assert "model-apg" not in text
    assert "model-removed" not in text
    assert "full: 1 run, 1 complete" in text
    assert "http" not in text.replace("http-equiv", "")
    assert "No figures were drawn" in text
    for name in ("galerkin", "apg", "reynolds=150", "singular value", "fom-reynolds100.h5"):
        assert name in text
    assert "resolution: 16" in text


@pytest.mark.slow
def test_report_shows_tables_figures_training_and_trade(place, sphrom) -> None:
    figures = ("--set", "compare.plots=true")
    sphrom("compare", "tiny.yaml", *figures, "--force", code=0)
    drawn = {path.name for path in (place / "plots").iterdir()}
    for kind in ("centrelines", "errors", "fields", "overview"):
        assert {f"{kind}-reynolds{re}.png" for re in (100, 150, 200)} <= drawn
    pixels = as_png([[np.zeros((1, 1, 3), dtype=np.uint8)]])
    tables = {"training/training": "stage,estimate [%]\n1,0.25\n", "trade/models": "model\nfull\n"}
    for table, content in tables.items():
        path = place / table
        path.parent.mkdir()
        path.with_suffix(".csv").write_text(content)
        (path.parent / f"{path.parent.name}.png").write_bytes(pixels)
    sphrom("report", "tiny.yaml", *figures, code=0)
    text = (place / "report.html").read_text()
    described = re.findall(r'<img alt="([^"]+)" src="data:image/png', text)
    assert len(set(described)) == len(drawn) + 3  # and the animation's, the training's, the trade's
    assert text.count(base64.b64encode(pixels).decode()) == 2
    assert "At reynolds=150, which was not simulated for training, galerkin" in text
    # Predictions come before training.
    assert re.findall("<h3>(.*?)</h3>", text)[:3] == [f"reynolds={re}" for re in (150, 100, 200)]


@pytest.mark.parametrize(
    ("path", "content", "command"),
    [
        ("compare.json", None, "compare"),
        ("tables/errors.csv", bytes(range(256)), "compare"),
        ("trade/models.csv", b"model,error [%]\nfull\n", "trade"),
    ],
)
def test_missing_and_damaged_tables_are_said(
    place, refused, path: str, content: bytes | None, command: str
) -> None:
    (place / path).unlink(missing_ok=True)
    if content is not None:
        (place / path).parent.mkdir(exist_ok=True)
        (place / path).write_bytes(content)
    line = refused("report", "tiny.yaml")
    assert line.startswith(f"error: {place / path} is ")
    assert f"`sphrom {command} tiny.yaml" in line
    assert not (place / "report.html").exists()


@pytest.mark.slow
def test_browser_shows_the_page_and_runs_the_animation(place, sphrom, browser) -> None:
    from matplotlib.image import imread

    sphrom("report", "tiny.yaml", code=0)
    browser.open(place / "report.html", width=1100, height=1500)
    # The player has written the time of the frame that it shows.
    shown = browser.value("document.querySelector('output').textContent")
    assert re.fullmatch(r"t = [\d.e-]+ s", shown)
    shot = base64.b64decode(browser.ask("Page.captureScreenshot")["data"])
    pixels = imread(io.BytesIO(shot))[..., :3]
    # Text, lines and what could not be shown are grey; fields fill much of the window.
    assert np.mean(np.ptp(pixels, axis=2) > 0.1) > 0.1
    assert (browser.requests, browser.problems) == ([], [])


def test_pictures_scroll_on_a_phone_and_the_page_does_not(place, sphrom, browser) -> None:
    (place / "trade").mkdir(exist_ok=True)
    (place / "trade" / "models.csv").write_text("model\nfull\n")
    pixels = np.zeros((600, 900, 3), dtype=np.uint8)
    (place / "trade" / "trade.png").write_bytes(as_png([[pixels]]))
    sphrom("report", "tiny.yaml", code=0)
    browser.open(place / "report.html", width=400)
    assert browser.value("document.documentElement.scrollWidth") <= 400
    widths = "[...document.querySelectorAll('.zoom img')].map(i => i.getBoundingClientRect().width)"
    assert min(browser.value(widths)) > 700  # type of 6 points
