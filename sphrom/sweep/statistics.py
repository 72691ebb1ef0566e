"""Statistics of the outputs of a sweep with sampled points: records, tables and figures.

An output is a quantity over time, its mean over time, or a profile along a line at the end of runs.
Errors of measurements follow from those of training runs (`output_errors`). The error of the
kinetic energy M U^2 / 2 is at most M (U e_u + e_u^2 / 2), with U the root mean square of the
velocity, e_u that of its error, and M the mass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.sweep import OutputIndices, OutputStatistics, Statistics
from sphrom.case.models import Case
from sphrom.case.studies import sweep_model
from sphrom.console import Reporter
from sphrom.metrics.draws import Along, fewest_runs, sobol_indices, spread
from sphrom.metrics.measures import Oscillating, in_regime
from sphrom.metrics.quantities import MEASURABLE, components, unit_of
from sphrom.metrics.series import OSCILLATION, REGIMES
from sphrom.plots.panels import Curve, Panel, draw_grid, save
from sphrom.plots.tables import format_figure, rows_of_columns, write_csv
from sphrom.reduction.error_calibration import field_of, output_errors
from sphrom.setup.assembly import sound_averages
from sphrom.store.workspace import Workspace
from sphrom.sweep.batches import ERROR, MISSED, OVER_TIME, REGIME, RunRecord, SweptModel
from sphrom.text import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Values = Sequence[Mapping[str, Any]]
"""The values of complete runs, as in their records."""

SALTELLI = "saltelli"
FIGURES = {
    "quantiles": "Quantiles of outputs over draws of the parameters.",
    "indices": "Sobol indices of outputs: the share of the variance due to a parameter alone (first"
    " order), or including its interactions (total). Grey is the share of the model's error.",
}
"""Captions of figures, by the suffix of their file names."""
QUANTILE_COLUMNS = (
    *("output", "unit", "at", "statistic", "value", "low", "high"),
    *("sampling_low", "sampling_high"),
)
"""Columns of the table of quantiles; means and deviations have no interval by sampling alone."""
INDEX_COLUMNS = (
    *("output", "at", "parameter"),
    *("first", "first_low", "first_high", "total", "total_low", "total_high"),
)
FINAL = "final_"
"""Prefix of the names of profiles along lines at the end of runs."""
TIME: Along = "time"
MEAN: Along = "mean"
LINE: Along = "line"
NOISY = 0.2
"""Share of the model's error in the variance of an output above which there is a warning. At this
share, the error is half of the spread, and indices may be wrong by about the share."""
COLUMNS = 3
"""Columns of panels in figures."""


@dataclass(frozen=True)
class Output:
    """A quantity of all runs: over time, its mean over time, or along a line at the end."""

    name: str
    unit: str
    along: Along
    values: Array
    """(n_runs, n_instants)."""
    errors: Array | None
    """(n_runs, n_instants) estimated errors, None if unknown."""


def outputs_of(case: Case, runs: Values, trained: Values = ()) -> Iterator[Output]:
    """Yield the outputs of complete runs: kinetic energy, and the measurements of the case.

    They are followed by means over the times since `from_time`, and by figures of oscillations,
    which are NaN for runs without one. `trained` are the differences from `SweptModel.in_training`.
    """
    over_time = _stacked(runs)
    differences = _stacked(trained)
    yield from _outputs(case, TIME, over_time, differences)
    if len(runs) and case.plan.counted("", runs[0]["time"]).any():
        time = runs[0]["time"]
        means = _averaged(case, over_time, time)
        yield from _outputs(case, MEAN, means, _averaged(case, differences, time))
    for name, measure in case.plan.oscillations.items():
        found = [oscillation_of(measure, values) for values in runs]
        for figure in OSCILLATION[:3]:
            values = np.array([[figures.get(figure, np.nan)] for figures in found])
            yield Output(f"{name}_{figure}", measure.units_of(figure), MEAN, values, None)


def oscillation_of(measure: Oscillating, values: Mapping[str, Any]) -> dict[str, float]:
    """Return the oscillation in a run from the values of its record."""
    measured = {measure.quantity: values[f"measure/{measure.measure}/{measure.quantity}"]}
    regime = REGIMES[values[REGIME]] if REGIME in values else None
    return in_regime(regime, measure.of(values["time"], measured))


def regimes_in_words(found: Iterable[int]) -> str:
    """Return the number of runs in each regime; `found` has indices of REGIMES."""
    counts = Counter(found)
    words = (f"{counted(counts[k], 'run')} {name}" for k, name in enumerate(REGIMES) if counts[k])
    return ", ".join(words)


def _stacked(runs: Values) -> dict[str, Array]:
    """Return the energies and measurements that all runs have (n_runs, ...), by name.

    Errors over the fluid (n_runs, n_snapshots, 2) are those of velocity and pressure.
    """
    arrays = {
        name: np.stack([values[name] for values in runs])
        for name in (runs[0] if runs else ())
        if name.startswith(("measure/", MISSED)) or name.endswith("_over_time")
        if all(name in values for values in runs)
    }
    if OVER_TIME[0] in arrays:
        arrays[ERROR] = np.stack([arrays.pop(path) for path in OVER_TIME], axis=-1)
    return arrays


def _averaged(case: Case, over_time: Mapping[str, Array], time: Array) -> dict[str, Array]:
    """Return means over time (n_runs, 1, ...), and root mean squares of errors over the fluid.

    Training runs may be shorter than other runs, or longer.
    """
    means = {path: values for path, values in over_time.items() if path.startswith(MISSED)}
    for path in over_time.keys() - means:
        _, name, quantity = path.split("/") if path.startswith("measure/") else ("", "", path)
        common = over_time[path][:, : len(time)]
        late = common[:, case.plan.counted(name, time[: common.shape[1]])]
        if late.size and not quantity.startswith(FINAL):
            power = 2.0 if path == ERROR else 1.0
            means[path] = np.mean(late**power, axis=1, keepdims=True) ** (1.0 / power)
    return means


def _outputs(
    case: Case, along: Along, runs: Mapping[str, Array], trained: Mapping[str, Array]
) -> Iterator[Output]:
    ending = "_mean" if along == MEAN else ""
    over_fluid = runs.get(ERROR)
    energies = runs["kinetic_energy_over_time"]
    energy_errors = None
    if over_fluid is not None:
        mass = case.plan.mass * case.plan.n_particles
        error = over_fluid[..., 0]
        energy_errors = mass * (np.sqrt(2.0 * energies / mass) * error + 0.5 * error**2)
    n_dim = case.scene.domain.n_dim
    unit = unit_of("kinetic_energy", n_dim)
    yield Output(f"kinetic_energy{ending}", unit, along, energies, energy_errors)
    for name, prefix, quantity in product(case.scene.measure, ("", FINAL), MEASURABLE):
        if (path := f"measure/{name}/{prefix}{quantity}") not in runs:
            continue
        parts: Mapping[str, Array] = {}
        if over_fluid is not None and path in trained:
            differences = trained[path]
            fields, estimated = (of[..., field_of(quantity)] for of in (trained[ERROR], over_fluid))
            if prefix:  # the end alone
                differences = differences[:, None]
                fields, estimated = fields[:, -1:], estimated[:, -1:]
            missed = trained[f"{MISSED}{path}"].mean(axis=0).reshape(differences.shape[2:])
            model_error = output_errors(differences, fields, missed, sound_averages(case))
            errors = model_error.at(estimated)
            parts = components(quantity, errors[:, 0] if prefix else errors)
        for component, values in components(quantity, runs[path]).items():
            column = f"{name}_{prefix}{component}{ending}"
            kind = LINE if prefix else along
            yield Output(column, unit_of(quantity, n_dim), kind, values, parts.get(component))


def statistics_of(workspace: Workspace, records: Sequence[RunRecord]) -> Statistics | None:
    """Return the statistics of the runs of a sweep, in the order of its points.

    Returns None if the points are not a sample, or too few runs are complete for intervals. Sobol
    indices need all runs of their design to be complete.
    """
    case = workspace.case
    section = case.sweep
    sample = section.sample
    if sample is None or not section.levels:
        return None
    drawn = 2 * sample.count if sample.method == SALTELLI else sample.count
    complete = [record for record in records[:drawn] if record.values]
    if len(complete) < fewest_runs(section.levels):
        return None
    runs = [run.values for run in complete]
    trained = SweptModel(workspace).in_training([r.point for r in records if r.values])
    points = [record.point for record in complete] if sweep_model(case) is not None else []
    beyond = sum(case.plan.beyond_training(point) is not None for point in points)
    return Statistics(
        levels=np.array(section.levels),
        outputs={
            output.name: spread(
                output.values, output.errors, section.levels, output.unit, output.along
            )
            for output in map(existing, outputs_of(case, runs, trained))
            if len(output.values) >= fewest_runs(section.levels)
        },
        indices=_indices(case, records) if sample.method == SALTELLI else {},
        n_runs=len(runs),
        n_extrapolated=beyond,
        method=sample.method,
    )


def existing(output: Output) -> Output:
    """Return an output of those runs that have it."""
    has = np.isfinite(output.values).all(axis=1)
    errors = None if output.errors is None else output.errors[has]
    return replace(output, values=output.values[has], errors=errors)


def _indices(case: Case, records: Sequence[RunRecord]) -> dict[str, OutputIndices]:
    """Return the Sobol indices of all outputs; none if runs are incomplete."""
    runs = [record.values for record in records if record.values]
    if case.sweep.sample is None or len(runs) < len(records):
        return {}
    drawn = list(case.sweep.sample.entries)
    names = case.plan.parameter_names

    def of_all(values: Array) -> Array:
        """Return rows for all parameters, with zeros for parameters that are not drawn."""
        rows = np.zeros((*values.shape[:-2], len(names), values.shape[-1]))
        rows[..., [names.index(name) for name in drawn], :] = values
        return rows

    return {
        output.name: sobol_indices(output.values, len(drawn)).mapped(of_all)
        for output in outputs_of(case, runs)
        if np.isfinite(output.values).all()
    }


def publish(
    case: Case, path: Path, records: Sequence[RunRecord], result: Statistics | None
) -> None:
    """Write tables and figures of statistics beside a sweep's artifact, and remove old ones."""
    for kind in FIGURES:
        for suffix in ("csv", "png"):
            beside(path, kind, suffix).unlink(missing_ok=True)
    if result is None:
        return
    time = next(r.values["time"] for r in records if r.values)
    names = case.plan.parameter_names
    quantiles = _quantile_rows(result, time)
    indices = _index_rows(result, names, time)
    for kind, rows in {"quantiles": quantiles, "indices": indices}.items():
        if cells := list(rows):
            write_csv(beside(path, kind, "csv"), rows_of_columns(dict.fromkeys(cells[0]), cells))
    if case.compare.plots is not False:
        save(draw_quantiles(result, time), beside(path, "quantiles", "png"))
        if result.indices:
            save(draw_indices(result, names, time), beside(path, "indices", "png"))


def beside(path: Path, kind: str, suffix: str) -> Path:
    """Return the path of a file beside a sweep's artifact, such as `sweep-fast-quantiles.csv`."""
    return path.with_name(f"{path.stem}-{kind}.{suffix}")


def _instants(along: str, n_instants: int, time: Array) -> Array:
    return np.linspace(0.0, 1.0, n_instants) if along == LINE else time[-n_instants:]


def _quantile_rows(result: Statistics, time: Array) -> Iterator[dict[str, Any]]:
    """Yield mean, deviation and quantiles of each output at each time, with their intervals.

    `at` is the time [s]. It is the final time for means over time, and for lines the place on the
    line, from zero to one.
    """
    for name, output in result.outputs.items():
        rows = {
            "mean": np.vstack((output.mean, output.mean_interval)),
            "deviation": np.vstack((output.deviation, output.deviation_interval)),
        }
        for i, level in enumerate(result.levels):
            ends = output.interval[:, i], output.sampling_interval[:, i]
            rows[f"quantile {level:g}"] = np.vstack((output.quantiles[i], *ends))
        for k, at in enumerate(_instants(output.along, len(output.mean), time).tolist()):
            for statistic, figures in rows.items():
                cells = (name, output.unit, at, statistic, *figures[:, k].tolist())
                yield dict(zip_longest(QUANTILE_COLUMNS, cells))


def _index_rows(result: Statistics, names: Sequence[str], time: Array) -> Iterator[dict[str, Any]]:
    """Yield the Sobol indices of each output, at each time, for each parameter."""
    for name, index in result.indices.items():
        first = index.first[None], index.first_interval
        figures = np.concatenate((*first, index.total[None], index.total_interval))
        instants = _instants(result.outputs[name].along, figures.shape[2], time)
        for k, at in enumerate(instants.tolist()):
            for i, parameter in enumerate(names):
                cells = (name, at, parameter, *figures[:, i, k].tolist())
                yield dict(zip(INDEX_COLUMNS, cells, strict=True))


def draw_quantiles(result: Statistics, time: Array) -> Figure:
    """Draw quantiles over time, or along a line, with one panel per output."""

    def curves(name: str, x: Array) -> Iterator[Curve]:
        output = result.outputs[name]
        for level, values in zip(result.levels, output.quantiles, strict=True):
            yield Curve(f"{100.0 * level:g} %", x, values)
        yield Curve("mean", x, output.mean, "full")
        for end, values in (("lowest", output.interval[0, 0]), ("highest", output.interval[1, -1])):
            yield Curve(f"{end} end of intervals", x, values, "level")

    return _draw(result, time, curves)


def draw_indices(result: Statistics, parameters: Sequence[str], time: Array) -> Figure:
    """Draw Sobol indices with their intervals, with one panel per output.

    Grey lines are the share of the model's error in the variance of full runs.
    """

    def curves(name: str, x: Array) -> Iterator[Curve]:
        index = result.indices[name]
        first = "first order", index.first, index.first_interval
        total = "total", index.total, index.total_interval
        for k, parameter in enumerate(parameters):
            for order, values, interval in (first, total):
                yield Curve(f"{parameter}, {order}", x, values[k], interval=interval[:, k])
        if (share := result.outputs[name].error_share) is not None:
            yield Curve("the model's error", x, share, "level")

    return _draw(result, time, curves, "Sobol index [–]")


def _draw(
    result: Statistics,
    time: Array,
    curves: Callable[[str, Array], Iterator[Curve]],
    label: str | None = None,
) -> Figure:
    panels = []
    for name, output in result.outputs.items():
        if output.along != MEAN:
            x = _instants(output.along, len(output.mean), time)
            along = "place along the line [–]" if output.along == LINE else "time [s]"
            title = name.replace("_", " ")
            shown = label or f"[{output.unit}]"
            panels.append(Panel(title, along, shown, [*curves(name, x)]))
    return draw_grid([panels[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)])


def _shown(output: OutputStatistics) -> int:
    """Return the index of the printed value: the final time, or the middle of a line."""
    return len(output.mean) // 2 if output.along == LINE else -1


def show(report: Reporter, result: Statistics) -> None:
    """Report the statistics of all outputs at the end, and warnings about them."""
    middle = int(np.argmin(np.abs(result.levels - 0.5)))
    levels = [f"{100.0 * level:g} %" for level in result.levels]
    rows = []
    for name, output in result.outputs.items():
        at = _shown(output)
        half = 0.5 * float(np.ptp(output.interval[:, middle, at]))
        cells = [output.mean[at], output.deviation[at], *output.quantiles[:, at], half]
        shown = [format_figure(float(cell)) for cell in cells]
        rows.append((f"{name.replace('_', ' ')} [{output.unit}]", *shown))
    report.table(
        f"statistics of {result.n_runs} runs at the final time; profiles at mid-line",
        ("output", "mean", "deviation", *levels, f"{levels[middle]} within +-"),
        rows,
    )
    if result.n_extrapolated:
        report.warn(
            f"statistics: {result.n_extrapolated} of {result.n_runs} draws are outside of the "
            "training points"
        )
    if result.method == SALTELLI and not result.indices:
        report.warn("statistics: no Sobol indices, because a run that they need has no result")
    shares = {}
    for name, output in result.outputs.items():
        if (share := output.error_share) is not None:
            over_all = np.average(share, weights=output.deviation**2 + np.finfo(float).tiny)
            shares[name] = max(float(over_all), float(share[_shown(output)]))
    if noisy := [name for name, share in shares.items() if share > NOISY]:
        names = ", ".join(f"{name} ({100.0 * shares[name]:.0f} %)" for name in noisy)
        means = [f"{name}_mean" for name in noisy if shares.get(f"{name}_mean", 1.0) <= NOISY]
        less = f"; it is below {100.0 * NOISY:.0f} % for {', '.join(means)}" if means else ""
        report.warn(
            f"full runs may give other quantiles and Sobol indices of {names}: the percentage is "
            f"the share of the model's estimated error in the variance{less}"
        )
    if unknown := ", ".join(k for k, v in result.outputs.items() if v.model_error == "unknown"):
        report.warn(
            f"intervals of {unknown} include the sampling error only, because there is no error "
            "estimate"
        )
