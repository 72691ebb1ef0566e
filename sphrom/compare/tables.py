"""The tables of a comparison: their rows, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from sphrom.compare.costs import RunTiming, StageTiming
from sphrom.compare.measured import MeasureRow
from sphrom.compare.references import ReferenceRow
from sphrom.compare.rows import ErrorRow, EstimateRow, WallRow
from sphrom.metrics.series import FlowRow
from sphrom.plots.tables import about, read_json, write_csv, write_json
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

    errors: list[ErrorRow] = field(default_factory=list)
    walls: list[WallRow] = field(default_factory=list)
    reference: list[ReferenceRow] = field(default_factory=list)
    flow: list[FlowRow] = field(default_factory=list)
    estimates: list[EstimateRow] = field(default_factory=list)
    measures: list[MeasureRow] = field(default_factory=list)
    timings: list[RunTiming] = field(default_factory=list)
    decay: list[DecayRow] = field(default_factory=list)
    singular_values: list[SpectrumRow] = field(default_factory=list)
    stages: list[StageTiming] = field(default_factory=list)

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
