"""The results of `trade --extremes`: tables, CSV and JSON, and a map of stability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.plots.canvas import save
from sphrom.plots.tables import about, format_figure, write_csv, write_json
from sphrom.plots.trade import STATES, StabilityMap, draw_stability
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.report import FOLDER

MOST_GROWTH = 2.0
"""How far the coordinates of a run without a full one may exceed training's, to be accurate."""
FULL_UNSTABLE, REFUSED = "full unstable", "refused"
"""States of models that can't be made: a full run to learn from is unstable, or refused."""
AXES = {
    "time step": "step over its limit [–]",
    "memory length": "memory length over automatic [–]",
    "Mach number": "Mach number [–]",
    "h/dx": "h/dx [–]",
}
"""The varied properties, and their labels in pictures."""


@dataclass(frozen=True, kw_only=True)
class ExtremeRow:
    """One run at the extremes."""

    parameters: str
    varied: str
    """A key of AXES."""
    value: float
    """Of the varied property; time steps over the limit, memory lengths over the automatic one."""
    n_modes: int
    projection: str
    calibrated: bool
    step_factor: float | None = None
    """Ratio of the time step to the model's limit; None where no model could be made."""
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

    @classmethod
    def of(
        cls,
        model: ReducedModelSection,
        point: ParameterPoint,
        varied: str,
        value: float,
        **results: Any,
    ) -> ExtremeRow:
        """Return the row of a model at a parameter point, where `varied` has a value."""
        return cls(
            parameters=point.label,
            varied=varied,
            value=value,
            n_modes=model.size,
            projection=model.projection,
            calibrated=model.is_calibrated,
            **results,
        )


def state_of(error: float | None, growth: float | None, inaccurate: float) -> str:
    """Return the state of a run, from its velocity error [%] where that is known, else its growth.

    A run that has no growth diverged.
    """
    if growth is None:
        return "unstable"
    if error is None:
        return "inaccurate" if growth > MOST_GROWTH else "stable"
    return "inaccurate" if error > inaccurate else "stable"


def publish(workspace: Workspace, rows: Sequence[ExtremeRow], notes: Sequence[str]) -> None:
    """Write the tables and the maps of stability, and show them with some notes."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "extremes.csv", rows)
    origin = about(workspace.case.name, workspace.threads)
    write_json(folder / "extremes.json", {"extremes": rows}, origin)
    tables: dict[tuple[str, str], list[ExtremeRow]] = {}
    for row in sorted(rows, key=lambda row: list(AXES).index(row.varied)):
        tables.setdefault((row.varied, row.parameters), []).append(row)
    save(draw_stability(list(map(stability_map, tables.values()))), folder / "extremes.png")
    limit = format_figure(workspace.case.trade.extremes.inaccurate)
    for each in tables.values():
        _show(workspace, each, limit)
    if not all(row.compared_with or row.detail for row in rows):
        report.info(
            "where there is no full run to compare with, a stable run counts as accurate while its "
            f"coordinates stay below {MOST_GROWTH:g} times those of training"
        )
    failed = (
        f"{row.varied} {exact(row.value)}, {row.state}: {row.detail}" for row in rows if row.detail
    )
    for note in (*notes, *dict.fromkeys(failed)):
        report.info(note)
    report.info(f"extremes.csv, extremes.json and extremes.png are in {folder}")


def _show(workspace: Workspace, rows: Sequence[ExtremeRow], limit: str) -> None:
    """Show the velocity errors of models, by modes and the values of a varied property."""
    drawn = stability_map(rows)
    names = dict.fromkeys(row.compared_with for row in rows if row.compared_with)
    against = f", against {', '.join(names)}" if names else ""
    errors = {(row.n_modes, row.value): _cell(row) for row in rows}
    workspace.context.report.table(
        f"{drawn.title}{against}: velocity error [%] by {drawn.axis}, ~ where above {limit} %",
        ("M", *map(exact, drawn.values)),
        [(str(n), *(errors[n, value] for value in drawn.values)) for n in drawn.n_modes],
    )


def _cell(row: ExtremeRow) -> str:
    if row.velocity_error is None:
        return row.state
    sign = STATES[row.state][1]
    return f"{format_figure(row.velocity_error)} {sign}".strip()


def stability_map(rows: Sequence[ExtremeRow]) -> StabilityMap:
    """Return a map of modes and the values of a varied property."""
    first = rows[0]
    title = first.parameters
    if first.projection == "apg":
        title = f"APG, {title}"
    if first.varied == "time step" and not first.compared_with:
        title = f"{title} (no full run)"
    return StabilityMap(
        title=title,
        axis=AXES[first.varied],
        n_modes=sorted({row.n_modes for row in rows}),
        values=sorted({row.value for row in rows}),
        states={(row.n_modes, row.value): row.state for row in rows},
    )
