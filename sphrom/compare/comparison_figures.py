"""The figures that `compare` draws for every case, from stored runs and comparisons.

For each parameter point there are fields, lines, errors, reference profiles and measurements, and
for each basis singular values and modes. Figures listed in a case share their parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.comparison import Series
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Row, place_of
from sphrom.case.study_sections import FULL
from sphrom.compare.comparison_tables import SpectrumRow, Tables
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.metrics.histories import cumulative_singular_value_share, energy, without_mean
from sphrom.metrics.measures import UNITS, Samples, components
from sphrom.models.contract import BEST, Ability, basis_used, family_of
from sphrom.models.stored_run import StoredRun
from sphrom.plots.panels import Curve, Field, Frame, Panel, Role, draw_grid, save
from sphrom.scenes.flows import TaylorGreen
from sphrom.setup.assembly import field_measures
from sphrom.setup.draw import solids_within
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {
    "speed": "speed [m/s]",
    "pressure": "pressure [Pa]",
    "pressure less its mean": "pressure less its mean [Pa]",
}
QUANTITIES = ("speed", "pressure")
FLAT = 0.4
"""Height over width below which pictures are placed below each other."""
ERRORS = (
    {
        "velocity_field_relative_l2": "velocity, field: relative L2 [%]",
        "velocity_line_relative_l2": "velocity, line: relative L2 [%]",
        "velocity_line_eq41_by_line_range": "speed, line: mean error over range (Eq. 4.1) [%]",
    },
    {
        "pressure_field_relative_l2": "pressure less its mean, field: relative L2 [%]",
        "pressure_line_relative_l2": "pressure less its mean, line: relative L2 [%]",
        "pressure_line_eq41_by_line_range": "pressure, line: mean error over range (Eq. 4.1) [%]",
    },
)
"""The errors to draw, with their labels: a row of velocities and one of pressures."""
SPACES = {
    "reference": ("bases", "reference_position"),
    "Lagrangian": ("lagrangian", "lagrangian_position"),
}
"""Spaces of modes, with the groups of their modes and points in the artifact of the bases."""
COMPONENTS = {"x-velocity": 0, "y-velocity": 1}
MOST_MODES = 10
"""Most pictures of modes in a row."""
SMALLEST_RATIO, SMALLEST_SHARE = 1e-12, 1e-10
"""Singular values over the first, and omitted shares [%], below which they are rounding errors."""
SPECTRUM = ("singular value, relative to the first [–]", "later singular values, of the sum [%]")


def draw_comparison(workspace: Workspace, tables: Tables, *, again: bool) -> None:
    """Draw the figures of a comparison into the folder `plots`, missing ones or all `again`."""
    folder = workspace.folder("plots")
    with StoredComparison.of(workspace) as comparison:
        figures = list(_figures(workspace, tables, comparison))
        named = {folder / f"{name}.png" for name, _ in figures}
        for point in workspace.case.plan.points:  # remove figures of earlier comparisons
            for old in {*folder.glob(f"*-{point.file_label}.png")} - named:
                old.unlink()
        with workspace.context.report.details.progress("pictures", len(figures)) as advance:
            for name, draw in figures:
                if again or not (folder / f"{name}.png").exists():
                    save(draw(), folder / f"{name}.png")
                advance(1)


def _figures(
    workspace: Workspace, tables: Tables, comparison: StoredComparison
) -> Iterator[tuple[str, Callable[[], Figure]]]:
    case = workspace.case
    for point in case.plan.points:
        figures = _PointFigures(workspace, tables, comparison, point)
        for name, draw in figures.all():
            yield f"{name}-{point.file_label}", draw
    for basis in case.plan.bases if case.rom else ():
        sizes = model_sizes(workspace, basis)
        yield f"singular-values-{basis}", partial(draw_spectrum, workspace, basis, sizes)
        if family_of(case).can(Ability.MODE_FIELDS):
            yield f"modes-{basis}", partial(draw_modes, workspace, basis)


class _PointFigures:
    """The figures of one parameter point, with the prefixes of their file names."""

    def __init__(
        self, workspace: Workspace, tables: Tables, stored: StoredComparison, point: ParameterPoint
    ) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.point = point
        self.comparison = stored
        self.probes = probes_of(self.case)
        rows = [r for r in tables.errors if (r.parameters, r.against) == (point.label, FULL)]
        status = {row.compared: row.status for row in rows}
        self.models = [model for model in self.case.rom if model.name in status]
        self.complete = [m for m in self.models if status[m.name] == "complete"]
        best = [row for row in rows if row.compared.startswith(BEST)]
        self.best = max(best, key=lambda row: row.n_modes or 0).compared if best else None
        settled = (r for r in tables.reference if r.parameters == point.label and r.settled)
        self.references = list(settled)
        self.time = stored.samples(None, point)[1].time
        self.middle = len(self.time) // 2
        self.when = f"{point.label}, t = {self.time[self.middle]:.3g} s"

    def all(self) -> Iterator[tuple[str, Callable[[], Figure]]]:
        if self.complete:
            yield "fields", self._fields
            yield "overview", self._overview
        yield "centrelines", self._centrelines
        if self._errors:
            yield "errors", self._draw_errors
        if self.references:
            yield "profiles", self._profiles
        for name, measured in self.case.scene.recorded.items():
            kind = "measure" if measured.force_on is None else "force"
            yield f"{kind}-{name}", partial(self._measured, name)
        if len(self.probes.stations):
            yield "history", self._history

    @cached_property
    def _pictures(self) -> dict[str, dict[str, Array]]:
        """Pictures of the full run and of reduced runs at half time, by run and quantity."""
        pictures = {}
        for model in (None, *self.complete):
            with StoredRun.opened(self.workspace, self.point, model) as run:
                samples = run.sampled(self.probes.grid, [self.middle])
            wet = (samples.speed[0] != 0.0) | (samples.pressure[0] != 0.0)
            fields = (np.where(wet, getattr(samples, q)[0], np.nan) for q in QUANTITIES)
            values = dict(zip(QUANTITIES, map(self.probes.picture, fields), strict=True))
            pictures[FULL if model is None else model.name] = values
        return pictures

    @property
    def _scales(self) -> dict[str, tuple[float, float]]:
        full = self._pictures[FULL].items()
        return {LABELS[q]: (float(np.nanmin(f)), float(np.nanmax(f))) for q, f in full}

    def _beside(self, name: str, quantity: str) -> list[Field]:
        both = (self._pictures[run][quantity] for run in (FULL, name))
        return side_by_side(name, quantity, *both)

    def _fields(self) -> Figure:
        rows = [
            [field for quantity in QUANTITIES for field in self._beside(model.name, quantity)]
            for model in self.complete
        ]
        return draw_grid(rows, frame_of(self.case), scales=self._scales, title=self.when)

    def _overview(self) -> Figure:
        fastest = next(m for m in self.case.plan.models_by_speed if m in self.complete)
        complete = {m.name: self._errors[m.name] for m in self.complete}
        label = "velocity, field, over time: relative L2 [%]"
        errors = _error_panel(self.case, "velocity_field_relative_l2", label, complete)
        frame = frame_of(self.case)
        fields = self._beside(fastest.name, "speed")
        flat = np.ptp(frame.extent[2:]) < FLAT * np.ptp(frame.extent[:2])
        rows = [[field] for field in fields] if flat else [fields]
        return draw_grid(rows, frame, scales=self._scales, title=self.when, beside=errors)

    @cached_property
    def _errors(self) -> dict[str, Series]:
        """The errors over time of models, by name."""
        each = {m.name: self.comparison.errors(m.name, self.point) for m in self.models}
        return {name: series for name, series in each.items() if series is not None}

    def _centrelines(self) -> Figure:
        rows, time = [(tuple(self.complete), (self.point,))], self.time[self.middle]
        return draw_lines(self.case, self.comparison, rows, time, tuple(LABELS))

    def _draw_errors(self) -> Figure:
        others: list[tuple[str, Role, Series | None]] = [
            ("full against exact", "level", self.comparison.errors(FULL, self.point, "exact"))
        ]
        if self.best is not None:
            best = self.comparison.errors(self.best, self.point)
            others.append(("best possible (projection)", "best", best))
        panel = partial(_error_panel, self.case, models=self._errors, others=others)
        rows = [[panel(name, label) for name, label in row.items()] for row in ERRORS]
        line = f"on the line x = {self.case.plan.probe_line:g} m"
        return draw_grid(rows, title=f"{self.point.label}, over the field and {line}")

    def _profiles(self) -> Figure:
        """Draw the full run beside all references that it can match, by quantity."""
        panels: dict[tuple[str, str], dict[str, Curve]] = {}
        for row in self.references:
            profile = self.comparison.profile(row, self.point)
            state = row.state if row.reference_time is None else f"t = {row.reference_time:.3g} s"
            when = f"t = {row.time:.3g} s"
            if row.n_snapshots > 1:
                when = f"mean over {row.from_time:.3g} s to {row.time:.3g} s"
            quantity, _, axis = row.profile.split()
            labels = f"{axis} / L [–]", f"{quantity} / {'ρ U²' if quantity == 'p' else 'U'} [–]"
            at = profile.coordinate
            expected = profile.reference_value
            curves = [
                Curve(f"full, {when}", at, profile.value, "full"),
                Curve(f"{row.source}, {state}", at, expected, "reference"),
            ]
            # References at the same time share the curve of the full run.
            panels.setdefault(labels, {}).update({curve.label: curve for curve in curves})
        row_of_panels = [Panel("", *names, list(some.values())) for names, some in panels.items()]
        return draw_grid([row_of_panels], title=self.point.label)

    def _measured(self, name: str) -> Figure:
        """Draw a measurement over time, or along a line at the end, with a panel per component."""
        title = f"{name}, {self.point.label}"
        x_label = "time [s]"
        x = self.time
        measure = field_measures(self.case).get(name)
        is_line = measure is not None and measure.normal is None and len(measure.position) > 1
        if measure is not None and is_line:
            title, x_label = f"{title}, t = {x[-1]:.4g} s", "along the line [m]"
            x = np.hypot(*(measure.position - measure.position[0]).T)
        panels: dict[str, list[Curve]] = {}
        for model in (None, *self.complete):
            with StoredRun.opened(self.workspace, self.point, model) as run:
                quantities = run.measured(name)
            for quantity, values in quantities.items():
                for component, one in components(quantity, values).items():
                    label = f"{component.replace('_', ' ')} [{UNITS[quantity]}]"
                    # Flow rates and probes have a single place.
                    shown = one[-1] if is_line else one.reshape(len(x))
                    curve = _curve(self.case, FULL if model is None else model.name, x, shown)
                    panels.setdefault(label, []).append(curve)
        return draw_grid([[Panel("", x_label, *panel) for panel in panels.items()]], title=title)

    def _history(self) -> Figure:
        x, y = self.probes.stations[0]
        curves = []
        for name in (None, *(model.name for model in self.complete)):
            run = self.comparison.samples(name, self.point, "stations")[1]
            if len(run.time):
                curves.append(_curve(self.case, name or FULL, run.time, run.velocity[:, 0, 1]))
        title = f"{self.point.label}, at x = {x:.4g} m, y = {y:.4g} m"
        return draw_grid([[Panel("", "time [s]", "v [m/s]", curves)]], title=title)


def side_by_side(name: str, quantity: str, full: Array, reduced: Array) -> list[Field]:
    """Return pictures of a quantity in the full run, in a reduced run, and of the difference."""
    label, unit = LABELS[quantity], LABELS[quantity].partition("[")[2]
    return [
        Field(f"{quantity}, full", label, full),
        Field(f"{quantity}, {name}", label, reduced),
        Field("difference", f"difference [{unit}", reduced - full, difference=True),
    ]


def _curve(case: Case, name: str, x: Array, y: Array) -> Curve:
    return (
        Curve(name, x, y, "full") if name == FULL else Curve(name, x, y, place=place_of(case, name))
    )


def _error_panel(
    case: Case,
    name: str,
    label: str,
    models: Mapping[str, Series],
    others: Sequence[tuple[str, Role, Series | None]] = (),
) -> Panel:
    """Return a panel with one error of reduced models over time, on a logarithmic axis.

    The axis is logarithmic because errors are largest at a start from rest.
    """

    def error(series: Series) -> tuple[Array, Array]:
        return series.time, {**series.relative_l2, **series.eq41}[name]

    curves = [Curve(name, *error(each), role) for name, role, each in others if each is not None]
    curves += [_curve(case, model, *error(series)) for model, series in models.items()]
    return Panel("", "time [s]", label, curves, "logarithmic")


def lettered(quantities: Sequence[str], quantity: str, title: str) -> str:
    """Return the title of a panel, with a letter for its quantity if there are several."""
    letter = ascii_lowercase[quantities.index(quantity)]
    return f"({letter}) {title}" if len(quantities) > 1 else title


def draw_lines(
    case: Case,
    comparison: StoredComparison,
    rows: Sequence[Row],
    time: float,
    quantities: Sequence[str],
) -> Figure:
    """Draw profiles on the line at the snapshot nearest to a time [s], with a row per point.

    Full, exact and reduced runs share panels; `quantities` are keys of LABELS. The title of a panel
    names models that became unstable earlier.
    """
    panels = []
    where = np.empty((0, 2))
    for models, points in rows:
        for point in points:
            where, full = comparison.samples(None, point)
            index = int(np.argmin(np.abs(full.time - time)))
            time = float(full.time[index])
            y = where[:, 1]
            row = []
            lines = {m.name: comparison.samples(m.name, point)[1] for m in models if m is not None}
            for quantity in quantities:
                curves = []
                title = lettered(quantities, quantity, point.label)
                if (flow := case.plan.flow(point).exact) is not None:
                    exact = exact_samples(flow, where, full.time[index : index + 1])
                    curves.append(Curve("exact", y, _along(exact, quantity)[0], "exact"))
                for name, line in {FULL: full, **lines}.items():
                    if index < len(line.time):
                        curves.append(_curve(case, name, y, _along(line, quantity)[index]))
                        continue
                    before = f"after {line.time[-1]:.3g} s" if len(line.time) else "at the start"
                    title += f"\nnot shown: {name}, unstable {before}"
                row.append(Panel(title, "y [m]", LABELS[quantity], curves))
            panels.append(row)
    return draw_grid(panels, title=f"x = {where[0, 0]:.4g} m, t = {time:.4g} s")


def exact_samples(flow: TaylorGreen, points: Array, times: Array) -> Samples:
    """Return an exact solution at points (n_points, 2) [m] and times [s]."""
    fields = [(flow.velocity(points, t), flow.pressure(points, t)) for t in times.tolist()]
    velocity, pressure = map(np.array, zip(*fields, strict=True))
    return Samples(times, velocity, pressure)


def _along(line: Samples, quantity: str) -> Array:
    """Return the values (n_snapshots, n_points) of a quantity, a key of LABELS."""
    if quantity == "pressure less its mean":
        return without_mean(line.pressure)
    return line.speed if quantity == "speed" else line.pressure


def frame_of(case: Case) -> Frame:
    """Return the part of the plane that pictures of a case show."""
    box = case.scene.domain
    extent = (box.lower[0], box.upper[0], box.lower[1], box.upper[1])
    return Frame(extent, None if box.fills_box else solids_within(box, extent))


def model_sizes(workspace: Workspace, basis: str) -> list[int]:
    """Return the numbers of modes of a basis that models use."""
    case = workspace.case
    used = (basis_used(workspace, m, point) for m in case.rom for point in case.plan.rom_points(m))
    return sorted({size for name, size in used if name == basis})


def _spectra(workspace: Workspace) -> Iterator[tuple[str, str, str, Array]]:
    """Yield space, basis, part and singular values of all decompositions."""
    with workspace.open(workspace.basis()) as artifact:
        for space, (parent, _) in SPACES.items():
            for name in artifact.datasets:
                match name.split("/"):
                    case [folder, basis, "singular_values", part] if folder == parent:
                        yield space, basis, part, artifact.read(name)


def spectrum_rows(workspace: Workspace) -> Iterator[SpectrumRow]:
    """Yield the rows of the table of singular values, if the case has reduced models."""
    for space, basis, part, values in _spectra(workspace) if workspace.case.rom else ():
        each = zip(values, cumulative_singular_value_share(values), energy(values), strict=True)
        for m, figures in enumerate(each, start=1):
            yield SpectrumRow(space, basis, part, m, *map(float, figures))


def draw_spectrum(
    workspace: Workspace, basis: str, marked: Sequence[int], *, with_shares: bool = False
) -> Figure:
    """Draw singular values, and the shares of the omitted ones (Eq. 4.3) over the mode number.

    `marked` numbers of modes have a line and, with `with_shares`, their shares in the legend.
    """
    values_of, left_out_of = [], []
    for space, _, part, values in (each for each in _spectra(workspace) if each[1] == basis):
        name = f"{space} space" + ("" if part == "joint" else f", {part}")
        shares = cumulative_singular_value_share(values)
        if with_shares:
            texts = (f"{_share(shares[m - 1])} % (M = {m})" for m in marked if m <= len(shares))
            name = f"{name}: {', '.join(texts)}"
        number = np.arange(1.0, len(values) + 1.0)
        ratio, left_out = values / values[0], 100.0 - shares
        values_of.append(Curve(name, number, np.where(ratio > SMALLEST_RATIO, ratio, 0.0)))
        left_out = np.where(left_out > SMALLEST_SHARE, left_out, 0.0)
        left_out_of.append(Curve(name, number, left_out))
    panels = [
        Panel("", "mode number M [–]", label, curves, "both logarithmic", marked)
        for label, curves in zip(SPECTRUM, (values_of, left_out_of), strict=True)
    ]
    return draw_grid([panels])


def _share(share: float) -> str:
    """Format a share [%] with two significant digits of its difference from 100 %."""
    for digits in range(1, 12):
        if round(100.0 - share, digits) >= 10.0 ** (1 - digits):
            return f"{share:.{digits}f}"
    return f"{share:.12g}"


def mode_fields(
    workspace: Workspace, basis: str, field: str, numbers: Sequence[int]
) -> dict[str, list[Field]]:
    """Return pictures of one field of modes (from 1) by space; Lagrangian ones are optional."""
    fields: dict[str, list[Field]] = {}
    unit = "1/m" if workspace.case.basis.inner_product == "acoustic" else "–"
    with workspace.open(workspace.basis()) as artifact:
        for space, (parent, position) in SPACES.items():
            name = f"{parent}/{basis}/modes/{'velocity' if field in COMPONENTS else field}"
            if name not in artifact:
                continue
            picture = frame_of(workspace.case).raster(artifact.read(position))
            for number in numbers:
                values = np.asarray(artifact.dataset(name)[number - 1])
                if field in COMPONENTS:
                    values = values[:, COMPONENTS[field]]
                title, label = f"{space} space\nmode {number}", f"{field} [{unit}]"
                fields.setdefault(space, []).append(Field(title, label, picture(values)))
    return fields


def draw_modes(workspace: Workspace, basis: str) -> Figure:
    """Draw density and velocity of the first modes that models use, with spaces side by side."""
    number = max(model_sizes(workspace, basis), default=1)
    most = MOST_MODES
    if workspace.case.basis.lagrangian:
        most //= len(SPACES)
    numbers = list(range(1, number + 1))
    if number > most:  # the first modes, and some of the others
        numbers = sorted({round(m) for m in np.geomspace(1, number, most)})
    rows = []
    for field in ("density", *COMPONENTS):
        spaces = mode_fields(workspace, basis, field, numbers)
        rows.append([each for fields in spaces.values() for each in fields])
    return draw_grid(rows, frame_of(workspace.case))
