"""Draw the pictures of the documentation again, each by the command that its page names.

python scripts/pictures.py                  all of them
python scripts/pictures.py gallery-cylinder  those whose names begin so

Runs are kept in `runs/pictures`, so that a second call draws what has changed only.
"""

from __future__ import annotations

import argparse
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FIGURES = DOCS / "figures"
RUNS = ROOT / "runs" / "pictures"
COLOURS = 256
"""Colours of a picture: a quarter of the size of all, and what is drawn looks the same."""
WIDTH = 1480
"""Of a picture, in pixels: twice what a page shows."""

GALLERY = {
    "cavity_with_fin": "reynolds150",
    "cylinder": "reynolds60",
    "cylinder_array": "reynolds20",
    "eccentric_cylinder": "reynolds20",
    "kolmogorov": "reynolds28",
    "l_shaped_cavity": "reynolds150",
    "taylor_couette": "reynolds40",
}


@dataclass(frozen=True)
class Picture:
    """A picture, the command that draws it (or some, with `&&`), and where it is left."""

    name: str
    command: str
    case: Path
    source: str

    def folder(self) -> Path:
        """Where the case's artifacts are kept."""
        return RUNS / self.case.stem


def tutorial_case(page: str, name: str) -> Path:
    """Write the case file that a tutorial shows, and return its path."""
    text = (DOCS / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    found = re.search(rf"`{re.escape(name)}`:\n\n```yaml\n(.*?)```", text, re.DOTALL)
    if found is None:
        raise SystemExit(f"docs/tutorials/{page}.md shows no {name}")
    RUNS.mkdir(parents=True, exist_ok=True)
    path = RUNS / name
    path.write_text(found[1], encoding="utf-8")
    return path


def pictures() -> Iterator[Picture]:
    """Yield every picture of the documentation that a command of minutes draws."""
    demo = ROOT / "cases" / "taylor_green_demo.yaml"
    yield Picture("overview", "run", demo, "plots/overview-reynolds150.png")
    for name, place in GALLERY.items():
        case, run = ROOT / "cases" / "gallery" / f"{name}.yaml", "run --set compare.grid=120"
        yield Picture(f"gallery-{name}", run, case, f"plots/overview-{place}.png")
        if name == "cylinder":
            yield Picture("gallery-drag", run, case, f"plots/force-drag-{place}.png")
    lid = ROOT / "cases" / "uncertain_lid.yaml"
    for kind in ("quantiles", "indices", "index-convergence"):
        yield Picture(f"uncertainty-{kind}", "run && sweep", lid, f"sweep-fast-{kind}.png")
    vortex = tutorial_case("first-result", "vortex.yaml")
    yield Picture("tutorial-vortex", "run", vortex, "plots/overview-reynolds150.png")
    channel = tutorial_case("own-flow", "channel.yaml")
    yield Picture("tutorial-channel", "case draw -o {out}/draw.png", channel, "draw.png")
    overview, force = "plots/overview-reynolds40.png", "plots/force-load-reynolds40.png"
    yield Picture("tutorial-channel-overview", "run", channel, overview)
    yield Picture("tutorial-channel-force", "run", channel, force)


def draw(picture: Picture) -> None:
    """Run the command of a picture, and put a small copy into the documentation."""
    folder = picture.folder()
    folder.mkdir(parents=True, exist_ok=True)
    for command in picture.command.format(out=folder).split(" && "):
        words = shlex.split(command)
        place = [] if "-o" in words else ["--out", str(folder)]
        if words[0] != "sweep":  # which would start anew, and goes on where it was
            place.append("--force")
        line = [sys.executable, "-m", "sphrom", *words, str(picture.case), *place]
        subprocess.run(line, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    drawn = Image.open(folder / picture.source).convert("RGB")
    if drawn.width > WIDTH:
        height = round(drawn.height * WIDTH / drawn.width)
        drawn = drawn.resize((WIDTH, height), Image.Resampling.LANCZOS)
    content = io.BytesIO()
    few = drawn.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(content, "PNG", optimize=True)
    path = FIGURES / f"{picture.name}.png"
    path.write_bytes(content.getvalue())
    print(f"{path.relative_to(ROOT)}: {len(content.getvalue()) / 1000:.0f} kB")


def main() -> None:
    """Draw the pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="beginnings of names; all by default")
    names = tuple(parser.parse_args().names) or ("",)
    for picture in pictures():
        if picture.name.startswith(names):
            draw(picture)


if __name__ == "__main__":
    main()
