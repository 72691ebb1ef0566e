"""Make the model's page with which the documentation begins, and the animation of README.

python scripts/live_page.py    needs chromium; writes docs/static/model-fast.html and
                               docs/figures/live.webp
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from browser import Browser
from PIL import Image

ROOT = Path(__file__).parents[1]
CASE = ROOT / "cases" / "gallery" / "kolmogorov.yaml"
RUNS = ROOT / "runs" / "pictures" / "kolmogorov"
PAGE = ROOT / "docs" / "static" / "model-fast.html"
PICTURE = ROOT / "docs" / "figures" / "live.webp"
EXPORT = ("--only", "fast", "--to", "page", "--columns", "64", "--into", PAGE.parent)
SIZE = {"width": 960, "height": 640}
LEAST, LARGEST, BEYOND = 18, 32, 39
"""Reynolds numbers at both ends of the trained range, and at the end of the slider."""
FRAME = 90
"""Duration of a picture [ms]."""
QUALITY = 80


def sphrom(*words: object) -> None:
    """Run a command."""
    call = [sys.executable, "-m", "sphrom", *map(str, words)]
    subprocess.run(call, check=True, cwd=ROOT)


def states() -> Iterator[tuple[float, float, int]]:
    """Yield the Reynolds number, the share of the run's time, and how long it is shown [ms]."""
    for share in np.linspace(0.0, 1.0, 12):
        yield LEAST, share, FRAME
    for reynolds in range(LEAST, LARGEST):
        yield reynolds, 1.0, FRAME
    yield LARGEST, 1.0, 10 * FRAME
    for reynolds in range(LARGEST + 1, BEYOND):
        yield reynolds, 1.0, FRAME
    yield BEYOND, 1.0, 16 * FRAME


def main() -> None:
    """Train the model, write its page, move the sliders, and record the page."""
    sphrom("run", CASE, "--out", RUNS, "--set", "compare.plots=false")
    sphrom("export", CASE, "--out", RUNS, "--force", *EXPORT)
    pictures = []
    durations = []
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        browser.open(PAGE, **SIZE)
        browser.value("document.documentElement.style.overflow = 'hidden'")
        for reynolds, share, duration in states():
            browser.value(
                f"$('p0').value = {reynolds}; $('p0').dispatchEvent(new Event('input'));"
                f"$('time').value = start + {share} * (end - start);"
                "$('time').dispatchEvent(new Event('input'));"
                "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
            )
            pictures.append(Image.open(io.BytesIO(browser.picture())).convert("RGB"))
            durations.append(duration)
        browser.close()
    first, *rest = pictures
    first.save(
        PICTURE, save_all=True, append_images=rest, duration=durations, loop=0, quality=QUALITY,
        method=6,
    )  # fmt: skip
    print(f"{PICTURE.relative_to(ROOT)}: {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
