"""The table of the runs of a sweep: columns, rows, and the summary that is printed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from sphrom.case.models import Case
from sphrom.metrics import measures
from sphrom.metrics.measures import DRY, STATISTICS
from sphrom.metrics.quantities import unit_of
from sphrom.metrics.series import ESTIMATED, OSCILLATION, REGIMES
from sphrom.plots.tables import format_figure
from sphrom.sweep import statistics
from sphrom.sweep.batches import (
    COMPLETE,
    ERROR,
    MEASURED_ERRORS,
    OSCILLATION_ERRORS,
    REGIME,
    STATES,
    RunRecord,
)

FIGURES = {
    "time_step": "s",
    "kinetic_energy": "J/m",
    "largest_speed": "m/s",
    "error_estimate_velocity": "%",
    "error_estimate_pressure": "%",
}
"""Figures of a run with their units, named as in `sphrom.open`: final energy, largest speed of all
points and snapshots, root mean squares of estimated errors over those of the fields."""

SHOWN = ("_mean", "_frequency", "_amplitude", "_elevation_greatest")
"""Suffixes of the names of measured figures that are shown."""
BEYOND = {None: "", 0: "no", 1: "yes"}
"""Table entries that say whether a run is outside of the trained range; None means unknown."""
Cells = dict[str, str | float | None]
"""The row of a run in the table, by column; None without a result or an estimate."""


def columns_of(case: Case, records: Sequence[RunRecord]) -> dict[str, str | None]:
    """Return the columns of the table of runs, with their units.

    `error_estimate_extrapolated` is `yes` for values outside of the trained range, else `no`, and
    empty without an estimate. `reason` is that of a failure, or of a doubt about a complete run.
    Measurements over time have columns for their statistics from their `from_time` on, and for
    estimated errors, which are empty for components with only noise; measurements along lines have
    none. Oscillations have a column for the reason why there is no frequency.
    """
    derivatives = next((record.derivative_names for record in records if record.values), ())
    names = {**dict.fromkeys(case.plan.parameter_names), "status": None}
    if any(REGIME in record.values for record in records):
        names[REGIME] = None
    names |= FIGURES
    names["kinetic_energy"] = unit_of("kinetic_energy", case.scene.domain.n_dim)
    if any(MEASURED_ERRORS[0] in record.values for record in records):
        names |= {f"error_estimate_{name}": "%" for name in case.scene.columns}
    names |= dict.fromkeys((*derivatives, "error_estimate_extrapolated", "reason"))
    for name, column in case.scene.columns.items():
        names |= {f"{name}_{statistic}": column.units for statistic in STATISTICS}
    for name, measure in case.plan.oscillations.items():
        names |= {f"{name}_{figure}": measure.units_of(figure) for figure in OSCILLATION}
        if any(OSCILLATION_ERRORS in record.values for record in records):
            names |= {f"error_estimate_{name}_{f}": measure.units_of(f) for f in ESTIMATED}
        names[f"{name}_reason"] = None
    return names


def rows_of(case: Case, records: Sequence[RunRecord], names: Iterable[str]) -> list[Cells]:
    """Return the rows of runs, by column."""
    rows = [_row(case, record, names) for record in records]
    complete = [(row, r.values) for row, r in zip(rows, records, strict=True) if r.values]
    first = complete[0][1] if complete else {}
    for path in first:
        if not path.startswith("measure/"):
            continue
        _, name, quantity = path.split("/")
        series = np.stack([values[path] for _, values in complete])
        counted = case.plan.counted(name, first["time"])
        for figure, column in measures.statistics({quantity: series}, counted).items():
            for (row, _), value in zip(complete, column.tolist(), strict=True):
                row[f"{name}_{figure}"] = value
    for (row, values), (name, measure) in product(complete, case.plan.oscillations.items()):
        figures = statistics.oscillation_of(measure, values)
        row |= {f"{name}_{figure}": value for figure, value in figures.items()}
        missing = measures.why_missing(row.get(REGIME))
        row[f"{name}_reason"] = "" if "frequency" in figures else missing
    return rows


def _row(case: Case, record: RunRecord, names: Iterable[str]) -> Cells:
    """Return the row of a run without its measurements."""
    values = record.values
    row: Cells = {**dict.fromkeys(names), **record.point.as_dict()}
    row |= {"status": STATES[record.status], "reason": record.reason}
    row["error_estimate_extrapolated"] = BEYOND[values.get(f"{ERROR}extrapolated")]
    for name in FIGURES:
        if (value := values.get(name.replace("error_estimate_", ERROR))) is not None:
            row[name] = float(value)
    if REGIME in values:
        row[REGIME] = REGIMES[values[REGIME]]
    row |= zip(record.derivative_names, values.get("derivatives", ()), strict=True)
    if MEASURED_ERRORS[0] in values:
        pairs = np.stack([values[path] for path in MEASURED_ERRORS], axis=1).tolist()
        for column, (error, change) in zip(case.scene.columns, pairs, strict=True):
            row[f"error_estimate_{column}"] = 100.0 * error / change if change > 0.0 else None
    regime = REGIMES[values[REGIME]] if REGIME in values else None
    found = values.get(OSCILLATION_ERRORS, ())
    for name, errors in zip(case.plan.oscillations, found, strict=False):
        figures = measures.in_regime(regime, dict(zip(ESTIMATED, errors.tolist(), strict=True)))
        row |= {f"error_estimate_{name}_{figure}": error for figure, error in figures.items()}
    return row


def missing_figures(
    case: Case, rows: Sequence[Cells], records: Sequence[RunRecord]
) -> Iterator[str]:
    """Yield warnings about figures that complete runs do not have."""
    complete = [row for row in rows if row["status"] == STATES[COMPLETE]]
    for name in case.plan.oscillations:
        for reason, number in Counter(row[f"{name}_reason"] for row in complete).items():
            if reason:
                yield (
                    f"{name}: {number} of {len(complete)} runs have no frequency and no amplitude, "
                    f"and statistics leave them out: {reason}"
                )
    for name in case.scene.measured_fields if case.plan.with_weight else ():
        path = f"measure/{name}/pressure"
        if dry := sum(bool((r.values.get(path, np.ones(1)) == 0.0).any()) for r in records):
            yield (
                f"{name}: {DRY} in {dry} of {len(complete)} runs; its statistics include these "
                "zeros"
            )
    if none := [n for n in case.scene.columns if complete and complete[0][f"{n}_mean"] is None]:
        yield f"runs end before the from_time of {', '.join(none)}"


def summary(
    records: Sequence[RunRecord], rows: Sequence[Cells], names: Mapping[str, str | None]
) -> Iterator[tuple[str, ...]]:
    """Yield a row per figure: its extremes with their points, and its mean."""
    points = [record.point for record in records]
    n_complete = sum(record.status == COMPLETE for record in records)
    for name, unit in names.items():
        shown = name in FIGURES or name.endswith(SHOWN) or name.startswith("error_estimate_")
        if name == "time_step" or not shown:
            continue
        cells = zip([row[name] for row in rows], points, strict=True)
        if pairs := [(value, point) for value, point in cells if isinstance(value, float)]:
            n_runs = f" of {len(pairs)} runs" if len(pairs) < n_complete else ""
            mean = sum(value for value, _ in pairs) / len(pairs)
            least, most = (
                (format_figure(value), ", ".join(f"{n} {v:.6g}" for n, v in at.as_dict().items()))
                for value, at in (min(pairs), max(pairs))
            )
            yield (f"{name.replace('_', ' ')} [{unit}]{n_runs}", *least, format_figure(mean), *most)
