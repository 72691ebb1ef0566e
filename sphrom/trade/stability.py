"""What the runs at the extremes say: which are right, what sets the limits, tables and pictures.

A run is right where its errors are at most twice those of the default: the case's own model at its
first test value, or at a trained one. Of a full run the default is the change that half the
resolution makes there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sphrom.arrays import Array
from sphrom.online.fast_model import FastRun
from sphrom.online.stable_ranges import FILE, MEMORY, MOST_ERROR, STEP, TIME, UNITS, StableRange
from sphrom.plots.canvas import new_figure, save, styled
from sphrom.plots.tables import format_figure, write_csv, write_json
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA
from sphrom.reduction.reduced_rates import stability_limits
from sphrom.reduction.reference_model import Integrator, ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.setup.assembly import MOST_GROWTH
from sphrom.store.workspace import Workspace
from sphrom.text import counted
from sphrom.trade.candidates import FOLDER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ONE_RUN, RESOLUTION = "reynolds, one training run", "resolution"
COARSE = ("Mach number", "h/dx")
"""What is varied in full models of half the resolution."""
HALF = "half as fine"
PERCENT = {"unit": "%"}
Errors = tuple[float, float]
"""Of velocity and pressure [%]."""
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
"""Errors above that are no result [%]."""
WIDTH, HEIGHT, ABOUT, LETTERS = 8.5, 0.27, 0.55, 5.5
"""Of maps, of a model in them, of title and labels [inch], and of letters in cells."""
SOUND = 0.1
"""Share of the pressure in the energy of an eigenvector, above which it is sound."""
PER_DECADE, DECADES = 20, 3
"""Memory lengths that are tried for a growing eigenvector."""
FINE_BELOW = (STEP, MEMORY, TIME)
"""What may be less than the least that is tried."""


@dataclass(kw_only=True)
class ExtremeRun:
    """One run at the extremes."""

    varied: str
    value: float
    """Of the varied quantity: steps and memories over the automatic, times over the trained."""
    parameters: str
    kind: Kind
    projection: str = ""
    n_modes: int | None = None
    steps: str = ""
    """`exponential` or `runge-kutta`, of a fast model; of a full one how it differs, if it does."""
    time_step: float | None = field(default=None, metadata={"unit": "s"})
    memory_length: float | None = field(default=None, metadata={"unit": "s"})
    end_time: float | None = field(default=None, metadata={"unit": "s"})
    state: State = ""
    mechanism: str = ""
    """What makes it wrong, unstable, or would first."""
    predicted: float | None = None
    """The greatest stable value, by formula or eigenvalue."""
    velocity_error: float | None = field(default=None, metadata=PERCENT)
    pressure_error: float | None = field(default=None, metadata=PERCENT)
    velocity_best: float | None = field(default=None, metadata=PERCENT)
    """Of the nearest state in the basis."""
    pressure_best: float | None = field(default=None, metadata=PERCENT)
    velocity_estimate: float | None = field(default=None, metadata=PERCENT)
    pressure_estimate: float | None = field(default=None, metadata=PERCENT)
    diverged_at: float | None = field(default=None, metadata={"unit": "s"})
    reason: str = ""
    """Why it was unstable or refused."""
    extrapolated: bool = False
    """Whether it is outside of the trained values or times."""
    told: str = ""
    """What the run itself says against its result."""

    @property
    def model(self) -> str:
        """The model in words."""
        if self.kind == "full":
            return f"full{self.steps}"
        name = "APG" if self.projection == "apg" else "Galerkin"
        on = ", on particles" if self.kind == "particles" else ""
        scheme = ", Runge-Kutta" if self.steps == RUNGE_KUTTA else ""
        return f"{name}, M = {self.n_modes}{on}{scheme}"

    @property
    def errors(self) -> Errors | None:
        """Errors of velocity and pressure [%]."""
        return _both(self.velocity_error, self.pressure_error)

    @property
    def natural(self) -> float:
        """The value in seconds where it is a ratio of those."""
        found = {STEP: self.time_step, MEMORY: self.memory_length, TIME: self.end_time}
        return found.get(self.varied) or self.value


def _both(velocity: float | None, pressure: float | None) -> Errors | None:
    return None if velocity is None or pressure is None else (velocity, pressure)


# Causes


def limiting_step(reduced: ReferenceModel) -> tuple[str, float]:
    """Return what limits Runge-Kutta steps of a model, and the largest stable one [s].

    An eigenvector of the Jacobian around the start or a training state does: sound where pressure
    has a good part of its energy, else viscosity where it decays faster than it turns, else
    convection.
    """
    values, vectors = np.linalg.eig(
        reduced.polynomial.jacobians(_around_which(reduced), reduced.strongest)
    )
    limits = stability_limits(values.ravel().astype(np.complex128))
    worst = int(limits.argmin())
    vector = vectors.transpose(0, 2, 1).reshape(limits.size, -1)[worst]
    return kind_of(reduced.basis, values.ravel()[worst], vector), float(limits[worst])


def _around_which(reduced: ReferenceModel) -> Array:
    """Return the states that have to be stable (n_states, n_modes)."""
    start = reduced.start[None]
    return start if reduced.states is None else np.vstack((start, reduced.states))


def kind_of(basis: TrialBasis, value: complex, vector: Array) -> str:
    """Return what an eigenvalue [1/s] and its eigenvector (n_modes,) of a Jacobian are."""
    modes = basis.density_modes[: len(vector)]  # the leading ones of a model that integrates them
    pressure = (modes * basis.weights) @ modes.T
    if (vector.conj() @ pressure @ vector).real > SOUND * np.linalg.norm(vector) ** 2:
        return "sound"
    return "viscosity" if abs(value.real) > abs(value.imag) else "convection"


def growth(reduced: ReferenceModel, states: Array) -> tuple[float, str]:
    """Return the fastest growth [1/s] around states (n_states, n_modes), and a name for it.

    In the last half of the modes it is that of their noise; in the first half, of what the modes
    that are left out would have taken from them.
    """
    values, vectors = np.linalg.eig(reduced.polynomial.jacobians(states, reduced.strongest))
    worst = int(values.real.argmax())
    vector = np.abs(vectors.transpose(0, 2, 1).reshape(values.size, -1)[worst]) ** 2
    last = float(vector[len(vector) // 2 :].sum() / vector.sum())
    return float(values.real.ravel()[worst]), "noise modes" if last > 0.5 else "aliasing"


def longest_memory(near: ReferenceModel, far: ReferenceModel) -> float | None:
    """Return the longest memory, over that of `near`, at which nothing grows around its states.

    The closure's part of a Jacobian is proportional to it; `far` has twice the memory. None where
    it is longer than is tried.
    """
    states = _around_which(near)
    bare, longer = (m.polynomial.jacobians(states, m.strongest) for m in (near, far))
    # Where the flow itself has a growing perturbation, faster than that.
    without = max(0.0, float(np.linalg.eigvals(2.0 * bare - longer).real.max()))
    for power in range(-DECADES * PER_DECADE, DECADES * PER_DECADE + 1):
        factor = 10.0 ** (power / PER_DECADE)
        jacobians = bare + (factor - 1.0) * (longer - bare)
        fastest = float(np.linalg.eigvals(jacobians).real.max()) - without
        if fastest * near.output_times.duration > math.log(MOST_GROWTH):
            return factor
    return None


def cause_of_divergence(run: FastRun, integrator: Integrator) -> str:
    """Return what makes a run diverge, from its steps and eigenvalues where it went."""
    reduced = run.reduced
    if integrator.steps.system.integrator == RUNGE_KUTTA:
        name, limit = limiting_step(reduced)
        if run.time_step > limit:
            return name
    if reduced.memory_length is not None:
        return "closure"
    fastest, where = growth(reduced, _around_which(reduced))
    if fastest * reduced.output_times.duration > math.log(MOST_GROWTH):
        return where
    if run.outside:
        return "extrapolated rates"
    return growth(reduced, run.done.coordinates[-1:])[1]


# States and ranges


def judge(runs: Sequence[ExtremeRun], default: tuple[str, int], own: Mapping[str, float]) -> None:
    """Say of runs which state they have, and what makes them wrong.

    Parameters
    ----------
    default : the projection and the size of the model that others are judged by.
    own : the case's own values of the varied quantities.
    """
    by_default = {
        (run.varied, run.kind, run.projection, run.n_modes): run
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
            # Half as fine: by the same model, there.
            of_map = (r for r in runs if r.varied == run.varied and r.errors)
            same = [r for r in of_map if (r.kind, r.projection, r.n_modes) == ("fast", *default)]
            nearest = min(same, key=lambda r: abs(r.value - own[r.varied]), default=standard)
            allowed = nearest.errors
        run.state = run.state or _state(run, allowed)
        if run.state == "stable":
            key = run.varied, run.kind, run.projection, run.n_modes
            is_right = key in by_default and _within(by_default[key].errors, allowed)
            run.mechanism = _cause(run, allowed, is_right)


def _default_of(runs: Sequence[ExtremeRun], default: tuple[str, int]) -> ExtremeRun:
    found = (r for r in runs if (r.varied, r.value, r.steps) == (STEP, 1.0, EXPONENTIAL))
    return next(r for r in found if (r.projection, r.n_modes) == default)


def _within(errors: Errors | None, allowed: Errors | None) -> bool:
    if errors is None or allowed is None:
        return False
    return all(a <= MOST_ERROR * b for a, b in zip(errors, allowed, strict=True))


def _state(run: ExtremeRun, allowed: Errors | None) -> State:
    same = run.kind == "full" and run.velocity_error == 0.0
    return "right" if same or _within(run.errors, allowed) else "stable"


def _cause(run: ExtremeRun, allowed: Errors | None, right_by_default: bool) -> str:
    """Return what makes a stable run wrong; empty where nothing tells."""
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
        # Sound is a part of pressure alone, but for a little.
        carried = run.steps == EXPONENTIAL or run.errors[0] > MOST_ERROR * allowed[0]
        return "convection" if carried else "sound"
    if right_by_default and run.varied == MEMORY:
        return "closure"
    return f"{before}rates"


def ranges_in(
    runs: Sequence[ExtremeRun], default: tuple[str, int], own: Mapping[str, float]
) -> Iterator[StableRange]:
    """Yield where each model is stable and right; `own` are the case's own values by quantity."""
    own_run = _default_of(runs, default)
    for series in _series(runs):
        first, values = series[0], [run.natural for run in series]
        at = own.get(first.varied, 1.0)
        k = min(range(len(series)), key=lambda i: abs(series[i].value - at))
        stable = _around(k, [run.state in ("right", "stable") for run in series])
        right = _around(k, [run.state == "right" for run in series])
        low, high = right or stable or (k, k)
        lower = [0.0 if first.varied in FINE_BELOW else values[0], *values[1:]]
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
            least=lower[0],
            greatest=values[-1],
            below=series[low - 1].mechanism if low > 0 else "",
            above=series[high + 1].mechanism if high + 1 < len(series) else "",
            predicted=predicted,
            predicted_by=by,
        )


def _series(runs: Sequence[ExtremeRun]) -> list[list[ExtremeRun]]:
    """Return the runs of each model in which one quantity is varied, by its value."""
    found: dict[tuple[str, str], list[ExtremeRun]] = {}
    for run in runs:
        found.setdefault((run.varied, run.model), []).append(run)
    return [sorted(series, key=lambda run: run.value) for series in found.values()]


def _around(k: int, good: Sequence[bool]) -> tuple[int, int] | None:
    """Return the ends of the good ones around a place; None where it isn't good itself."""
    if not good[k]:
        return None
    low = high = k
    while low > 0 and good[low - 1]:
        low -= 1
    while high + 1 < len(good) and good[high + 1]:
        high += 1
    return low, high


def _predicted(series: Sequence[ExtremeRun], own: ExtremeRun) -> tuple[float | None, str]:
    """Return the greatest value that should be stable or right, and what says so."""
    first = series[0]
    if first.predicted is not None:
        way = "formula" if first.kind == "full" else "eigenvalue"
        return first.predicted * first.natural / first.value, way
    estimates = (_both(run.velocity_estimate, run.pressure_estimate) for run in series)
    good = [_within(each, own.errors) for each in estimates]
    last = _around(0, good)
    return (None, "") if last is None else (series[last[1]].natural, "estimate")


# Tables and pictures


def publish(
    workspace: Workspace,
    runs: Sequence[ExtremeRun],
    default: tuple[str, int],
    own: Mapping[str, float],
    notes: Sequence[str],
) -> None:
    """Judge the runs, write their tables and maps, and show where models are stable and right."""
    judge(runs, default, own)
    ranges, report = list(ranges_in(runs, default, own)), workspace.context.report
    write_csv(workspace.folder(FOLDER) / "extremes.csv", runs)
    about = {"basis": workspace.basis().inputs_digest}
    tables: dict[str, Sequence[Any]] = {"extremes": runs, "ranges": ranges}
    write_json(workspace.out / FILE, tables, workspace.case.name, workspace.threads, **about)
    save(draw_maps(runs), workspace.folder(FOLDER) / "extremes.png")
    rows: dict[str, list[tuple[str, ...]]] = {}
    for each, series in zip(ranges, _series(runs), strict=True):
        rows.setdefault(each.varied, []).append(_cells(each, series[0]))
    for varied, cells in rows.items():
        report.table(f"{varied}{UNITS.get(varied, '')}", HEADINGS, cells)
    if (own_run := _default_of(runs, default)).errors is not None:
        velocity, pressure = (MOST_ERROR * error for error in own_run.errors)
        report.info(
            f"a model is right with errors up to {format_figure(velocity)} % in velocity and "
            f"{format_figure(pressure)} % in pressure, twice the errors of {own_run.model} at "
            f"{own_run.parameters}"
        )
    for note in (*notes, *dict.fromkeys(r.reason for r in runs if r.state == "refused")):
        report.info(note)
    fast = (run for run in runs if run.kind == "fast" and not run.told)
    silent = sum(max(run.errors or (0.0,)) > ALL_WRONG for run in fast)
    counts = ", ".join(f"{sum(r.state == state for r in runs)} {state}" for state in COLOURS)
    report.result(
        f"{counted(len(runs), 'run')}: {counts}; {silent} off by more than {ALL_WRONG:g} % without "
        "a warning of their own"
    )
    report.result(f"extremes.csv, extremes.json and extremes.png are in {workspace.out / FOLDER}")


def _cells(each: StableRange, run: ExtremeRun) -> tuple[str, ...]:
    right, stable = _span(each.right_from, each.right_to), _span(each.stable_from, each.stable_to)
    predicted = ""
    if each.predicted is not None:
        predicted = f"{format_figure(each.predicted)} ({each.predicted_by})"
    return run.model, right, stable, each.below, each.above, predicted


def _span(low: float | None, high: float | None) -> str:
    return "nowhere" if low is None else f"{format_figure(low)} to {format_figure(high)}"


def draw_maps(runs: Sequence[ExtremeRun]) -> Figure:
    """Draw a map of each varied quantity: a row for each model, a column for each value.

    Cells show the errors of velocity and pressure [%], and what makes a run wrong or unstable.
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
