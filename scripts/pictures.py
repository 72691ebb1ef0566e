"""Draw the pictures of the documentation again, each by the command that its page names.

python scripts/pictures.py                   all of them
python scripts/pictures.py gallery tutorial  those whose names begin so

Runs are kept in `runs/pictures`, so that a second call draws what has changed only.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from small_picture import WIDTH, write_small

ROOT = Path(__file__).parents[1]
CASES = ROOT / "cases"
DOCS = ROOT / "docs"
FIGURES = DOCS / "figures"
RUNS = ROOT / "runs" / "pictures"

GALLERY = {
    "cavity_with_fin": "reynolds150",
    "cylinder": "reynolds60",
    "cylinder_array": "reynolds20",
    "eccentric_cylinder": "reynolds20",
    "kolmogorov": "reynolds28",
    "l_shaped_cavity": "reynolds150",
    "taylor_couette": "reynolds40",
    "wake": "reynolds90",
}
"""Cases of the gallery, and the value that is drawn."""
OF_SURFACES = ("gallery-standing_wave", "gallery-oscillating_drop", "gallery-dam_break")
"""Pictures of particles, which a script of their own draws."""
TRADES = {
    "trade": ("taylor_green", "3%"),
    "trade-lid-driven-cavity": ("lid_driven_cavity", "0.5%,15%"),
    "trade-open-cavity": ("open_cavity", "1%,25%"),
}
"""By picture: the demo, and the tolerance of velocity and pressure."""


@dataclass(frozen=True)
class Picture:
    """A picture, the commands that draw it, and where they leave it."""

    name: str
    case: Path
    source: str
    commands: tuple[str, ...] = ("run --force",)
    width: int = WIDTH

    @property
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
    """Yield every picture of the documentation but those of the paper's page."""
    demo = CASES / "taylor_green_demo.yaml"
    yield Picture("overview", demo, "plots/overview-reynolds150.png")
    for name, place in GALLERY.items():
        case = CASES / "gallery" / f"{name}.yaml"
        run = ("run --force --set compare.grid=120 --set compare.plots=true",)
        yield Picture(f"gallery-{name}", case, f"plots/overview-{place}.png", run)
        if name == "cylinder":
            yield Picture("gallery-drag", case, f"plots/force-drag-{place}.png", run)
    for kind in ("quantiles", "indices"):
        source, commands = f"sweep-fast-{kind}.png", ("run --force", "sweep")
        yield Picture(f"uncertainty-{kind}", CASES / "uncertain_lid.yaml", source, commands, 900)
    yield Picture(
        "wake-force", CASES / "cylinder_wake.yaml", "plots/force-cylinder-reynolds100.png"
    )
    vortex = tutorial_case("first-result", "vortex.yaml")
    yield Picture("tutorial-vortex", vortex, "plots/overview-reynolds150.png")
    channel = tutorial_case("own-flow", "channel.yaml")
    yield Picture("tutorial-channel", channel, "draw.png", ("case draw --force -o {out}/draw.png",))
    for name, file in (("overview", "overview"), ("force", "force-load")):
        run = ("run --force --set compare.plots=true",)
        yield Picture(f"tutorial-channel-{name}", channel, f"plots/{file}-reynolds40.png", run)
    sweep = "sweep --force --set compare.plots=true --set"
    sweep += " 'sweep.reynolds={{low: 20, high: 60, count: 100}}'"
    yield Picture("tutorial-channel-sweep", channel, "sweep-fast.png", ("run --force", sweep))
    for name, (scene, tolerance) in TRADES.items():
        commands = ("run --force", f"trade --tolerance {tolerance}")
        yield Picture(name, CASES / f"{scene}_demo.yaml", "trade/trade.png", commands)


def draw(picture: Picture) -> None:
    """Run the commands of a picture, and put a small copy into the documentation."""
    picture.folder.mkdir(parents=True, exist_ok=True)
    for command in picture.commands:
        words = shlex.split(command.format(out=picture.folder))
        place = [] if words[0] == "case" else ["--out", str(picture.folder)]
        call = [sys.executable, "-m", "sphrom", *words, str(picture.case), *place]
        subprocess.run(call, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    path = FIGURES / f"{picture.name}.png"
    write_small(picture.folder / picture.source, path, picture.width)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


def main() -> None:
    """Draw the pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="beginnings of names; all by default")
    names = tuple(parser.parse_args().names) or ("",)
    for picture in pictures():
        if picture.name.startswith(names):
            draw(picture)
    if any(name.startswith(names) for name in OF_SURFACES):
        script = ROOT / "scripts" / "free_surface.py"
        subprocess.run([sys.executable, script, "pictures"], check=True, cwd=ROOT)


if __name__ == "__main__":
    main()
