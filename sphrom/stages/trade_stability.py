"""How models fared at their extremes: a table, CSV and JSON, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

from sphrom.report.canvas import save
from sphrom.report.tables import format_figure, write_csv, write_json
from sphrom.report.trade import STATES, StabilityMap, draw_stability
from sphrom.stages.trade_report import FOLDER, about
from sphrom.stages.workspace import Workspace

MOST_GROWTH = 2.0
"""How far a run without a full one to compare with may exceed training, and count as accurate."""


@dataclass(frozen=True)
class ExtremeRow:
    """One run at the extremes."""

    parameters: str
    n_modes: int
    step_factor: float
    """Time step over the model's limit."""
    time_step: float = field(metadata={"unit": "s"})
    state: str
    """`stable`, `unstable` or `inaccurate`."""
    velocity_error: float | None = field(metadata={"unit": "%"})
    """None where the run was unstable, or there is no full run to compare with."""
    growth: float | None
    """Largest norm of the coordinates, over that of training snapshots."""
    compared_with: str


def state_of(error: float | None, growth: float | None, inaccurate: float) -> str:
    """Return how a run fared, from its velocity error [%] where that is known, else its growth.

    A run that has no growth diverged.
    """
    if growth is None:
        return "unstable"
    if error is None:
        return "inaccurate" if growth > MOST_GROWTH else "stable"
    return "inaccurate" if error > inaccurate else "stable"


def publish(workspace: Workspace, rows: Sequence[ExtremeRow]) -> None:
    """Write the table and the picture, and show how many models were in each state."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "extremes.csv", rows)
    write_json(folder / "extremes.json", {"extremes": rows}, about(workspace))
    maps = stability_maps(rows)
    save(draw_stability(maps), folder / "extremes.png")
    limit = format_figure(workspace.case.trade.extremes.inaccurate)
    sizes = ", ".join(str(size) for size in sorted({row.n_modes for row in rows}))
    factors = sorted({row.step_factor for row in rows})
    report.table(
        f"models of {sizes} modes on the reference points, by time step over their limit: how many "
        f"were stable / stable with a velocity error above {limit} % / unstable",
        ("parameters", *(f"{factor:g}" for factor in factors)),
        [(label, *cells) for label, cells in _counts(rows, factors).items()],
    )
    if not all(row.compared_with for row in rows):
        report.info(
            "where there is no full run to compare with, a stable run counts as accurate while its "
            f"coordinates stay below {MOST_GROWTH:g} times those of training"
        )
    report.info("not varied, as they need artifacts of their own: Mach number, memory length, h/dx")
    report.info(f"extremes.csv, extremes.json and extremes.png are in {folder}")


def stability_maps(rows: Sequence[ExtremeRow]) -> list[StabilityMap]:
    """Return a map of modes and steps for each parameter value."""
    sizes = sorted({row.n_modes for row in rows})
    factors = sorted({row.step_factor for row in rows})
    maps = []
    for label in dict.fromkeys(row.parameters for row in rows):
        chosen = [row for row in rows if row.parameters == label]
        title = label if chosen[0].compared_with else f"{label}\n(no full run)"
        states = {(row.n_modes, row.step_factor): row.state for row in chosen}
        maps.append(StabilityMap(title, sizes, factors, states))
    return maps


def _counts(rows: Sequence[ExtremeRow], factors: Sequence[float]) -> dict[str, list[str]]:
    """Return how many runs were in each state, by parameter value, for each time step."""
    cells: dict[str, list[str]] = {row.parameters: [] for row in rows}
    for label, factor in product(cells, factors):
        states = [r.state for r in rows if (r.parameters, r.step_factor) == (label, factor)]
        cells[label].append(" / ".join(str(states.count(state)) for state in STATES))
    return cells
