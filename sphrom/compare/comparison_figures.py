"""The figures that `compare` draws for every case, from stored runs and comparisons.

For each parameter point there are fields, lines, errors, reference profiles and measurements, and
for each basis singular values and modes (`basis_figures.py`). `RunFigures` is also used for the
figures that a case lists.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.comparison import Series
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Row, place_of
from sphrom.case.study_sections import FULL
from sphrom.compare.basis_figures import draw_modes, draw_spectrum, frame_of, model_sizes
from sphrom.compare.comparison_tables import Tables
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.metrics.measures import Samples
from sphrom.metrics.quantities import components, unit_of
from sphrom.models.contract import BEST, Ability, family_of
from sphrom.models.stored_run import StoredRun
from sphrom.plots.arrangement import FLAT
from sphrom.plots.frames import Frame
from sphrom.plots.panels import Curve, Field, Panel, Role, draw_grid, save
from sphrom.scenes.flows import TaylorGreen
from sphrom.setup.assembly import field_measures, without_air
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Drawn = Callable[[], Figure]
    """A function that draws a figure."""

LABELS = {
    "speed": "speed [m/s]",
    "pressure": "pressure [Pa]",
    "pressure less its mean": "pressure less its mean [Pa]",
}
QUANTITIES = ("speed", "pressure")
PLOTS = "plots"
"""Folder of the figures, beside the artifacts."""
LONG, TALL = 0.15, 1.4
"""Height over width of pictures below which each has a row, and above which curves are beside
them."""
NEARLY_AT_REST = 0.5
"""Kinetic energy, relative to its mean over the run, below which pictures show another instant."""
OVER_RUN, AT_INSTANT = "error over r.m.s. of the run [%]", "relative L2 at that instant [%]"
"""The scales of errors over time. Comparisons of earlier versions have only the second."""
ERRORS = (
    {
        "velocity_field_l2_over_rms": f"velocity, field: {OVER_RUN}",
        "velocity_line_l2_over_rms": f"velocity, line: {OVER_RUN}",
        "velocity_line_eq41_by_line_range": "speed, line: mean error over range (Eq. 4.1) [%]",
    },
    {
        "pressure_field_l2_over_rms": f"pressure less its mean, field: {OVER_RUN}",
        "pressure_line_l2_over_rms": f"pressure less its mean, line: {OVER_RUN}",
        "pressure_line_eq41_by_line_range": "pressure, line: mean error over range (Eq. 4.1) [%]",
    },
)
"""The errors to draw, with their labels: a row of velocities and one of pressures."""


def remove_figures(workspace: Workspace, kept: Collection[Path] = ()) -> None:
    """Remove the figures of earlier comparisons of the case, except for some."""
    plan = workspace.case.plan
    for place in (*(point.file_label for point in plan.points), *plan.bases):
        for path in (workspace.out / PLOTS).glob(f"*-{place}.png"):
            if path not in kept:
                path.unlink()


def draw_comparison(workspace: Workspace, tables: Tables, most: int | None = None) -> None:
    """Draw the missing figures of a comparison into the folder `plots`.

    With `most`, at most that many figures are drawn: the most telling ones at one point, preferably
    a predicted one.
    """
    folder = workspace.folder(PLOTS)
    with StoredComparison.of(workspace) as stored:
        figures = {folder / f"{name}.png": draw for name, draw in _figures(stored, tables)}
        remove_figures(workspace, figures.keys())
        chosen = [*figures]
        if most is not None:
            first = _points(workspace.case)[0].file_label
            chosen = [path for path in figures if path.stem.endswith(f"-{first}")][:most]
        with workspace.context.report.details.progress("pictures", len(chosen)) as advance:
            for path in chosen:
                if not path.exists():
                    save(figures[path](), path)
                advance(1)


def _points(case: Case) -> list[ParameterPoint]:
    """Return the points of full runs, predicted ones first."""
    return [*dict.fromkeys((*case.plan.test_points, *case.plan.points))]


def _figures(stored: StoredComparison, tables: Tables) -> Iterator[tuple[str, Drawn]]:
    """Yield the names of all figures, the most informative first, with functions that draw them."""
    workspace = stored.workspace
    case = workspace.case
    for point in _points(case):
        for name, draw in _PointFigures(stored, tables, point).all():
            yield f"{name}-{point.file_label}", draw
    for basis in case.plan.bases if case.rom else ():
        sizes = model_sizes(workspace, basis)
        yield f"singular-values-{basis}", partial(draw_spectrum, workspace, basis, sizes)
        if family_of(case).can(Ability.MODE_FIELDS):
            yield f"modes-{basis}", partial(draw_modes, workspace, basis)


class RunFigures:
    """The figures of runs, from their artifacts and the stored comparison."""

    def __init__(self, stored: StoredComparison) -> None:
        self.stored = stored
        self.workspace = stored.workspace
        self.case = stored.workspace.case

    @cached_property
    def frame(self) -> Frame:
        """The part of the plane that pictures show."""
        return frame_of(self.case)

    def curve(self, run: str, x: Array, y: Array) -> Curve:
        """Return a curve of the full run or of a reduced one."""
        if run == FULL:
            return Curve(run, x, y, "full")
        return Curve(run, x, y, place=place_of(self.case, run))

    def lines(self, rows: Sequence[Row], time: float, quantities: Sequence[str]) -> Figure:
        """Draw profiles on the line at the snapshot nearest to a time [s], with a row per point.

        Full, exact and reduced runs share panels; `quantities` are keys of LABELS. The title of a
        panel names models that became unstable earlier.
        """
        panels = []
        where = np.empty((0, 3))
        for models, points in rows:
            for point in points:
                where, full = self._line(None, point)
                y = where[:, 1]
                index = int(np.argmin(np.abs(full.time - time)))
                time = float(full.time[index])
                lines = {FULL: full}
                for model in filter(None, models):
                    lines[model.name] = self._line(model.name, point)[1]
                row = []
                for quantity in quantities:
                    curves = []
                    title = lettered(quantities, quantity, self.case.plan.title(point))
                    if (flow := self.case.plan.flow(point).exact) is not None:
                        exact = exact_samples(flow, where, full.time[index : index + 1])
                        curves.append(Curve("exact", y, _along(exact, quantity)[0], "exact"))
                    for name, line in lines.items():
                        if index < len(line.time):
                            curves.append(self.curve(name, y, _along(line, quantity)[index]))
                        else:
                            title += f"\nnot shown: {name}, unstable {_ended(line)}"
                    row.append(Panel(title, "y [m]", LABELS[quantity], curves))
                panels.append(row)
        at_z = "".join(f", z = {z:.4g} m" for z in where[0, 2:])
        return draw_grid(panels, title=f"x = {where[0, 0]:.4g} m{at_z}, t = {time:.4g} s")

    def _line(self, run: str | None, point: ParameterPoint) -> tuple[Array, Samples]:
        """Return the points of the line, and a run's samples there with NaN above the surface."""
        position, samples = self.stored.samples(run, point)
        return position, without_air(self.case, samples)


class _PointFigures(RunFigures):
    """The figures of one parameter point, with the prefixes of their file names."""

    def __init__(self, stored: StoredComparison, tables: Tables, point: ParameterPoint) -> None:
        super().__init__(stored)
        self.point = point
        self.title = self.case.plan.title(point)
        self.probes = probes_of(self.case)
        rows = [r for r in tables.errors if (r.parameters, r.against) == (point.label, FULL)]
        status = {row.compared: row.status for row in rows}
        self.complete = [m for m in self.case.rom if status.get(m.name) == "complete"]
        best = [row for row in rows if row.compared.startswith(BEST)]
        self.best = max(best, key=lambda row: row.n_modes or 0).compared if best else ""
        self.compared = [m.name for m in self.case.rom if stored.has_errors(m.name, point)]
        settled = (r for r in tables.reference if r.parameters == point.label and r.settled)
        self.references = list(settled)
        self.time = stored.samples(None, point)[1].time

    @cached_property
    def instant(self) -> int:
        """The snapshot that pictures show."""
        with StoredRun.opened(self.workspace, self.point) as run:
            return pictured_snapshot(run.kinetic_energy)

    @property
    def when(self) -> str:
        """The parameters and the time of pictures."""
        return f"{self.title}, t = {self.time[self.instant]:.3g} s"

    def all(self) -> Iterator[tuple[str, Drawn]]:
        """Yield the prefixes of the figures that there are, with functions that draw them."""
        if self.complete:
            yield "overview", self._overview
        for name, measured in self.case.scene.recorded.items():
            yield f"{measured.folder}-{name}", partial(self._measured, name)
        if self.references:
            yield "profiles", self._profiles
        yield "centrelines", self._centrelines
        if self.compared:
            yield "errors", self._errors
        if self.complete:
            yield "fields", self._fields
        if len(self.probes.stations):
            yield "history", self._history

    @cached_property
    def errors(self) -> dict[str, Series]:
        """The errors of reduced models over time."""
        errors = {name: self.stored.errors(name, self.point) for name in self.compared}
        return {name: series for name, series in errors.items() if series is not None}

    def _runs(self) -> Iterator[StoredRun]:
        """Open the full run, then the complete reduced runs."""
        for model in (None, *self.complete):
            with StoredRun.opened(self.workspace, self.point, model) as run:
                yield run

    @cached_property
    def _pictures(self) -> dict[str, dict[str, Array]]:
        """Pictures of the full run and of reduced runs at one instant, by run and quantity."""
        pictures: dict[str, dict[str, Array]] = {}
        for run in self._runs():
            samples = run.sampled(self.probes.pictured, [self.instant])
            samples = without_air(self.case, samples)
            pictures[run.name] = {
                quantity: self.probes.picture(getattr(samples, quantity)[0])
                for quantity in QUANTITIES
            }
        return pictures

    @property
    def _scales(self) -> dict[str, tuple[float, float]]:
        full = self._pictures[FULL].items()
        return {LABELS[q]: (float(np.nanmin(f)), float(np.nanmax(f))) for q, f in full}

    def _beside(self, model: ReducedModelSection, quantity: str) -> list[Field]:
        pictures = self._pictures
        full = pictures[FULL][quantity]
        return side_by_side(model.name, quantity, full, pictures[model.name][quantity])

    def _fields(self) -> Figure:
        rows = []
        for model in self.complete:
            fields = [self._beside(model, quantity) for quantity in QUANTITIES]
            rows += fields if self.frame.aspect < FLAT else [[*fields[0], *fields[1]]]
        return draw_grid(rows, self.frame, scales=self._scales, title=self.when)

    def _overview(self) -> Figure:
        fastest = next(m for m in self.case.plan.models_by_speed if m in self.complete)
        complete = {m.name: self.errors[m.name] for m in self.complete}
        error, label = next(iter(ERRORS[0].items()))
        errors = self._error_panel(error, label, complete)
        rows = overview_rows(self._beside(fastest, "speed"), errors, self.frame.aspect)
        return draw_grid(rows, self.frame, scales=self._scales, title=self.when)

    def _centrelines(self) -> Figure:
        rows = [(tuple(self.complete), (self.point,))]
        return self.lines(rows, self.time[self.instant], tuple(LABELS))

    def _errors(self) -> Figure:
        """Draw errors over time, beside those of the full run and of the nearest states."""
        limits: dict[Role, tuple[str, Series | None]] = {
            "level": ("full against exact", self.stored.errors(FULL, self.point, "exact")),
            "best": ("best possible (projection)", self.stored.errors(self.best, self.point)),
        }
        rows = [
            [self._error_panel(name, label, self.errors, limits) for name, label in row.items()]
            for row in ERRORS
        ]
        line = f"on the line x = {self.case.plan.probe_line:g} m"
        return draw_grid(rows, title=f"{self.title}, over the field and {line}")

    def _error_panel(
        self,
        error: str,
        label: str,
        models: Mapping[str, Series],
        limits: Mapping[Role, tuple[str, Series | None]] = {},
    ) -> Panel:
        """Return a panel with one error of reduced models over time, and limits by their role.

        The axis is logarithmic because errors of models differ by orders of magnitude.
        """
        known = {role: (name, series) for role, (name, series) in limits.items() if series}
        shown = [*models.values(), *(series for _, series in known.values())]
        if error.endswith("_l2_over_rms") and not all(error in s.over_rms for s in shown):
            error = error.replace("_l2_over_rms", "_relative_l2")
            label = label.replace(OVER_RUN, AT_INSTANT)

        def values(series: Series) -> Array:
            return {**series.relative_l2, **series.over_rms, **series.eq41}[error]

        curves = [
            Curve(name, series.time, values(series), role) for role, (name, series) in known.items()
        ]
        curves += [self.curve(name, series.time, values(series)) for name, series in models.items()]
        return Panel("", "time [s]", label, curves, "logarithmic")

    def _profiles(self) -> Figure:
        """Draw the full run beside all references that it can match, by quantity."""
        panels: dict[tuple[str, str], dict[str, Curve]] = {}
        for row in self.references:
            profile = self.stored.profile(row, self.point)
            state = row.state if row.reference_time is None else f"t = {row.reference_time:.3g} s"
            when = f"t = {row.time:.3g} s"
            if row.n_snapshots > 1:
                when = f"mean over {row.from_time:.3g} s to {row.time:.3g} s"
            quantity, _, axis = row.profile.split()
            labels = f"{axis} / L [–]", f"{quantity} / {'ρ U²' if quantity == 'p' else 'U'} [–]"
            at = profile.coordinate
            full = Curve(f"full, {when}", at, profile.value, "full")
            source = f"{row.source}, {state}"
            reference = Curve(source, at, profile.reference_value, "reference")
            # References at the same time share the curve of the full run.
            panels.setdefault(labels, {}).update({full.label: full, source: reference})
        row_of_panels = [
            Panel("", x_label, y_label, list(curves.values()))
            for (x_label, y_label), curves in panels.items()
        ]
        return draw_grid([row_of_panels], title=self.title)

    def _measured(self, name: str) -> Figure:
        """Draw a measurement over time, or along a line at the end, with a panel per component."""
        title = f"{name}, {self.title}"
        x_label = "time [s]"
        x = self.time
        measure = field_measures(self.case).get(name)
        is_line = measure is not None and not measure.is_integral and len(measure.position) > 1
        if measure is not None and is_line:
            title = f"{title}, t = {x[-1]:.4g} s"
            x_label = "along the line [m]"
            x = np.hypot.reduce(measure.position - measure.position[0], axis=1)
        n_dim = self.case.scene.domain.n_dim
        panels: dict[str, list[Curve]] = {}
        for run in self._runs():
            for quantity, values in run.measured(name).items():
                for component, one in components(quantity, values).items():
                    label = f"{component.replace('_', ' ')} [{unit_of(quantity, n_dim)}]"
                    # Flow rates and probes have a single place.
                    shown = one[-1] if is_line else one.reshape(len(x))
                    panels.setdefault(label, []).append(self.curve(run.name, x, shown))
        row = [Panel("", x_label, label, curves) for label, curves in panels.items()]
        return draw_grid([row], title=title)

    def _history(self) -> Figure:
        x, y = self.probes.stations[0]
        curves = []
        for name in (None, *(model.name for model in self.complete)):
            run = self.stored.samples(name, self.point, "stations")[1]
            if len(run.time):
                curves.append(self.curve(name or FULL, run.time, run.velocity[:, 0, 1]))
        title = f"{self.title}, at x = {x:.4g} m, y = {y:.4g} m"
        return draw_grid([[Panel("", "time [s]", "v [m/s]", curves)]], title=title)


def pictured_snapshot(kinetic_energy: Array) -> int:
    """Return the snapshot that pictures show, from the kinetic energy of the full run over time.

    It is at half time. If fluid is nearly at rest then, such as in a tank that sloshes, it is the
    nearest one with at least the mean kinetic energy.
    """
    middle = len(kinetic_energy) // 2
    mean = kinetic_energy.mean()
    if kinetic_energy[middle] >= NEARLY_AT_REST * mean:
        return middle
    moving = np.flatnonzero(kinetic_energy >= mean)
    return int(moving[np.argmin(np.abs(moving - middle))])


def overview_rows(
    fields: Sequence[Field], errors: Panel, aspect: float
) -> list[list[Field | Panel]]:
    """Return three pictures of a height over width and a panel of curves, arranged in rows."""
    full, reduced, difference = fields
    if aspect > TALL:
        return [[full, reduced, difference, errors]]
    if aspect < LONG:
        return [[full], [reduced], [difference], [errors]]
    if aspect < FLAT:
        return [[full, reduced], [difference, errors]]
    return [[full, reduced, difference], [errors]]


def side_by_side(name: str, quantity: str, full: Array, reduced: Array) -> list[Field]:
    """Return pictures of a quantity in the full run, in a reduced run, and of the difference."""
    label = LABELS[quantity]
    unit = label.partition("[")[2]
    return [
        Field(f"{quantity}, full", label, full),
        Field(f"{quantity}, {name}", label, reduced),
        Field(f"{name} - full", f"difference [{unit}", reduced - full, difference=True),
    ]


def lettered(quantities: Sequence[str], quantity: str, title: str) -> str:
    """Return the title of a panel, with a letter for its quantity if there are several."""
    letter = ascii_lowercase[quantities.index(quantity)]
    return f"({letter}) {title}" if len(quantities) > 1 else title


def exact_samples(flow: TaylorGreen, points: Array, times: Array) -> Samples:
    """Return an exact solution at points (n_points, n_dim) [m] and times [s]."""
    fields = [(flow.velocity(points, t), flow.pressure(points, t)) for t in times.tolist()]
    velocity, pressure = map(np.array, zip(*fields, strict=True))
    return Samples(times, velocity, pressure)


def _along(line: Samples, quantity: str) -> Array:
    """Return the values (n_snapshots, n_points) of a quantity, a key of LABELS."""
    if quantity == "pressure less its mean":
        return line.pressure - np.nanmean(line.pressure, axis=1, keepdims=True)
    return line.speed if quantity == "speed" else line.pressure


def _ended(line: Samples) -> str:
    return f"after {line.time[-1]:.3g} s" if len(line.time) else "at the start"
