"""Ranges in which models are stable and accurate, from runs at extremes.

A run is right if its errors are at most twice those of the default, which is the case's own model
at its first test point or else training point. For full runs, the default is the change due to half
the resolution. The module also writes tables and draws maps of the ranges.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from sphrom.case.model_sections import PROJECTIONS
from sphrom.errors import CaseError, ResourceError
from sphrom.models.stable_ranges import FILE, MEMORY, MOST_ERROR, STEP, TIME, UNITS, StableRange
from sphrom.plots.panels import new_figure, save, styled
from sphrom.plots.tables import format_figure, write_csv, write_json
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA
from sphrom.store.workspace import Workspace
from sphrom.text import counted
from sphrom.trade.candidates import FOLDER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ONE_RUN = "reynolds, one training run"
COARSE = ("Mach number", "h/dx")
"""Quantities that vary in full models of half the resolution."""
HALF = "half as fine"
PERCENT = {"unit": "%"}
Errors = tuple[float, float]
"""Errors of velocity and pressure [%]."""
Kind = Literal["full", "particles", "fast"]
State = Literal["", "right", "stable", "unstable", "refused"]
COLOURS = {"right": "#9fd8c4", "stable": "#f4d58d", "unstable": "#e8906a", "refused": "#d9d9d9"}
HEADINGS = ("model", "right", "stable", "wrong below", "wrong above", "predicted")
OVER = {
    STEP: " over the automatic one",
    MEMORY: " over the automatic one",
    TIME: " over the trained one",
}
ALL_WRONG = 100.0
"""Errors above which a run is not a result [%]."""
WIDTH, HEIGHT, ABOUT, LETTERS = 8.5, 0.28, 0.55, 6.7
"""Width of maps, height of a row and of title with labels [inch], and font size in cells."""
FINE_BELOW = (STEP, MEMORY, TIME)
"""Quantities without a lower limit, also below the least value of the runs."""


@dataclass(kw_only=True)
class ExtremeRun:
    """One run at the extremes."""

    varied: str
    value: float
    """Value of the varied quantity: steps and memories over automatic ones, times over trained."""
    parameters: str
    kind: Kind
    projection: str = ""
    n_modes: int | None = None
    steps: str = ""
    """`exponential` or `runge-kutta` for a fast model; the difference of a varied full model."""
    time_step: float | None = field(default=None, metadata={"unit": "s"})
    memory_length: float | None = field(default=None, metadata={"unit": "s"})
    end_time: float | None = field(default=None, metadata={"unit": "s"})
    state: State = ""
    mechanism: str = ""
    """The cause of its error or instability, or of the first instability to expect."""
    predicted: float | None = None
    """The greatest stable value, by formula or eigenvalue."""
    velocity_error: float | None = field(default=None, metadata=PERCENT)
    pressure_error: float | None = field(default=None, metadata=PERCENT)
    velocity_best: float | None = field(default=None, metadata=PERCENT)
    """Error of the nearest state in the basis."""
    pressure_best: float | None = field(default=None, metadata=PERCENT)
    velocity_estimate: float | None = field(default=None, metadata=PERCENT)
    pressure_estimate: float | None = field(default=None, metadata=PERCENT)
    diverged_at: float | None = field(default=None, metadata={"unit": "s"})
    reason: str = ""
    """The reason why it was unstable or refused."""
    extrapolated: bool = False
    """Whether it is outside of the trained values or times."""
    told: str = ""
    """Warnings of the run itself about its result."""

    def failed(self, error: Exception) -> ExtremeRun:
        """Set the state of a run that was refused, or became unstable."""
        refused = isinstance(error, CaseError | ResourceError)
        self.state = "refused" if refused else "unstable"
        self.reason = str(error)
        return self

    @property
    def model(self) -> str:
        """The label of the model."""
        if self.kind == "full":
            return f"full{self.steps}"
        name = PROJECTIONS[self.projection]
        place = ", on particles" if self.kind == "particles" else ""
        scheme = ", Runge-Kutta" if self.steps == RUNGE_KUTTA else ""
        return f"{name}, M = {self.n_modes}{place}{scheme}"

    @property
    def of_model(self) -> tuple[str, str, int | None]:
        """The kind of the model, its projection and its size."""
        return self.kind, self.projection, self.n_modes

    @property
    def errors(self) -> Errors | None:
        """Errors of velocity and pressure [%]."""
        return _both(self.velocity_error, self.pressure_error)

    @property
    def natural(self) -> float:
        """The value, in seconds if `value` is a ratio of times."""
        seconds = {STEP: self.time_step, MEMORY: self.memory_length, TIME: self.end_time}
        return seconds.get(self.varied) or self.value


def _both(velocity: float | None, pressure: float | None) -> Errors | None:
    return None if velocity is None or pressure is None else (velocity, pressure)


def judge(runs: Sequence[ExtremeRun], default: tuple[str, int], own: Mapping[str, float]) -> None:
    """Set the state of each run (right, wrong or unstable), and the mechanism of its errors.

    Parameters
    ----------
    default : projection and size of the model whose errors set the limit.
    own : the case's own values of the varied quantities.
    """
    by_default = {
        (run.varied, run.of_model): run.errors
        for run in runs
        if run.value == 1.0 and run.steps != RUNGE_KUTTA
    }
    standard = _default_of(runs, default)
    half = (r for r in runs if r.parameters == standard.parameters and HALF in r.steps)
    of_full = next((run.errors for run in half), None)
    for run in runs:
        allowed = standard.errors
        if run.kind == "full":
            allowed = of_full
        elif run.varied in COARSE:
            # Models of half the resolution are judged by the default model at that resolution.
            of_map = (r for r in runs if r.varied == run.varied and r.errors)
            same = [r for r in of_map if r.of_model == standard.of_model]
            nearest = min(same, key=lambda r: abs(r.value - own[r.varied]), default=standard)
            allowed = nearest.errors
        run.state = run.state or _state(run, allowed)
        if run.state == "stable":
            usual = by_default.get((run.varied, run.of_model))
            run.mechanism = _cause(run, allowed, _within(usual, allowed))


def _default_of(runs: Sequence[ExtremeRun], default: tuple[str, int]) -> ExtremeRun:
    usual = (r for r in runs if (r.varied, r.value, r.steps) == (STEP, 1.0, EXPONENTIAL))
    return next(r for r in usual if r.of_model == ("fast", *default))


def _within(errors: Errors | None, allowed: Errors | None) -> bool:
    if errors is None or allowed is None:
        return False
    return all(a <= MOST_ERROR * b for a, b in zip(errors, allowed, strict=True))


def _state(run: ExtremeRun, allowed: Errors | None) -> State:
    same = run.kind == "full" and run.velocity_error == 0.0
    return "right" if same or _within(run.errors, allowed) else "stable"


def _cause(run: ExtremeRun, allowed: Errors | None, right_by_default: bool) -> str:
    """Return the cause of a stable run's errors; empty if unknown."""
    if run.errors is None or allowed is None:
        return ""
    if run.kind == "full":
        causes = {"Mach number": "compressibility", "h/dx": "smoothing", STEP: run.mechanism}
        return causes.get(run.varied, "spacing")
    before = "extrapolated " if run.extrapolated else ""
    best = _both(run.velocity_best, run.pressure_best)
    if best is not None and not _within(best, allowed):
        return f"{before}modes"
    if right_by_default and run.varied == STEP:
        # Errors by sound are almost entirely in the pressure.
        carried = run.steps == EXPONENTIAL or run.errors[0] > MOST_ERROR * allowed[0]
        return "convection" if carried else "sound"
    if right_by_default and run.varied == MEMORY:
        return "closure"
    return f"{before}rates"


def ranges_in(
    runs: Sequence[ExtremeRun], default: tuple[str, int], own: Mapping[str, float]
) -> Iterator[StableRange]:
    """Yield the ranges of each model; `own` are the case's own values by quantity."""
    own_run = _default_of(runs, default)
    for series in _series(runs):
        first, values = series[0], [run.natural for run in series]
        at = own.get(first.varied, 1.0)
        k = min(range(len(series)), key=lambda i: abs(series[i].value - at))
        stable = _around(k, [run.state in ("right", "stable") for run in series])
        right = _around(k, [run.state == "right" for run in series])
        low, high = right or stable or (k, k)
        least = 0.0 if first.varied in FINE_BELOW else values[0]
        lower = [least, *values[1:]]
        predicted, by = _predicted(series[k:], own_run)
        yield StableRange(
            varied=first.varied,
            kind=first.kind,
            projection=first.projection,
            n_modes=first.n_modes,
            steps=first.steps,
            right_from=None if right is None else lower[low],
            right_to=None if right is None else values[high],
            stable_from=None if stable is None else lower[stable[0]],
            stable_to=None if stable is None else values[stable[1]],
            least=least,
            greatest=values[-1],
            below=series[low - 1].mechanism if low > 0 else "",
            above=series[high + 1].mechanism if high + 1 < len(series) else "",
            predicted=predicted,
            predicted_by=by,
        )


def _series(runs: Sequence[ExtremeRun]) -> list[list[ExtremeRun]]:
    """Return the runs of each model and varied quantity, ordered by value."""
    series: dict[tuple[str, str], list[ExtremeRun]] = {}
    for run in runs:
        series.setdefault((run.varied, run.model), []).append(run)
    return [sorted(found, key=lambda run: run.value) for found in series.values()]


def _around(k: int, good: Sequence[bool]) -> tuple[int, int] | None:
    """Return the first and last index of the good values around index k; None if k is not good."""
    if not good[k]:
        return None
    bad = np.flatnonzero(np.logical_not(good))
    return int(bad[bad < k].max(initial=-1)) + 1, int(bad[bad > k].min(initial=len(good))) - 1


def _predicted(series: Sequence[ExtremeRun], own: ExtremeRun) -> tuple[float | None, str]:
    """Return the greatest value that is predicted to be stable or right, and the method."""
    first = series[0]
    if first.predicted is not None:
        method = "formula" if first.kind == "full" else "eigenvalue"
        return first.predicted * first.natural / first.value, method
    estimates = (_both(run.velocity_estimate, run.pressure_estimate) for run in series)
    last = _around(0, [_within(estimate, own.errors) for estimate in estimates])
    return (None, "") if last is None else (series[last[1]].natural, "estimate")


def publish(
    workspace: Workspace,
    runs: Sequence[ExtremeRun],
    default: tuple[str, int],
    own: Mapping[str, float],
    notes: Sequence[str],
) -> None:
    """Judge the runs, write their tables and maps, and show the ranges of the models."""
    judge(runs, default, own)
    ranges = list(ranges_in(runs, default, own))
    report = workspace.context.report
    write_csv(workspace.folder(FOLDER) / "extremes.csv", runs)
    write_json(
        workspace.out / FILE,
        {"extremes": runs, "ranges": ranges},
        workspace.case.name,
        workspace.threads,
        basis=workspace.basis().inputs_digest,
    )
    save(draw_maps(runs), workspace.folder(FOLDER) / "extremes.png")
    rows: dict[str, list[tuple[str, ...]]] = {}
    for found, series in zip(ranges, _series(runs), strict=True):
        rows.setdefault(found.varied, []).append(_cells(found, series[0].model))
    for varied, cells in rows.items():
        report.table(f"{varied}{UNITS.get(varied, '')}", HEADINGS, cells)
    if (own_run := _default_of(runs, default)).errors is not None:
        velocity, pressure = (MOST_ERROR * error for error in own_run.errors)
        report.info(
            f"right means errors of at most {format_figure(velocity)} % in velocity and "
            f"{format_figure(pressure)} % in pressure, twice those of {own_run.model} at "
            f"{own_run.parameters}"
        )
    for note in (*notes, *dict.fromkeys(r.reason for r in runs if r.state == "refused")):
        report.info(note)
    fast = (run for run in runs if run.kind == "fast" and not run.told)
    silent = sum(max(run.errors or (0.0,)) > ALL_WRONG for run in fast)
    counts = ", ".join(f"{sum(r.state == state for r in runs)} {state}" for state in COLOURS)
    report.result(
        f"{counted(len(runs), 'run')}: {counts}; {silent} with errors above {ALL_WRONG:g} % gave "
        "no warning"
    )
    report.result(f"extremes.csv, extremes.json and extremes.png are in {workspace.out / FOLDER}")


def _cells(found: StableRange, model: str) -> tuple[str, ...]:
    right = _span(found.right_from, found.right_to)
    stable = _span(found.stable_from, found.stable_to)
    predicted = ""
    if found.predicted is not None:
        predicted = f"{format_figure(found.predicted)} ({found.predicted_by})"
    return model, right, stable, found.below, found.above, predicted


def _span(low: float | None, high: float | None) -> str:
    return "nowhere" if low is None else f"{format_figure(low)} to {format_figure(high)}"


def draw_maps(runs: Sequence[ExtremeRun]) -> Figure:
    """Draw a map of each varied quantity, with a row per model and a column per value.

    Cells show the errors of velocity and pressure [%], and the cause of errors or instability.
    """
    maps: dict[str, list[list[ExtremeRun]]] = {}
    for series in _series(runs):
        maps.setdefault(series[0].varied, []).append(series)
    sizes = [len(models) for models in maps.values()]
    with styled():
        figure = new_figure(WIDTH, sum(ABOUT + HEIGHT * size for size in sizes))
        grid = figure.subplots(len(maps), squeeze=False, height_ratios=sizes)
        for axes, (name, models) in zip(grid.ravel(), maps.items(), strict=True):
            _draw_map(axes, name, models)
    return figure


def _draw_map(axes: Axes, name: str, models: Sequence[Sequence[ExtremeRun]]) -> None:
    from matplotlib.patches import Rectangle

    values = sorted({run.value for series in models for run in series})
    for y, series in enumerate(models):
        for run in series:
            x = values.index(run.value)
            cell = Rectangle((x - 0.5, y - 0.5), 1, 1, edgecolor="white")
            cell.set_facecolor(COLOURS[run.state])
            axes.add_patch(cell)
            words = " / ".join(format_figure(error, 2) for error in run.errors or ())
            if run.state != "right":
                cause = (run.mechanism or run.state).replace("extrapolated", "extr.")
                words = f"{words}\n{cause}".strip()
            axes.text(x, y, words, ha="center", va="center", fontsize=LETTERS)
    axes.set(xlim=(-0.5, len(values) - 0.5), ylim=(len(models) - 0.5, -0.5))
    axes.set_title(f"{name}{OVER.get(name, '')}")
    axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
    axes.set_yticks(range(len(models)), [series[0].model for series in models])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0.0, top=True, labeltop=True, bottom=False, labelbottom=False)
