"""The page of one experiment of the paper in the documentation, from the page of its runs.

`docs/paper/<scene>.md` has the claims as a table from `<scene>.csv`, the costs as one from
`<scene>-costs.csv`, the reasons for differences, the figures as small pictures, and the time taken.
`<scene>.json` says how each reading was made. If only one reading was run, pictures and columns of
the other one stay. Without runs, pages are made anew from the folder and the present reasons:

    python scripts/paper_docs.py docs/paper
"""

from __future__ import annotations

import csv
import json
import shutil
import sys
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import paper_page
from small_picture import write_small

from sphrom.case.loader import load_case
from sphrom.compare.figures import FOLDER
from sphrom.plots.tables import MISSING, format_figure, read_json

CASES = Path(__file__).parent.parent / "cases"
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
"""Corrections that the cases as printed contain nevertheless."""
WIDTH = 1000
"""Width of a picture [pixels], small because there are many."""
COLUMNS = {
    "corrected": ("corrected", "corrected, fast model", "corrected, best possible"),
    "as printed": ("as printed",),
}
"""Columns of the claims by reading."""


def write(folder: Path, source: Path, scene: str, runs: Sequence[Any], command: str) -> Path:
    """Write the page of a scene into a folder of the documentation, and return its path.

    `source` is the folder of the reproduction, with its claims.csv. A case whose full run was
    unstable has no figures. A reading without a run keeps its tables and figures in the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    readings = {run.reading for run in runs}
    _write_claims(source / "claims.csv", folder / f"{scene}.csv", readings)
    if "corrected" in readings:
        shutil.copyfile(source / "costs.csv", folder / f"{scene}-costs.csv")
    for run in runs:
        _copy_figures(folder, scene, run)
    origins = folder / f"{scene}.json"
    made = json.loads(origins.read_text(encoding="utf-8")) if origins.is_file() else {}
    made |= {run.reading: _origin(run, command) for run in runs}
    made = {reading: made[reading] for reading in COLUMNS if reading in made}
    origins.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    return write_page(folder, scene, made)


def write_page(folder: Path, scene: str, made: Mapping[str, Mapping[str, str]]) -> Path:
    """Write the page of a scene from the tables and pictures in a folder, and return its path.

    `made` says by reading how they were made.
    """
    lines = [
        f"# {TITLES[scene]}: the paper, and here",
        "",
        paper_page.lead_of({reading: origin["size"] for reading, origin in made.items()}),
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
        *_figures(folder, scene, made),
        "## How it was made",
        "",
        *_made(made),
    ]
    page = folder / f"{scene}.md"
    page.write_text("\n".join(lines), encoding="utf-8")
    return page


def _write_claims(source: Path, target: Path, readings: Container[str]) -> None:
    """Write the table of claims: columns of readings that were not run stay as they are."""
    rows = _rows(source)
    old = {_claim(row): row for row in _rows(target)} if target.is_file() else {}
    kept = [name for reading, names in COLUMNS.items() if reading not in readings for name in names]
    for row in rows:
        stored = old.get(_claim(row), {})
        row.update({name: stored.get(name, MISSING) for name in kept})
    cells = [[row.get(name, MISSING) for name in paper_page.HEADINGS] for row in rows]
    paper_page.write_csv(target, [paper_page.HEADINGS, *cells])


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _claim(row: Mapping[str, str]) -> tuple[str, str]:
    return row[paper_page.HEADINGS[0]], row[paper_page.HEADINGS[1]]


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


def _copy_figures(folder: Path, scene: str, run: Any) -> None:
    """Write small copies of the pictures of a case."""
    for figure in run.case.compare.figures:
        path = run.out / FOLDER / f"{figure.name}.png"
        if path.is_file():
            stem = _stem(scene, figure.name, run.reading)
            for older in folder.glob(f"{stem}.*"):
                older.unlink()
            write_small(path, folder / f"{stem}.webp", WIDTH)


def _stem(scene: str, figure: str, reading: str) -> str:
    return f"{scene}-{figure}-{reading.replace(' ', '-')}"


def _figures(folder: Path, scene: str, made: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield each figure by its number, from both cases, with the size and the command."""
    for figure in load_case(CASES / f"{scene.replace('-', '_')}.yaml").compare.figures:
        stems = {reading: _stem(scene, figure.name, reading) for reading in made}
        names = {
            reading: path.name
            for reading, stem in stems.items()
            for path in folder.glob(f"{stem}.*")
        }
        if names:
            yield from (f"### {paper_page.numbered(figure.name)}", "")
        for reading, name in names.items():
            yield from (f"![{figure.caption} ({reading})]({name})", "")
            how = f"{made[reading]['size']}, `{made[reading]['command']}`"
            yield from (f"*{figure.caption} {reading.capitalize()}: {how}.*", "")


def _made(made: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield the command, the machine, the version, the date and the wall-clock of each case."""
    for reading, origin in made.items():
        how = f"`{origin['command']}`, on {origin['machine']}"
        yield from (f"{reading.capitalize()}: {how}. {origin['made']}", "")


def _origin(run: Any, command: str) -> dict[str, str]:
    """Return how a case was made: size, command, machine, version, date and wall-clock."""
    machine = paper_page.machine()
    origin = {"size": paper_page.size_of(run.case), "command": command, "machine": machine}
    if run.failure_file.is_file():
        why = run.failure_file.read_text(encoding="utf-8").strip()
        return {**origin, "made": f"The full model is unstable: {why}"}
    tables = read_json(run.out / "compare.json", "sphrom compare CASE", {})
    about: Mapping[str, Any] = tables["about"]
    seconds = paper_page.stage_seconds(tables)
    taken = ", ".join(f"{stage} {format_figure(total)}" for stage, total in seconds.items())
    threads = paper_page.counted(about["threads"], "thread")
    by = f"{about['software']}, compared {about['date']}, {threads}"
    hours = paper_page.hours_of_steps(run.case, tables)
    return {**origin, "made": f"{by}. Wall-clock of the stages [s]: {taken}. {hours}".rstrip()}


if __name__ == "__main__":
    for name in TITLES:
        origins = Path(sys.argv[1]) / f"{name}.json"
        print(write_page(origins.parent, name, json.loads(origins.read_text(encoding="utf-8"))))
