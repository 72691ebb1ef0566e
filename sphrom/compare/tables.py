"""The tables of a comparison: their rows, and their files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from sphrom.case.points import ParameterPoint
from sphrom.compare.costs import RunTiming, StageTiming, stage_timings
from sphrom.compare.default_figures import spectra
from sphrom.compare.measured import ForceRow, MeasureRow
from sphrom.compare.references import ReferenceRow
from sphrom.compare.results import PointResults
from sphrom.compare.rows import ErrorRow, EstimateRow, WallRow, wall_row
from sphrom.metrics.discrepancy import cumulative_singular_value_share, energy
from sphrom.metrics.series import FlowRow, exponential_rate, kinetic_energy
from sphrom.plots.tables import about, read_json, write_csv, write_json
from sphrom.scenes.scene import ExactFlow
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FILE = "compare.json"
MADE_BY = "sphrom compare CASE"


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


@dataclass(frozen=True)
class Tables:
    """The rows of each table: each is `tables/NAME.csv`, and all are in `compare.json`."""

    errors: Sequence[ErrorRow] = ()
    walls: Sequence[WallRow] = ()
    reference: Sequence[ReferenceRow] = ()
    flow: Sequence[FlowRow] = ()
    estimates: Sequence[EstimateRow] = ()
    forces: Sequence[ForceRow] = ()
    measures: Sequence[MeasureRow] = ()
    timings: Sequence[RunTiming] = ()
    decay: Sequence[DecayRow] = ()
    singular_values: Sequence[SpectrumRow] = ()
    stages: Sequence[StageTiming] = ()

    @classmethod
    def of(cls, workspace: Workspace, results: Sequence[PointResults]) -> Tables:
        """Return the rows of all results."""
        return cls(
            errors=[c.row for result in results for c in result.comparisons],
            walls=_wall_rows(results),
            reference=[compared.row for result in results for compared in result.references],
            flow=[flow for result in results for flow in result.flows],
            estimates=[estimate for result in results for estimate in result.estimates],
            forces=[row for result in results for row in result.force_rows()],
            measures=[row for result in results for row in result.measure_rows()],
            timings=[timing for result in results for timing in result.timings],
            decay=_decays(workspace),
            singular_values=_spectra(workspace),
            stages=stage_timings(workspace),
        )

    @classmethod
    def read(cls, workspace: Workspace) -> tuple[Tables, Mapping[str, Any]]:
        """Return the tables of a comparison that was made before, and what they say of its making.

        Raises ArtifactError when `compare.json` is missing or damaged.
        """
        found = read_json(workspace.out / FILE, MADE_BY, RECORDS)
        return cls(**{name: found[name] for name in RECORDS if name in found}), found["about"]

    def write(self, workspace: Workspace) -> None:
        """Write every table that has rows."""
        tables = {each.name: rows for each in fields(self) if (rows := getattr(self, each.name))}
        for name, rows in tables.items():
            write_csv(workspace.folder("tables") / f"{name}.csv", rows)
        origin = about(workspace.case.name, workspace.threads)
        write_json(workspace.out / FILE, tables, origin)


RECORDS: Mapping[str, type[DataclassInstance]] = {
    name: get_args(rows)[0] for name, rows in get_type_hints(Tables).items()
}
"""The record of the rows of each table."""


def _wall_rows(results: Sequence[PointResults]) -> list[WallRow]:
    """Return the errors near walls of the map, the bases and the reduced models."""
    compared = [c for result in results for c in result.comparisons if c.row.against == "full"]
    rows = (wall_row(c.row, c.history) for c in compared)
    return [row for row in rows if row is not None]


def _decays(workspace: Workspace) -> list[DecayRow]:
    if not workspace.case.compare.exact:
        return []
    flows = ((point, workspace.case.plan.flow(point).exact) for point in workspace.case.plan.points)
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
        for space, basis, part, values in spectra(workspace)
        for m, (share, content) in enumerate(
            zip(cumulative_singular_value_share(values), energy(values), strict=True), start=1
        )
    ]
