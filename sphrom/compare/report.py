"""The results of `compare`: tables on the terminal, as CSV and JSON, and plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.compare import plots as comparison_plots
from sphrom.compare import tables as comparison_tables
from sphrom.compare.forces import ForceRow
from sphrom.compare.measures import MeasureRow
from sphrom.compare.point_results import PointResults
from sphrom.compare.reference_errors import ReferenceRow
from sphrom.compare.rows import ErrorRow, EstimateRow, WallRow, wall_row
from sphrom.compare.timings import RunTiming, StageTiming, stage_timings
from sphrom.errors import ArtifactError
from sphrom.metrics.discrepancy import cumulative_singular_value_share, energy
from sphrom.metrics.flow import FlowRow
from sphrom.metrics.samples import Probes
from sphrom.metrics.trends import exponential_rate, kinetic_energy
from sphrom.plots.tables import about, flat, read_json, write_csv, write_json
from sphrom.scenes.scene import ExactFlow
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpectrumRow:
    """Shares of the first modes of a basis."""

    space: str
    basis: str
    part: str
    n_modes: int
    singular_value: float
    share: float = field(metadata={"unit": "%"})
    """Eq. 4.3 as printed, sums of singular values."""
    energy: float = field(metadata={"unit": "%"})
    """The same with their squares."""


@dataclass(frozen=True)
class DecayRow:
    """The decay of the full run's kinetic energy, against the exact solution's."""

    parameters: str
    fitted_rate: float = field(metadata={"unit": "1/s"})
    exact_rate: float = field(metadata={"unit": "1/s"})
    ratio: float


RECORDS: Mapping[str, type[DataclassInstance]] = {
    "errors": ErrorRow,
    "walls": WallRow,
    "reference": ReferenceRow,
    "flow": FlowRow,
    "estimates": EstimateRow,
    "forces": ForceRow,
    "measures": MeasureRow,
    "timings": RunTiming,
    "decay": DecayRow,
    "singular_values": SpectrumRow,
    "stages": StageTiming,
}
"""The rows of each table."""
MADE_BY = "sphrom compare CASE"


def publish(workspace: Workspace, results: Sequence[PointResults], probes: Probes) -> None:
    """Write tables and plots, and show the tables."""
    tables: dict[str, Sequence[Any]] = {
        "errors": [c.row for result in results for c in result.comparisons],
        "walls": _wall_rows(results),
        "reference": [compared.row for result in results for compared in result.references],
        "flow": [flow for result in results for flow in result.flows],
        "estimates": [estimate for result in results for estimate in result.estimates],
        "forces": [force.row for result in results for force in result.forces],
        "measures": [row for result in results for row in result.measure_rows()],
        "timings": [timing for result in results for timing in result.timings],
        "decay": _decays(workspace),
        "singular_values": _spectra(workspace),
        "stages": stage_timings(workspace),
    }
    tables = {name: rows for name, rows in tables.items() if rows}
    for name, rows in tables.items():
        write_csv(workspace.folder("tables") / f"{name}.csv", rows)
    write_json(
        workspace.out / "compare.json", tables, about(workspace.case.name, workspace.threads)
    )
    if workspace.case.compare.plots:
        comparison_plots.draw_all(workspace, results, probes)
    _show(workspace, {name: [flat(r) for r in rows] for name, rows in tables.items()})


def show_stored(workspace: Workspace) -> None:
    """Show the tables of a comparison that was made before."""
    path = workspace.out / "compare.json"
    try:
        tables = read_json(path, MADE_BY)
        _show(workspace, {name: rows for name, rows in tables.items() if name != "about"})
    except (ArtifactError, ValueError, TypeError, KeyError):
        # Other programs may have changed the file: nothing else protects it.
        workspace.context.report.warn(
            f"{path} is missing or damaged; `{MADE_BY} --force` writes it again"
        )


def _show(workspace: Workspace, tables: comparison_tables.Tables) -> None:
    report = workspace.context.report
    comparison_tables.show(report, tables, report.details)


def _wall_rows(results: Sequence[PointResults]) -> list[WallRow]:
    """Return the errors near walls of the map, the bases and the reduced models."""
    compared = [c for result in results for c in result.comparisons if c.row.against == "full"]
    rows = (wall_row(c.row, c.history) for c in compared)
    return [row for row in rows if row is not None]


def _decays(workspace: Workspace) -> list[DecayRow]:
    if not workspace.case.compare.exact:
        return []
    flows = ((point, assembly.exact_flow(workspace.case, point)) for point in workspace.case.points)
    return [_decay(workspace, point, flow) for point, flow in flows if flow is not None]


def _decay(workspace: Workspace, point: ParameterPoint, flow: ExactFlow) -> DecayRow:
    exact = flow.energy_decay_rate
    with workspace.open(workspace.full_run(point)) as trajectory:
        velocities, mass = trajectory.dataset("velocity"), trajectory.number("mass")
        energies = [float(kinetic_energy(velocity, mass)) for velocity in velocities]
        fitted = exponential_rate(trajectory.read("time"), np.array(energies))
    return DecayRow(point.label, fitted, exact, fitted / exact)


def _spectra(workspace: Workspace) -> list[SpectrumRow]:
    if not workspace.case.rom:
        return []
    return [
        SpectrumRow(space, basis, part, m, float(values[m - 1]), float(share), float(content))
        for space, basis, part, values in comparison_plots.spectra(workspace)
        for m, (share, content) in enumerate(
            zip(cumulative_singular_value_share(values), energy(values), strict=True), start=1
        )
    ]
