"""How models fared at their extremes: tables, CSV and JSON, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

from sphrom.plots.canvas import save
from sphrom.plots.tables import format_figure, write_csv, write_json
from sphrom.plots.trade import STATES, StabilityMap, draw_stability
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.models import FOLDER
from sphrom.trade.report import about

MOST_GROWTH = 2.0
"""How far a run without a full one to compare with may exceed training, and count as accurate."""
FULL_UNSTABLE, REFUSED = "full unstable", "refused"
"""States of models that there are none of: a full run to learn from failed, or can't be had."""
AXES = {
    "time step": "step over its limit [–]",
    "memory length": "memory length over automatic [–]",
    "Mach number": "Mach number [–]",
    "h/dx": "h/dx [–]",
}
"""What is varied, and how pictures call it."""


@dataclass(frozen=True, kw_only=True)
class ExtremeRow:
    """One run at the extremes."""

    parameters: str
    varied: str
    """A key of AXES."""
    value: float
    """Of what is varied; time steps and memory lengths over the limit and the automatic one."""
    n_modes: int
    projection: str
    calibrated: bool
    step_factor: float | None = None
    """Time step over the model's limit; None where there is no model."""
    time_step: float | None = field(default=None, metadata={"unit": "s"})
    memory_length: float | None = field(default=None, metadata={"unit": "s"})
    state: str
    """`stable`, `unstable`, `inaccurate`, `full unstable` or `refused`."""
    velocity_error: float | None = field(default=None, metadata={"unit": "%"})
    """None where the run was unstable, or there is no full run to compare with."""
    growth: float | None = None
    """Largest norm of the coordinates, over that of training snapshots."""
    compared_with: str = ""
    detail: str = ""
    """Why a full run was unstable, or a run refused."""


def state_of(error: float | None, growth: float | None, inaccurate: float) -> str:
    """Return how a run fared, from its velocity error [%] where that is known, else its growth.

    A run that has no growth diverged.
    """
    if growth is None:
        return "unstable"
    if error is None:
        return "inaccurate" if growth > MOST_GROWTH else "stable"
    return "inaccurate" if error > inaccurate else "stable"


def publish(workspace: Workspace, rows: Sequence[ExtremeRow], notes: Sequence[str]) -> None:
    """Write the tables and the picture, and show how models fared.

    `notes` are what else there is to say.
    """
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "extremes.csv", rows)
    write_json(folder / "extremes.json", {"extremes": rows}, about(workspace))
    save(draw_stability(stability_maps(rows)), folder / "extremes.png")
    limit = format_figure(workspace.case.trade.extremes.inaccurate)
    stepped = [row for row in rows if row.varied == "time step"]
    factors = sorted({row.value for row in stepped})
    sizes = ", ".join(str(size) for size in sorted({row.n_modes for row in stepped}))
    report.table(
        f"{_kind(stepped)} of {sizes} modes on the reference points, by time step over their "
        f"limit: how many were stable / stable with a velocity error above {limit} % / unstable",
        ("parameters", *map(exact, factors)),
        [(label, *cells) for label, cells in _counts(stepped, factors).items()],
    )
    if not all(row.compared_with for row in stepped):
        report.info(
            "where there is no full run to compare with, a stable run counts as accurate while its "
            f"coordinates stay below {MOST_GROWTH:g} times those of training"
        )
    for varied in AXES:
        chosen = [row for row in rows if row.varied == varied != "time step"]
        if chosen:
            _show_errors(workspace, chosen, limit)
    failed = [
        f"{row.varied} {exact(row.value)}, {row.state}: {row.detail}" for row in rows if row.detail
    ]
    for note in (*notes, *dict.fromkeys(failed)):
        report.info(note)
    report.info(f"extremes.csv, extremes.json and extremes.png are in {folder}")


def _kind(rows: Sequence[ExtremeRow]) -> str:
    """Return what kind of models rows are of."""
    if any(row.projection == "apg" for row in rows):
        return "APG models"
    return "calibrated models" if any(row.calibrated for row in rows) else "models"


def _show_errors(workspace: Workspace, rows: Sequence[ExtremeRow], limit: str) -> None:
    """Show the velocity errors of models, by modes and what is varied."""
    first = rows[0]
    closed = first.varied == "memory length"
    varied = f"{first.varied} " + ("over the automatic one" if closed else "of the full model")
    values = sorted({row.value for row in rows})
    cells = {(row.n_modes, row.value): _cell(row) for row in rows}
    workspace.context.report.table(
        f"{_kind(rows)} at {first.parameters}, by {varied}: velocity error [%], "
        f"~ where above {limit} %",
        ("M", *map(exact, values)),
        [
            (str(n_modes), *(cells[n_modes, value] for value in values))
            for n_modes in sorted({row.n_modes for row in rows})
        ],
    )


def _cell(row: ExtremeRow) -> str:
    if row.velocity_error is None:
        return row.state
    sign = STATES[row.state][1]
    return f"{format_figure(row.velocity_error)} {sign}".strip()


def stability_maps(rows: Sequence[ExtremeRow]) -> list[list[StabilityMap]]:
    """Return rows of maps: of time steps at each parameter value, then of all else."""
    sizes = sorted({row.n_modes for row in rows})
    kinds: dict[tuple[str, str], list[ExtremeRow]] = {}
    for row in rows:
        kinds.setdefault((row.varied, row.parameters), []).append(row)
    steps: list[StabilityMap] = []
    others: list[StabilityMap] = []
    for (varied, _), chosen in kinds.items():
        maps = steps if varied == "time step" else others
        maps.append(_stability_map(chosen, sizes))
    return [maps for maps in (steps, others) if maps]


def _stability_map(rows: Sequence[ExtremeRow], sizes: Sequence[int]) -> StabilityMap:
    """Return a map of modes and what is varied."""
    first = rows[0]
    title = first.parameters
    if first.projection == "apg":
        title = f"{_kind(rows)}, {title}"
    if first.varied == "time step" and not first.compared_with:
        title = f"{title}\n(no full run)"
    values = sorted({row.value for row in rows})
    states = {(row.n_modes, row.value): row.state for row in rows}
    return StabilityMap(title, AXES[first.varied], sizes, values, states)


def _counts(rows: Sequence[ExtremeRow], factors: Sequence[float]) -> dict[str, list[str]]:
    """Return how many runs were in each state, by parameter value, for each time step."""
    cells: dict[str, list[str]] = {row.parameters: [] for row in rows}
    for label, factor in product(cells, factors):
        states = [r.state for r in rows if (r.parameters, r.value) == (label, factor)]
        counted = ("stable", "inaccurate", "unstable")
        cells[label].append(" / ".join(str(states.count(state)) for state in counted))
    return cells
