"""What `compare` shows: tables on the terminal, CSV and JSON, and plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.compare import plots as comparison_plots
from sphrom.compare import tables as comparison_tables
from sphrom.compare.effectivity import EstimateRow
from sphrom.compare.error_rows import ErrorRow, WallRow, wall_row
from sphrom.compare.flow_trends import FlowRow
from sphrom.compare.point_results import PointResults
from sphrom.compare.reference_errors import ReferenceRow
from sphrom.compare.timings import RunTiming, StageTiming, stage_timings
from sphrom.errors import ArtifactError
from sphrom.metrics.compression import cumulative_singular_value_share, energy
from sphrom.metrics.trends import exponential_rate, kinetic_energy
from sphrom.plots.tables import UNKNOWN, read_json, write_csv, write_json
from sphrom.scenes.scene import ExactFlow
from sphrom.setup import assembly
from sphrom.store.sampling import Probes
from sphrom.store.workspace import Workspace
from sphrom.version import __version__

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
    "timings": RunTiming,
    "decay": DecayRow,
    "singular_values": SpectrumRow,
    "stages": StageTiming,
}
"""What each table has rows of."""
MADE_BY = "sphrom compare CASE"


def publish(workspace: Workspace, results: Sequence[PointResults], probes: Probes) -> None:
    """Write tables and plots, and show the tables."""
    tables: dict[str, Sequence[Any]] = {
        "errors": [c.row for result in results for c in result.comparisons],
        "walls": _wall_rows(results),
        "reference": [compared.row for result in results for compared in result.references],
        "flow": [flow for result in results for flow in result.flows],
        "estimates": [estimate for result in results for estimate in result.estimates],
        "timings": [timing for result in results for timing in result.timings],
        "decay": _decays(workspace),
        "singular_values": _spectra(workspace),
        "stages": stage_timings(workspace),
    }
    about = {
        "case": workspace.case.name,
        "software": f"sphrom {__version__}",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": workspace.threads,
    }
    tables = {name: rows for name, rows in tables.items() if rows}
    for name, rows in tables.items():
        write_csv(workspace.folder("tables") / f"{name}.csv", rows)
    write_json(workspace.out / "compare.json", tables, about)
    if workspace.case.compare.plots:
        comparison_plots.draw_all(workspace, results, probes)
    _show(workspace, {name: [asdict(r) for r in rows] for name, rows in tables.items()})


def show_stored(workspace: Workspace) -> None:
    """Show the tables of a comparison that is there already."""
    path = workspace.out / "compare.json"
    try:
        tables = read_json(path, MADE_BY)
        _show(workspace, {name: rows for name, rows in tables.items() if name != "about"})
    except (ArtifactError, ValueError, TypeError, KeyError):
        # The file is for others to read: nothing else keeps what it holds in order.
        workspace.context.report.warn(
            f"{path} is missing or damaged; `{MADE_BY} --force` writes it again"
        )


def _show(workspace: Workspace, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    report = workspace.context.report
    comparison_tables.show(report, tables)
    if "timings" in tables:
        _show_costs(workspace, tables["timings"])
    report.table(
        "wall-clock of the stages, reading and writing included",
        ("stage", "artifacts", "seconds"),
        _stage_cells(tables.get("stages", [])),
    )
    for r in tables.get("decay", []):
        report.info(
            f"{r['parameters']}: the full run's kinetic energy decays at {r['ratio']:.4f} of the "
            "exact rate"
        )
    report.info(f"tables, plots and compare.json are in {workspace.out}")


def _show_costs(workspace: Workspace, timings: Sequence[Mapping[str, Any]]) -> None:
    workspace.context.report.table(
        "cost of the time steps (full and reduced step given), writing left out: all steps at the "
        "least time of a step, means of ten in a row; on reference points the least of some runs",
        (
            "run",
            "parameters",
            "steps full, reduced s",
            "full s",
            "reduced s",
            "speed-up",
            "N_d / M",
        ),
        [
            (
                r["model"],
                r["parameters"],
                f"{r['full_step']:.3g}, {r['reduced_step']:.3g}",
                *(_known(r[name]) for name in ("full_seconds", "reduced_seconds", "speed_up")),
                f"{r['compression_factor']:.0f}",
            )
            for r in timings
        ],
    )


def _known(figure: float | None) -> str:
    return UNKNOWN if figure is None else f"{figure:.3g}"


def _stage_cells(stages: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    seconds: dict[str, list[float]] = {}
    for r in stages:
        seconds.setdefault(r["stage"], []).append(r["seconds"])
    return [(name, str(len(each)), f"{sum(each):.3g}") for name, each in seconds.items()]


def _wall_rows(results: Sequence[PointResults]) -> list[WallRow]:
    """Return what walls cost the map, the bases and the reduced models."""
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
