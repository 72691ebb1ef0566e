"""The page of one experiment of the paper in the documentation, from the page of its runs.

`docs/paper/<scene>.md` has the claims as a table from `<scene>.csv`, the costs as one from
`<scene>-costs.csv`, the reasons for differences, the figures as small pictures, and the time taken.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import paper_page
from small_picture import write_small

from sphrom.compare.figures import FOLDER
from sphrom.plots.tables import format_figure, read_json

TITLES = {
    "taylor-green": "Taylor-Green vortex",
    "lid-driven-cavity": "Lid-driven cavity",
    "open-cavity": "Open cavity",
}
KEPT_RIGHT = {
    "taylor-green": "the plus sign of the pressure in Eq. 4.4, and gradients of the modes in the "
    "advection (Eq. 3.5-3.6)",
    "lid-driven-cavity": "ghosts that enter continuity only across their wall, ghosts with the "
    "whole velocity reversed, and gradients of the modes in the advection (Eq. 3.5-3.6)",
    "open-cavity": "constants of Eq. 4.5 that drive the flow, ghosts that enter continuity only "
    "across their wall, ghosts with the whole velocity reversed, and gradients of the modes in the "
    "advection (Eq. 3.5-3.6)",
}
"""Corrections that the cases as printed have all the same."""
WIDTH = 1000
"""Of a picture, in pixels: there are many."""


def write(folder: Path, source: Path, scene: str, runs: Sequence[Any], command: str) -> Path:
    """Write the page of a scene into a folder of the documentation, and return its path.

    `source` is the folder of the reproduction, with its claims.csv. A case whose full run was
    unstable has no figures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source / "claims.csv", folder / f"{scene}.csv")
    shutil.copyfile(source / "costs.csv", folder / f"{scene}-costs.csv")
    lines = [
        f"# {TITLES[scene]}: the paper, and here",
        "",
        paper_page.lead_of(runs),
        *_corrections(scene),
        "",
        "## Claims",
        "",
        *_table(f"{scene}.csv", paper_page.CAPTION),
        "## Costs",
        "",
        *_table(f"{scene}-costs.csv", paper_page.COST_CAPTION),
        *_readings(scene),
        "## Figures",
        "",
        *_figures(folder, scene, runs),
        "## How it was made",
        "",
        f"`{command}`, on {paper_page.machine()}.",
        "",
        *_origin(runs),
    ]
    page = folder / f"{scene}.md"
    page.write_text("\n".join(lines), encoding="utf-8")
    return page


def _corrections(scene: str) -> Iterator[str]:
    yield f"The case as printed departs from the text in some points: it has {KEPT_RIGHT[scene]}."
    yield "Its time steps are longer, too. The [ledger](../ledger.md) lists all corrections."


def _table(file: str, caption: str) -> Iterator[str]:
    yield from ("```{csv-table}", f":file: {file}", ":header-rows: 1", "```", "", caption, "")


def _readings(scene: str) -> Iterator[str]:
    """Yield the reasons for differences from the paper, claim by claim."""
    told = [c for c in paper_page.claims(scene) if "reading" in c]
    if not told:
        return
    yield from ("## Where the results differ, and why", "")
    for claim in told:
        yield f"- **{claim['where']}, {claim['what']}.** {claim['reading']}"
    yield ""


def _figures(folder: Path, scene: str, runs: Sequence[Any]) -> Iterator[str]:
    """Yield each figure by its number, from both cases, and write the pictures."""
    figures = {f.name: f for run in runs for f in run.case.compare.figures}
    for figure in figures.values():
        pictures = [(r, r.out / FOLDER / f"{figure.name}.png") for r in runs]
        pictures = [(run, path) for run, path in pictures if path.is_file()]
        if pictures:
            yield from (f"### {paper_page.numbered(figure.name)}", "")
        for run, path in pictures:
            name = f"{scene}-{figure.name}-{run.reading.replace(' ', '-')}.png"
            write_small(path, folder / name, WIDTH)
            yield from (f"![{figure.caption} ({run.reading})]({name})", "")
            yield from (f"*{run.reading.capitalize()}. {figure.caption}*", "")


def _origin(runs: Sequence[Any]) -> Iterator[str]:
    """Yield the version, the date and the wall-clock of each case."""
    for run in runs:
        name = run.reading.capitalize()
        if run.failure_file.is_file():
            why = run.failure_file.read_text(encoding="utf-8").strip()
            yield from (f"{name}, the full model is unstable: {why}", "")
            continue
        tables = read_json(run.out / "compare.json", "sphrom compare CASE", {})
        about: Mapping[str, Any] = tables["about"]
        seconds = paper_page.stage_seconds(tables)
        taken = ", ".join(f"{stage} {format_figure(total)}" for stage, total in seconds.items())
        made = f"{about['software']}, compared {about['date']}, {about['threads']} threads"
        hours = paper_page.hours_of_steps(run.case, tables)
        yield from (f"{name}: {made}. Wall-clock of the stages [s]: {taken}. {hours}".rstrip(), "")
