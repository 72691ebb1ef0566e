"""The page of one experiment of the paper: its figures by number, and its claims beside the runs.

What the paper claims is in `paper_claims/<scene>.yaml`: where, what, its figure in words, and how
to `find` ours in the comparison of a case.
"""

from __future__ import annotations

import csv
import io
import platform
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.figures import FOLDER
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.console import Reporter
from sphrom.machine import physical_ram
from sphrom.metrics.histories import compression_factors
from sphrom.metrics.series import dominant_frequency
from sphrom.models.stored_run import StoredRun
from sphrom.plots.tables import MISSING, format_figure, read_json
from sphrom.report.page import Html, element, picture, render, table
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.whole_files import write_whole

Array = NDArray[np.float64]

NO_FULL_RUN = "the full run is unstable"
CLAIMS = Path(__file__).parent / "paper_claims"
RANGES = ("field", "line")
HEADINGS = (
    "figure or section",
    "what",
    "the paper",
    "as printed",
    "corrected",
    "corrected, fast model",
    "corrected, best possible",
)
CAPTION = (
    "Errors are Eq. 4.1 on the line [%], peak / mean over time: first over the range of the field, "
    "then over the range of the line. The best possible error is that of the full run projected "
    "onto the modes. APG has the paper's memory length on particles and an automatic one in "
    "fast models. Frequencies and phases are those of v at a place in the shear layer; a phase is "
    "the lead over the full run in periods, least to largest. Shares as printed are of stacked "
    "density and velocities; corrected shares are of the acoustic product, which leaves out the "
    "mean density. The compression is N_d / M, with five values for each particle. Words instead "
    "of numbers describe the figures of the documentation. A dash stands where nothing can be "
    "compared or nothing was measured. The rows of full runs are additions: the paper does not "
    "give their errors."
)
COSTS = "model|modes|its step [s]|full run's step [s]|model [s]|full run [s]|speed-up|its range"
COST_COLUMNS = ["reduced_step", "full_step", "reduced_seconds", "full_seconds", "speed_up"]
COST_COLUMNS += ["least_speed_up", "greatest_speed_up"]
COST_CAPTION = (
    "Processor time of the time steps of one run of the corrected case, on one thread: the full "
    "run at its largest stable step, each model at its own. All runs are timed in turns, a stretch "
    "of steps each, and the least time counts. The speed-up is the ratio of the least times; its "
    "range is that of single turns."
)


class Result:
    """What one case found, for claims to be looked up in."""

    def __init__(self, run: Any, stack: ExitStack) -> None:
        context = StageContext(run.case, run.out, False, None, Reporter(quiet=True))
        self.case, self.out, self.reading = run.case, run.out, run.reading
        self.workspace = Workspace(context)
        self.comparison = stack.enter_context(StoredComparison.of(self.workspace))
        self.tables = read_json(run.out / "compare.json", "sphrom compare CASE", {})

    def rows(self, table: str, **wanted: object) -> list[Mapping[str, Any]]:
        """Return the rows of a table that have these values."""
        found = self.tables.get(table, [])
        return [r for r in found if all(r[name] == value for name, value in wanted.items())]

    def has(self, run: str) -> bool:
        """Whether the case has a model of this name."""
        return any(model.name == run for model in self.case.rom)


def write(folder: Path, scene: str, runs: Sequence[Any], command: str) -> Path:
    """Write the page and its table into a folder, and return the page's path.

    Raises ArtifactError when a comparison is missing, damaged or of another case.
    """
    with ExitStack() as stack:
        stable = [run for run in runs if not run.failure_file.is_file()]
        results = {run.reading: Result(run, stack) for run in stable}
        unstable = {run.reading for run in runs if run.failure_file.is_file()}
        rows = [_row(claim, results, unstable) for claim in claims(scene)]
    left_out = {"as printed"} - {run.reading for run in runs}
    columns = [k for k, name in enumerate(HEADINGS) if name not in left_out]
    headings, rows = [HEADINGS[k] for k in columns], [[row[k] for k in columns] for row in rows]
    write_csv(folder / "claims.csv", [headings, *rows])
    costs = cost_rows(results["corrected"].tables) if "corrected" in results else []
    write_csv(folder / "costs.csv", [COSTS.split("|"), *costs])
    sections = [
        ("Claims", [table(CAPTION, headings, rows)]),
        ("Costs", [table(COST_CAPTION, COSTS.split("|"), costs)] if costs else []),
        ("Figures", list(_figures(results))),
        ("How it was made", [*_failures(runs), *_origin(results, command)]),
    ]
    title = f"{scene}: the paper, and here"
    lead = lead_of({run.reading: size_of(run.case) for run in runs})
    footer = f"Written {datetime.now(UTC).isoformat(timespec='seconds')} by: {command}"
    page = folder / "index.html"
    write_whole(page, render(title, lead, sections, footer).encode())
    return page


def size_of(case: Case) -> str:
    """Return how many particles a case has, and how far apart."""
    spacing = format_figure(1e3 * case.plan.particle_spacing)
    return f"{case.plan.n_particles:,} particles {spacing} mm apart"


def lead_of(sizes: Mapping[str, str]) -> str:
    """Return the first sentences of a page, from the sizes of its cases by reading."""
    return (
        "The figures and claims of Rodriguez et al. on this flow, each beside our result: "
        f"{' and '.join(f'{reading} on {size}' for reading, size in sizes.items())}. Fast models "
        "are those of the corrected case."
    )


def claims(scene: str) -> list[dict[str, Any]]:
    """Return what the paper claims of a scene."""
    path = CLAIMS / f"{scene.replace('-', '_')}.yaml"
    return list(yaml.safe_load(path.read_text(encoding="utf-8")))


def _row(
    claim: Mapping[str, Any], results: Mapping[str, Result], unstable: Container[str]
) -> list[str]:
    """Return the cells of one claim; a reading that wasn't asked for has none."""
    find = FINDERS[claim["find"]]
    corrected = results.get("corrected")
    run, fast = claim.get("run"), claim.get("fast")

    def found(reading: str, name: str | None) -> str:
        result = results.get(reading)
        if result is None:
            return NO_FULL_RUN if reading in unstable else MISSING
        if run is not None and (name is None or not result.has(name)):
            return MISSING
        return find(result, claim, name)

    ours = found("corrected", run)
    quick = MISSING if run is None else found("corrected", fast)
    told = [str(claim[key]) for key in ("where", "what", "paper")]
    return [
        *told,
        found("as printed", run),
        ours,
        quick,
        _nearest(corrected, claim),
    ]


def _points(claim: Mapping[str, Any]) -> list[ParameterPoint]:
    return [ParameterPoint(float(value)) for value in claim["reynolds"]]


def _share(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """Eq. 4.3 at a number of modes, with two digits of what it leaves out."""
    wanted = {"space": claim["space"], "basis": claim["basis"], "n_modes": claim["modes"]}
    rows = result.rows("singular_values", **wanted)
    if not rows:
        return MISSING
    share = rows[0]["share"]
    digits = max(1, 1 - int(np.floor(np.log10(max(100.0 - share, 1e-9)))))
    return f"{share:.{digits}f} %"


def _compression(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """N_d / M, the fluid's particles alone or with the ghosts."""
    (model,) = (m for m in result.case.rom if m.name == run)
    plan = result.case.plan
    number = plan.n_particles + (plan.n_ghosts if claim.get("ghosts") else 0)
    return f"{compression_factors(number, model.size)[0]:,.0f}"


def _error(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """Eq. 4.1 on the line: the largest peak and the mean over all values, by both ranges."""
    assert run is not None
    points, unstable = _points(claim), []
    for point in points:
        series = result.comparison.errors(run, point)
        if series is None or series.status != "complete":
            time, _ = result.comparison.discrepancy(run, point, claim["quantity"], "field")
            begins = result.case.compare.from_time or 0.0
            end = f"after {time[-1]:.3g} s" if len(time) else f"before {begins:g} s"
            unstable.append(f"unstable {end}")
    after = [", ".join(dict.fromkeys(unstable))] if unstable else []
    return "; ".join([*after, *_peaks(result, claim, [run] * len(points))]) or MISSING


def _nearest(result: Result | None, claim: Mapping[str, Any]) -> str:
    """Return what `_error` has for the nearest states in the bases that a run uses."""
    if result is None or claim["find"] != "error":
        return MISSING
    # A fast model has the basis and the size of the one on particles.
    model = next((m for m in result.case.rom if m.name in (claim["run"], claim.get("fast"))), None)
    if model is None:
        return MISSING
    bases = [result.case.plan.basis_for(model, point) for point in _points(claim)]
    names = [f"best possible, {basis} M={model.size}" for basis in bases]
    return "; ".join(_peaks(result, claim, names)) or MISSING


def _peaks(result: Result, claim: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Return the peak and the mean of Eq. 4.1, by both ranges, of what is named at each value."""
    told = []
    for over in RANGES:
        histories = []
        for name, point in zip(names, _points(claim), strict=True):
            time, error = result.comparison.discrepancy(name, point, claim["quantity"], over)
            chosen = (time <= claim.get("until", np.inf)) & (time >= claim.get("after", -np.inf))
            if chosen.any():
                histories.append(error[chosen])
        if histories:
            peak, mean = max(h.max() for h in histories), np.mean([h.mean() for h in histories])
            told.append(f"{_plain(peak)} / {_plain(mean)}")
    return told


def _plain(value: float) -> str:
    return format_figure(float(value), 2)


def _frequency(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The frequency of a run beside that of the full one."""
    signals = _signals(result, claim, run)
    if signals is None:
        return MISSING
    (time, full), (reduced_time, reduced) = signals
    try:
        expected = dominant_frequency(time, full)
        found = dominant_frequency(reduced_time, reduced)
    except ValueError as error:
        return str(error)
    off = 100.0 * (found / expected - 1.0)
    return f"{found:.3f} Hz, {off:+z.3f} % from {expected:.3f} Hz"


def phase_lead(time: Array, signal: Array, reference: Array, frequency: float) -> Array:
    """Return by how many periods a signal is ahead of a reference, at windows of one period.

    Both are (n_samples,) and oscillate at a frequency [Hz]; a sine is fitted to each in the window
    that begins at each sample and has all of its samples. Leads are (n_windows,), continuous over
    time, and the first is between -0.5 and 0.5.

    Raises ValueError for a record shorter than a period.
    """
    interval = float(np.diff(time).mean())
    n_window = round(1.0 / (frequency * interval))
    if not 8 <= n_window <= len(time):
        raise ValueError("a phase needs a period or more, of 8 samples or more")
    angle = 2.0 * np.pi * frequency * (time - time[0])
    phases = [_phases(values, angle, n_window) for values in (signal, reference)]
    lead = np.unwrap(phases[0] - phases[1]) / (2.0 * np.pi)
    return np.asarray(lead - np.round(lead[0]))


def _phases(values: Array, angle: Array, n_window: int) -> Array:
    """Return the phases of sines that are fitted to the windows of a record, ahead positive."""
    phases = []
    for first in range(len(values) - n_window + 1):
        window = slice(first, first + n_window)
        waves = np.stack((np.cos(angle[window]), np.sin(angle[window]), np.ones(n_window)), axis=1)
        cosine, sine, _ = np.linalg.lstsq(waves, values[window], rcond=None)[0]
        phases.append(np.arctan2(-sine, cosine))
    return np.array(phases)


def _phase(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """By how many periods a run is ahead, least and largest."""
    signals = _signals(result, claim, run)
    if signals is None:
        return MISSING
    (time, full), (_, reduced) = signals
    try:
        lead = phase_lead(time[: len(reduced)], reduced, full[: len(reduced)],
                          dominant_frequency(time, full))  # fmt: skip
    except ValueError as error:
        return str(error)
    return f"{lead.min():+z.4f} to {lead.max():+z.4f}"


def _signals(result: Result, claim: Mapping[str, Any], run: str | None) -> Any:
    """Return time and v at the station of the full run, then of a reduced one; None without."""
    (point,) = _points(claim)
    found = [result.comparison.samples(name, point, "stations")[1] for name in (None, run)]
    if not all(len(each.time) for each in found):
        return None
    return [(each.time, each.velocity[:, 0, 1]) for each in found]


def _reference(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The full run's largest distance from an independent solution along a profile.

    Velocities are over U, pressures over rho U^2.
    """
    (point,) = _points(claim)
    wanted = {"parameters": point.label, "profile": claim["profile"], "state": claim["state"]}
    rows = result.rows("reference", **wanted, reference_time=claim.get("time"))
    return MISSING if not rows else f"{rows[0]['largest_error']:.4f}"


def _exact(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The full run's relative L2 error over the field against the exact solution, at its worst."""
    (point,) = _points(claim)
    rows = result.rows("errors", compared="full", against="exact", parameters=point.label)
    column = f"{claim['quantity']}_field_relative_l2_peak"
    return f"{_plain(rows[0][column])} %" if rows else MISSING


def _amplitude(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The range of a quantity on the line at a time, over that of the full run, value by value."""
    told = []
    for point in _points(claim):
        pair = _profiles(result, claim, point, run)
        told += [f"{np.ptp(pair[1]) / np.ptp(pair[0]):.3f}" if pair else "unstable before"]
    return ", ".join(told)


def _trough(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """Where the speed is least on a part of the line, and by how much that is off the full run."""
    told = []
    for point in _points(claim):
        y = result.comparison.samples(None, point)[0][:, 1]
        low, high = claim["between"]
        chosen = (y >= low) & (y <= high)
        pair = _profiles(result, claim, point, run)
        if pair is None:
            told.append("unstable before")
            continue
        full, found = (_lowest(y[chosen], values[chosen]) for values in pair)
        told.append(f"{found:.4f} m, {found - full:+.4f}")
    return "; ".join(told)


def _lowest(x: Array, values: Array) -> float:
    """Return where a parabola through the least value and its neighbours is least."""
    k = min(max(int(np.argmin(values)), 1), len(x) - 2)
    curvature, slope, _ = np.polyfit(x[k - 1 : k + 2] - x[k], values[k - 1 : k + 2], 2)
    return float(x[k] - 0.5 * slope / curvature)


def _profiles(
    result: Result, claim: Mapping[str, Any], point: ParameterPoint, run: str | None
) -> tuple[Array, Array] | None:
    """Return a quantity on the line of the full run and of a reduced one, at a claim's time."""
    full, reduced = (result.comparison.samples(name, point)[1] for name in (None, run))
    index = int(np.argmin(np.abs(full.time - claim["time"])))
    if index >= len(reduced.time):
        return None
    quantity = claim["quantity"]
    return getattr(full, quantity)[index], getattr(reduced, quantity)[index]


def _roughness(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """Second differences on a part of the line, root mean square over that of the full run's."""
    (point,) = _points(claim)
    pair = _profiles(result, claim, point, run)
    if pair is None:
        return "unstable before"
    y = result.comparison.samples(None, point)[0][:, 1]
    low, high = claim["between"]
    full, found = (np.diff(p[(y >= low) & (y <= high)], 2) for p in pair)
    return f"{np.linalg.norm(found) / np.linalg.norm(full):.3f}"


def _reynolds(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The Reynolds number of the full run's largest speed, the mean over time."""
    (point,) = _points(claim)
    rows = result.rows("flow", run="full", parameters=point.label)
    viscosity = result.case.plan.kinematic_viscosity(point)
    return f"{rows[0]['largest_speed'] * claim['length'] / viscosity:,.0f}" if rows else MISSING


def _density(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The largest deviation of the full run's density from the reference density."""
    (point,) = _points(claim)
    if not result.workspace.full_run(point).path.is_file():
        return MISSING
    with StoredRun.opened(result.workspace, point, None) as full:
        largest = max(float(np.abs(full.state(k)[0]).max()) for k in range(len(full.time)))
    return f"{_plain(100.0 * largest / result.case.fluid.reference_density)} %"


def _seen(result: Result, claim: Mapping[str, Any], run: str | None) -> str:
    """The words that a claim has for what the pictures of a case show."""
    return str(claim.get("seen", {}).get(result.reading, MISSING))


FINDERS: Mapping[str, Callable[[Result, Mapping[str, Any], str | None], str]] = {
    "share": _share,
    "compression": _compression,
    "error": _error,
    "frequency": _frequency,
    "phase": _phase,
    "reference": _reference,
    "exact": _exact,
    "amplitude": _amplitude,
    "trough": _trough,
    "roughness": _roughness,
    "reynolds": _reynolds,
    "density": _density,
    "seen": _seen,
}


def cost_rows(tables: Mapping[str, Any]) -> list[list[str]]:
    """Return the costs of a comparison's models as cells, the means over their parameters."""
    models: dict[str, list[Mapping[str, Any]]] = {}
    for row in tables.get("timings", []):
        models.setdefault(row["model"], []).append(row)
    rows = []
    for name, own in models.items():
        means = [format_figure(float(np.mean([row[c] for row in own]))) for c in COST_COLUMNS]
        rows.append([name, f"{own[0]['n_modes']}", *means[:-2], " to ".join(means[-2:])])
    return rows


def write_csv(path: Path, rows: Sequence[Sequence[str]]) -> None:
    """Write a table, its headings first."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_whole(path, text.getvalue().encode())


def _failures(runs: Sequence[Any]) -> Iterator[Html]:
    """Yield why a case has nothing to compare."""
    for run in runs:
        if run.failure_file.is_file():
            told = run.failure_file.read_text(encoding="utf-8")
            yield element("p", f"{run.reading.capitalize()}, the full model is unstable: {told}")


def _figures(results: Mapping[str, Result]) -> Iterator[Html]:
    """Yield each figure by its name, from both cases."""
    figures = {f.name: f for result in results.values() for f in result.case.compare.figures}
    for figure in figures.values():
        yield element("h3", numbered(figure.name))
        for reading, result in results.items():
            path = result.out / FOLDER / f"{figure.name}.png"
            if path.is_file():
                yield picture(path.read_bytes(), f"{reading.capitalize()}. {figure.caption}")


def numbered(name: str) -> str:
    """Return the heading of a figure called `figure-04`."""
    return f"Figure {int(name.removeprefix('figure-'))}"


def _origin(results: Mapping[str, Result], command: str) -> Iterator[Html]:
    """Yield the command, the machine, and what every stage took."""
    yield element("p", f"Command: {command}")
    yield element("p", f"Machine: {machine()}")
    rows = []
    for reading, result in results.items():
        seconds = stage_seconds(result.tables)
        rows += [[reading, stage, format_figure(total)] for stage, total in seconds.items()]
        about = result.tables["about"]
        threads = counted(about["threads"], "thread")
        origin = f"{about['software']}, compared {about['date']}, {threads}."
        hours = hours_of_steps(result.case, result.tables)
        yield element("p", f"{reading.capitalize()}: {origin} {hours}")
    if rows:
        yield table("Wall-clock of the stages.", ("case", "stage", "seconds"), rows)


def machine() -> str:
    """Return what this machine is, in words."""
    processor = platform.processor() or platform.machine()
    return f"{processor}, {physical_ram() / 2**30:.0f} GiB, {platform.system()}"


def stage_seconds(tables: Mapping[str, Any]) -> dict[str, float]:
    """Return what the stages of a comparison took in all [s]."""
    seconds: dict[str, float] = {}
    for row in tables.get("stages", []):
        seconds[row["stage"]] = seconds.get(row["stage"], 0.0) + row["seconds"]
    return seconds


def hours_of_steps(case: Case, tables: Mapping[str, Any]) -> str:
    """Return what the time steps of a case took in all, undisturbed, as a sentence.

    Full runs that no model is compared with are taken to cost what the others do.
    """
    timings = [row for row in tables.get("timings", []) if row["full_seconds"] is not None]
    if not timings:
        return ""
    plan, names = case.plan.steps, {model.name for model in case.rom if not model.from_operators}
    full = {row["parameters"]: row["full_seconds"] for row in timings}
    # Full runs are timed at their largest stable step; these took the case's own.
    longer = timings[0]["full_step"] / plan.time_step
    steps = longer * (plan.n_steps + plan.n_spin_up_steps) / plan.n_steps
    hours = float(np.mean(list(full.values()))) * steps * len(case.plan.points) / 3600.0
    told = f"{counted(len(case.plan.points), 'full run')} {format_figure(hours)}"
    reduced = [row["reduced_seconds"] for row in timings if row["model"] in names]
    if reduced:
        count = counted(len(reduced), "reduced run")
        told += f", {count} on particles {format_figure(sum(reduced) / 3600.0)}"
    return f"Hours of time steps alone, each counted at the shortest measured time: {told}."


def counted(number: int, what: str) -> str:
    """Return a number with the noun that it counts."""
    return f"{number} {what}{'s' if number > 1 else ''}"
