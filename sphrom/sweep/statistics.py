"""Statistics of a sweep's outputs where its points are draws: records, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.records.sweep import OutputIndices, OutputStatistics, Statistics
from sphrom.case.models import Case
from sphrom.case.points import outside
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.console import Reporter
from sphrom.metrics.sobol import SobolIndices, sobol_indices
from sphrom.metrics.uncertainty import FEWEST, counts_up_to, fewest_runs, spread
from sphrom.plots.canvas import save
from sphrom.plots.tables import format_figure, write_csv
from sphrom.plots.uncertainty import Fan, Trend, draw_fans, draw_indices, draw_trends
from sphrom.store.sweep import RunRecord
from sphrom.sweep.outputs import LINE, Output, outputs_of

Array = NDArray[np.float64]

SALTELLI = "saltelli"
FIGURES = {
    "quantiles": "Quantiles of outputs over draws of the parameters.",
    "indices": "Sobol indices of outputs at the end: the share of their variance that a parameter "
    "causes alone (first order), or has any part in (total).",
    "convergence": "Quantiles at the end from the first draws alone.",
    "index-convergence": "Sobol indices at the end from the first draws alone.",
}
"""Captions, by how the names of files end."""


@dataclass(frozen=True)
class QuantileRow:
    """A quantile, or the mean or deviation, of an output at an instant."""

    output: str
    unit: str
    at: float
    """Time [s], or the place along a line from zero to one."""
    statistic: str
    """`mean`, `deviation`, or such as `quantile 0.05`."""
    value: float
    low: float
    high: float
    """The interval's ends."""
    sampling_low: float | None
    sampling_high: float | None
    """Those of the interval by sampling alone, of quantiles."""


@dataclass(frozen=True)
class IndexRow:
    """The Sobol indices of an output at an instant, and their intervals."""

    output: str
    at: float
    parameter: str
    first: float
    first_low: float
    first_high: float
    total: float
    total_low: float
    total_high: float


@dataclass(frozen=True)
class ConvergenceRow:
    """A quantile or an index of an output at the end, of the first runs alone."""

    output: str
    figure: str
    """Such as `quantile 0.05` or `total reynolds`."""
    n_runs: int
    value: float
    low: float
    high: float


def statistics_of(case: Case, records: Sequence[RunRecord]) -> Statistics | None:
    """Return the statistics of the runs of a sweep, in the order of its points.

    None where its points are no draws, or too few runs are complete for intervals. Without
    Sobol indices where a run of their design is not.
    """
    section, sample = case.sweep, case.sweep.sample
    if sample is None or not section.levels:
        return None
    drawn = 2 * sample.count if sample.method == SALTELLI else sample.count
    results = [record.result for record in records[:drawn] if record.result is not None]
    fewest = fewest_runs(section.levels)
    if len(results) < fewest:
        return None
    counts = counts_up_to(len(results), max(FEWEST, fewest))
    model, points = sweep_model(case), sweep_points(case)[:drawn]
    beyond = 0 if model is None else sum(bool(outside(p, case.train_points)) for p in points)
    outputs = {
        output.name: _statistics(output, section.levels, counts)
        for output in outputs_of(case, results)
    }
    few, indices = _all_indices(case, records)
    return Statistics(
        levels=np.array(section.levels),
        count=np.array(counts, dtype=np.int64),
        few=np.array(few, dtype=np.int64) if few else None,
        outputs=outputs,
        indices=indices,
        n_runs=len(results),
        n_extrapolated=beyond,
        method=sample.method,
    )


def _statistics(
    output: Output, levels: tuple[float, ...], counts: Sequence[int]
) -> OutputStatistics:
    found = spread(output.values, output.errors, levels)
    at = instant_of(output.along, output.values.shape[1])
    parts = [spread(output.values[:n, at : at + 1], None, levels) for n in counts]
    return OutputStatistics.of(
        found,
        first_quantiles=np.stack([part.quantiles[:, 0] for part in parts]),
        first_interval=np.stack([part.sampling_interval[..., 0] for part in parts], axis=1),
        unit=output.unit,
        along=output.along,
        model_error="unknown" if output.errors is None else "estimated",
    )


def instant_of(along: str, n_instants: int) -> int:
    """Return which instant convergence and bars are of: the last in time, or a line's middle."""
    return n_instants // 2 if along == LINE else n_instants - 1


def _all_indices(
    case: Case, records: Sequence[RunRecord]
) -> tuple[list[int], dict[str, OutputIndices]]:
    """Return the numbers of points and the indices of all outputs; nothing where runs lack."""
    sample = case.sweep.sample
    results = [record.result for record in records if record.result is not None]
    if sample is None or sample.method != SALTELLI or len(results) < len(records):
        return [], {}
    few = counts_up_to(sample.count, min(FEWEST, sample.count))
    names, n_parameters = case.parameter_names, len(sample.entries)
    # Of the parameters in the order of the points; one that isn't drawn has no part in anything.
    rows = [list(sample.entries).index(name) if name in sample.entries else -1 for name in names]
    found = {}
    for output in outputs_of(case, results):
        whole = sobol_indices(output.values, n_parameters)
        at = instant_of(output.along, output.values.shape[1])
        blocks = output.values[:, at].reshape(n_parameters + 2, -1)
        parts = [sobol_indices(blocks[:, :n].reshape(-1, 1), n_parameters) for n in few]
        found[output.name] = _indices(whole, parts, rows)
    return [n * (n_parameters + 2) for n in few], found


def _indices(
    whole: SobolIndices, parts: Sequence[SobolIndices], rows: Sequence[int]
) -> OutputIndices:
    def of(values: Array, axis: int) -> Array:
        """Return rows of parameters, zero for those that aren't drawn."""
        padded = np.concatenate((values, np.zeros_like(values.take([0], axis))), axis)
        return padded.take(rows, axis)

    return OutputIndices(
        first=of(whole.first, 0),
        first_interval=of(whole.first_interval, 1),
        total=of(whole.total, 0),
        total_interval=of(whole.total_interval, 1),
        first_of_few=np.stack([of(part.first, 0)[:, 0] for part in parts]),
        first_of_few_interval=np.stack([of(p.first_interval, 1)[..., 0] for p in parts], axis=1),
        total_of_few=np.stack([of(part.total, 0)[:, 0] for part in parts]),
        total_of_few_interval=np.stack([of(p.total_interval, 1)[..., 0] for p in parts], axis=1),
    )


def publish(case: Case, path: Path, records: Sequence[RunRecord], found: Statistics | None) -> None:
    """Write tables and figures of statistics beside a sweep's artifact, or remove old ones."""
    for kind in FIGURES:
        for suffix in ("csv", "png"):
            beside(path, kind, suffix).unlink(missing_ok=True)
    if found is None:
        return
    time = next(record.result.time for record in records if record.result is not None)
    write_tables(path, found, case.parameter_names, time)
    if case.compare.plots:
        draw(path, found, case.parameter_names, time)


def write_tables(path: Path, found: Statistics, names: Sequence[str], time: Array) -> None:
    """Write the tables of a sweep beside its artifact."""
    tables: dict[str, list[Any]] = {
        "quantiles": list(_quantile_rows(found, time)),
        "indices": list(_index_rows(found, names, time)),
        "convergence": list(_convergence_rows(found, names)),
    }
    for kind, rows in tables.items():
        if rows:
            write_csv(beside(path, kind, "csv"), rows)


def beside(path: Path, kind: str, suffix: str) -> Path:
    """Return the file of a kind beside a sweep's artifact, such as `sweep-fast-quantiles.csv`."""
    return path.with_name(f"{path.stem}-{kind}.{suffix}")


def _instants(along: str, n_instants: int, time: Array) -> list[float]:
    return (np.linspace(0.0, 1.0, n_instants) if along == LINE else time).tolist()


def _quantile_rows(found: Statistics, time: Array) -> Iterator[QuantileRow]:
    for name, each in found.outputs.items():
        named: dict[str, tuple[Array, Array, Array | None]] = {}
        named["mean"] = each.mean, each.mean_interval, None
        named["deviation"] = each.deviation, each.deviation_interval, None
        for i, level in enumerate(found.levels):
            ends = each.interval[:, i], each.sampling_interval[:, i]
            named[f"quantile {level:g}"] = each.quantiles[i], *ends
        for k, at in enumerate(_instants(each.along, len(each.mean), time)):
            for word, (values, ends_of, sampling) in named.items():
                low, high = ends_of[:, k].tolist()
                by_sampling = (None, None) if sampling is None else sampling[:, k].tolist()
                value = float(values[k])
                yield QuantileRow(name, each.unit, at, word, value, low, high, *by_sampling)


def _index_rows(found: Statistics, names: Sequence[str], time: Array) -> Iterator[IndexRow]:
    for name, each in found.indices.items():
        instants = _instants(found.outputs[name].along, each.first.shape[1], time)
        for k, at in enumerate(instants):
            for i, parameter in enumerate(names):
                first_low, first_high = each.first_interval[:, i, k].tolist()
                total_low, total_high = each.total_interval[:, i, k].tolist()
                first, total = float(each.first[i, k]), float(each.total[i, k])
                about = name, at, parameter
                yield IndexRow(*about, first, first_low, first_high, total, total_low, total_high)


def _convergence_rows(found: Statistics, names: Sequence[str]) -> Iterator[ConvergenceRow]:
    for found_trends in (_trends(found), _index_trends(found, names)):
        for name, trends in found_trends.items():
            for label, trend in trends.items():
                columns = (trend.count, trend.value, *trend.interval)
                for row in zip(*(column.tolist() for column in columns), strict=True):
                    yield ConvergenceRow(name, label, *row)


def _trends(found: Statistics) -> dict[str, dict[str, Trend]]:
    """Return how quantiles at the end change with the number of runs, by output and quantile."""
    return {
        name: {
            f"quantile {level:g}": Trend(
                found.count, each.first_quantiles[:, i], each.first_interval[..., i]
            )
            for i, level in enumerate(found.levels)
        }
        for name, each in found.outputs.items()
    }


def _index_trends(found: Statistics, names: Sequence[str]) -> dict[str, dict[str, Trend]]:
    """Return how Sobol indices at the end change with the number of runs."""
    if found.few is None:
        return {}
    trends: dict[str, dict[str, Trend]] = {name: {} for name in found.indices}
    for name, index in found.indices.items():
        for i, parameter in enumerate(names):
            for order in ("first", "total"):
                values = getattr(index, f"{order}_of_few")[:, i]
                ends = getattr(index, f"{order}_of_few_interval")[..., i]
                trends[name][f"{order} {parameter}"] = Trend(found.few, values, ends)
    return trends


def draw(path: Path, found: Statistics, names: Sequence[str], time: Array) -> None:
    """Draw the figures of a sweep beside its artifact."""
    fans = {
        name: Fan(
            np.array(_instants(each.along, len(each.mean), time)),
            "time [s]" if each.along != LINE else "place along the line [–]",
            f"{_words(name)} [{each.unit}]",
            found.levels, each.quantiles, each.interval, each.mean,
        )
        for name, each in found.outputs.items()
    }  # fmt: skip
    figures = {"quantiles": draw_fans(fans)}
    trends = {fans[name].label: each for name, each in _trends(found).items()}
    figures["convergence"] = draw_trends(trends)
    if found.indices:
        bars = {
            _words(name): _bars(each, instant_of(found.outputs[name].along, each.first.shape[1]))
            for name, each in found.indices.items()
        }
        figures["indices"] = draw_indices(bars, [_words(name) for name in names])
        shares = _index_trends(found, names).items()
        trends = {f"{_words(name)}: index [–]": each for name, each in shares}
        figures["index-convergence"] = draw_trends(trends)
    for kind, figure in figures.items():
        save(figure, beside(path, kind, "png"))


def _bars(each: OutputIndices, at: int) -> Mapping[str, tuple[Array, Array]]:
    """Return both orders at an instant, values (n_parameters,) and ends (2, n_parameters)."""
    return {
        "first order": (each.first[:, at], each.first_interval[..., at]),
        "total": (each.total[:, at], each.total_interval[..., at]),
    }


def _words(name: str) -> str:
    return name.replace("_", " ")


def show(report: Reporter, found: Statistics) -> None:
    """Report the statistics of all outputs at the end, and what their reader has to know."""
    middle = int(np.argmin(np.abs(found.levels - 0.5)))
    levels = [f"{100.0 * level:g} %" for level in found.levels]
    rows = []
    for name, each in found.outputs.items():
        at = instant_of(each.along, len(each.mean))
        half = 0.5 * float(np.ptp(each.interval[:, middle, at]))
        cells = [each.mean[at], each.deviation[at], *each.quantiles[:, at], half]
        shown = [format_figure(float(cell)) for cell in cells]
        rows.append((f"{_words(name)} [{each.unit}]", *shown))
    report.table(
        f"statistics of {found.n_runs} runs at the end (of a line, in its middle)",
        ("output", "mean", "deviation", *levels, f"{levels[middle]} within +-"),
        rows,
    )
    for warning in told(found):
        report.warn(warning)


def told(found: Statistics) -> Iterator[str]:
    """Yield what the reader of statistics has to know, as warnings."""
    if found.n_extrapolated:
        drawn = found.n_runs
        yield (
            f"statistics: {found.n_extrapolated} of {drawn} draws are outside of the trained range"
        )
    if found.method == SALTELLI and not found.indices:
        yield "statistics: there are no Sobol indices, as a run of their design has no result"
    unknown = [name for name, each in found.outputs.items() if each.model_error == "unknown"]
    if unknown:
        yield f"intervals of {', '.join(unknown)} are of sampling alone: no error is estimated"


def as_asked(case: Case, stored: Statistics | None) -> bool:
    """Return whether an artifact holds the statistics that a case asks for."""
    levels, sample = case.sweep.levels, case.sweep.sample
    if stored is None or sample is None or not levels:
        return stored is None and not levels
    return stored.method == sample.method and stored.levels.tolist() == list(levels)
