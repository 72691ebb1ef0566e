"""The figures that `compare` draws of every case, as grids of panels.

At each parameter point they are fields, centrelines, errors, reference profiles and measurements,
of each basis singular values and modes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.compare.results import Excerpt, PointResults
from sphrom.compare.rows import BEST
from sphrom.errors import ArtifactError
from sphrom.metrics.discrepancy import cumulative_singular_value_share, without_mean
from sphrom.metrics.histories import History
from sphrom.metrics.measures import UNITS, FieldMeasure, components
from sphrom.metrics.samples import Probes, Samples
from sphrom.plots.canvas import save
from sphrom.plots.panels import Curve, Field, Panel, Role, draw_grid
from sphrom.plots.pictures import Frame
from sphrom.setup.assembly import field_measures
from sphrom.setup.draw import solids_within
from sphrom.store.trained_operators import sized
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

QUANTITIES = ("speed", "pressure")
LABELS = {
    "speed": "speed [m/s]",
    "pressure": "pressure [Pa]",
    "pressure less its mean": "pressure less its mean [Pa]",
}
ERRORS = (
    {
        ("velocity_field", "relative_l2"): "velocity, field: relative L2 [%]",
        ("velocity_line", "relative_l2"): "velocity, line: relative L2 [%]",
        ("velocity_line", "eq41_by_line_range"): "speed, line: Eq. 4.1 by the line's range [%]",
    },
    {
        ("pressure_field", "relative_l2"): "pressure less its mean, field: relative L2 [%]",
        ("pressure_line", "relative_l2"): "pressure less its mean, line: relative L2 [%]",
        ("pressure_line", "eq41_by_line_range"): "pressure, line: Eq. 4.1 by the line's range [%]",
    },
)
"""The errors that are drawn, a row of velocities and one of pressures, and their labels."""
OVERVIEW = "velocity, field, at all instants: relative L2 [%]"


def draw_all(workspace: Workspace, results: Sequence[PointResults], probes: Probes) -> None:
    """Draw every default figure of a comparison into the folder `plots`."""
    folder, case = workspace.folder("plots"), workspace.case
    for result in results:
        for name, figure in _figures_of_point(case, result, probes):
            save(figure, folder / f"{name}-{result.point.file_label}.png")
    for basis in case.plan.bases if case.rom else ():
        marked = model_sizes(workspace, basis)
        save(draw_spectrum(workspace, basis, marked), folder / f"singular-values-{basis}.png")
        save(draw_modes(workspace, basis), folder / f"modes-{basis}.png")


def _figures_of_point(
    case: Case, result: PointResults, probes: Probes
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of one parameter point, and how the names of their files begin."""
    point, complete = result.point.label, result.complete()
    excerpts = {"full": result.full, **{name: c.excerpt for name, c in complete.items()}}
    when = f"{point}, t = {result.full.middle.time[0]:.3g} s"
    if complete:
        yield from _pictures(case, result, excerpts, probes, when)
    middle = len(result.full.line.time) // 2
    exact = None if result.exact is None else result.exact.line.until(middle + 1)
    lines = {name: excerpt.line for name, excerpt in excerpts.items()}
    panels = line_panels("", probes.line[:, 1], lines, middle, LABELS, exact)
    title = f"{when}, along x = {probes.line[0, 0]:.4g} m"
    yield "centrelines", draw_grid([panels], title=title)
    found = result.against("full")
    known = {name: found[name].history for name in result.models if len(found[name].history.time)}
    if known:
        others: list[tuple[str, Role, History | None]] = [
            ("full against exact", "level", result.full_against_exact()),
            ("best possible (projection)", "best", result.best()),
        ]
        rows = [[_errors(m, label, known, others) for m, label in row.items()] for row in ERRORS]
        yield "errors", draw_grid(rows, title=point)
    if panels := _reference_panels(result):
        yield "profiles", draw_grid([panels], title=point)
    for name in case.scene.measured_walls:
        yield f"force-{name}", _draw_measured(result, name)
    for name, measure in field_measures(case).items():
        yield f"measure-{name}", _draw_measured(result, name, measure)
    if len(probes.stations):
        x, y = probes.stations[0]
        stations = {name: excerpt.stations for name, excerpt in excerpts.items()}
        curves = [Curve(n, s.time, s.velocity[:, 0, 1], _role(n)) for n, s in stations.items()]
        panel = Panel("", "time [s]", "v [m/s]", curves)
        title = f"{point}, at x = {x:.4g} m, y = {y:.4g} m"
        yield "history", draw_grid([[panel]], title=title)


def _pictures(
    case: Case, result: PointResults, runs: Mapping[str, Excerpt], probes: Probes, when: str
) -> Iterator[tuple[str, Figure]]:
    """Yield fields half-way through with differences, and an overview of the fastest model."""
    seen = {
        name: {q: probes.picture(getattr(e.middle, q)[0, probes.on_grid]) for q in QUANTITIES}
        for name, e in runs.items()
    }
    scales = {
        LABELS[q]: (float(np.nanmin(seen["full"][q])), float(np.nanmax(seen["full"][q])))
        for q in QUANTITIES
    }
    rows = {
        name: [field for q in QUANTITIES for field in _beside(name, q, seen["full"][q], fields[q])]
        for name, fields in seen.items()
        if name != "full"
    }
    frame = frame_of(case)
    yield "fields", draw_grid([*rows.values()], frame, scales=scales, title=when)
    fastest = next(m.name for m in case.plan.models_by_speed if m.name in rows)
    histories = {name: c.history for name, c in result.complete().items()}
    errors = _errors(("velocity_field", "relative_l2"), OVERVIEW, histories)
    yield "overview", draw_grid([[*rows[fastest][:3], errors]], frame, scales=scales, title=when)


def _beside(name: str, quantity: str, full: Array, reduced: Array) -> Iterator[Field]:
    """Yield a quantity of the full run, of a reduced one, and their difference."""
    label, unit = LABELS[quantity], LABELS[quantity].partition("[")[2]
    yield Field(f"{quantity}, full", label, full)
    yield Field(f"{quantity}, {name}", label, reduced)
    yield Field("difference", f"difference [{unit}", reduced - full, difference=True)


def line_panels(
    title: str,
    y: Array,
    lines: Mapping[str, Samples],
    snapshot: int,
    quantities: Iterable[str],
    exact: Samples | None,
) -> list[Panel]:
    """Return quantities along a line (n_points,) at a snapshot: full, exact (at its last), reduced.

    A run that became unstable before has no curve.
    """
    panels = []
    for quantity in quantities:
        curves = []
        if exact is not None:
            curves.append(Curve("exact", y, _along(exact, quantity)[-1], "exact"))
        for name, line in lines.items():
            if snapshot < len(line.time):
                curves.append(Curve(name, y, _along(line, quantity)[snapshot], _role(name)))
            else:
                before = f"after {line.time[-1]:.3g} s" if len(line.time) else "at the start"
                curves.append(Curve(f"{name} (unstable {before})", np.empty(0), np.empty(0)))
        panels.append(Panel(title, "y [m]", LABELS[quantity], curves))
    return panels


def _along(line: Samples, quantity: str) -> Array:
    """Return a key of LABELS (n_snapshots, n_points)."""
    if quantity == "pressure less its mean":
        return without_mean(line.pressure)
    return line.speed if quantity == "speed" else line.pressure


def _role(name: str) -> Role:
    return "full" if name == "full" else "run"


def _errors(
    measure: tuple[str, str],
    label: str,
    histories: Mapping[str, History],
    others: Sequence[tuple[str, Role, History | None]] = (),
) -> Panel:
    """Return one error of reduced models over time, from zero; beside others logarithmic."""
    place, name = measure
    drawn = [*others, *((model, "run", history) for model, history in histories.items())]
    curves = [
        Curve(told, history.time, getattr(history.places[place], name), role)
        for told, role, history in drawn
        if history is not None
    ]
    return Panel("", "time [s]", label, curves, "logarithmic" if others else "from zero")


def _reference_panels(result: PointResults) -> list[Panel]:
    """Return the full run beside every reference that it can match, a panel for each quantity."""
    panels: dict[tuple[str, str], dict[str, Curve]] = {}
    for compared in (c for c in result.references if c.row.settled):
        row, reference = compared.row, compared.reference
        state = row.state if row.reference_time is None else f"t = {row.reference_time:.3g} s"
        when = f"t = {row.time:.3g} s"
        if row.n_snapshots > 1:
            when = f"mean over {row.from_time:.3g} s to {row.time:.3g} s"
        unit = "ρ U²" if reference.quantity == "p" else "U"
        labels = f"{reference.axis} / L [–]", f"{reference.quantity} / {unit} [–]"
        curves = [
            Curve(f"full, {when}", compared.line_coordinate, compared.line_value, "full"),
            Curve(f"{row.source}, {state}", reference.coordinate, reference.value, "reference"),
        ]
        # Several references at one time share the full run's line.
        panels.setdefault(labels, {}).update({curve.label: curve for curve in curves})
    return [Panel("", *labels, list(curves.values())) for labels, curves in panels.items()]


def _shown(runs: Iterable[str], models: Iterable[str]) -> list[str]:
    """Return the runs that figures of measurements show: full, mapped, projected and reduced."""
    others = [name for name in runs if name == "map" or name.startswith(BEST)]
    return ["full", *others, *models]


def _measured(x_label: str, x: Array, label: str, values: Mapping[str, Array]) -> Panel:
    """Return a quantity of several runs over time or along a line."""
    curves = [Curve(name, x, value, _role(name)) for name, value in values.items()]
    return Panel("", x_label, label, curves)


def _draw_measured(
    result: PointResults, measured: str, measure: FieldMeasure | None = None
) -> Figure:
    """Draw a measurement over time, or at the end along a line, a panel for each component."""
    runs = {m.compared: m for m in result.measured if m.measured == measured}
    full, title = runs["full"], f"{measured}, {result.point.label}"
    along, is_line = ("time [s]", full.time), False
    if measure is not None and len(measure.position) > 1 and measure.normal is None:
        is_line, way = True, np.hypot(*(measure.position - measure.position[0]).T)
        along, title = ("along the line [m]", way), f"{title}, t = {full.time[-1]:.4g} s"
    panels: dict[str, dict[str, Array]] = {}
    for name in _shown(runs, result.complete()):
        for quantity, values in runs[name].quantities.items():
            for component, one in components(quantity, values).items():
                told = f"force {component}" if quantity == "force" else component.replace("_", " ")
                label = f"{told} [{UNITS[quantity]}]"
                # A flow rate is over time alone, a probe's fields are at one place.
                shown = one[-1] if is_line else one.reshape(len(full.time))
                panels.setdefault(label, {})[name] = shown
    return draw_grid([[_measured(*along, *panel) for panel in panels.items()]], title=title)


SPACES = {"reference": "bases", "Lagrangian": "lagrangian"}
"""Spaces of modes, and where the artifact of the bases has them."""
POSITIONS = {"reference": "reference_position", "Lagrangian": "lagrangian_position"}
COMPONENTS = {"x-velocity": 0, "y-velocity": 1}
MOST_MODES = 10
"""Pictures of modes beside each other."""
SMALLEST_RATIO = 1e-12
"""Singular values below this, over the first, are rounding and are not drawn."""
SMALLEST_SHARE = 1e-10
"""[%]; a share left out below this is rounding and is not drawn."""
SPECTRUM = ("singular value, relative to the first [–]", "share left out, 100 − Eq. 4.3 [%]")


def frame_of(case: Case) -> Frame:
    """Return what of the plane the pictures of a case show."""
    box = case.scene.domain
    extent = (box.lower[0], box.upper[0], box.lower[1], box.upper[1])
    return Frame(extent, None if box.fills_box else solids_within(box, extent))


def spectra(workspace: Workspace) -> Iterator[tuple[str, str, str, Array]]:
    """Yield space, basis, part and singular values of everything that was decomposed."""
    with workspace.open(workspace.basis()) as artifact:
        for space, parent in SPACES.items():
            for name in artifact.datasets:
                match name.split("/"):
                    case [folder, basis, "singular_values", part] if folder == parent:
                        yield space, basis, part, artifact.read(name)


def draw_spectrum(
    workspace: Workspace, basis: str, marked: Sequence[int], *, with_shares: bool = False
) -> Figure:
    """Return singular values, and the share that so many modes leave out (Eq. 4.3).

    Marked numbers of modes have a line, and the legend has their shares on request.
    """
    values_of, left_out_of = [], []
    for space, _, part, values in (each for each in spectra(workspace) if each[1] == basis):
        name = f"{space} space" + ("" if part == "joint" else f", {part}")
        shares = cumulative_singular_value_share(values)
        if with_shares:
            known = (f"{_share(shares[m - 1])} % (M = {m})" for m in marked if m <= len(shares))
            name = f"{name}: {', '.join(known)}"
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
    """Return a share [%] with two digits of what it leaves out."""
    for digits in range(1, 12):
        if round(100.0 - share, digits) >= 10.0 ** (1 - digits):
            return f"{share:.{digits}f}"
    return f"{share:.12g}"


def mode_fields(
    workspace: Workspace, basis: str, field: str, numbers: Sequence[int]
) -> dict[str, list[Field]]:
    """Return one field of modes (from 1) by space; Lagrangian ones are kept where a case asks.

    Raises ArtifactError for a mode that the basis doesn't have.
    """
    fields: dict[str, list[Field]] = {}
    unit = "1/m" if workspace.case.basis.inner_product == "acoustic" else "–"
    with workspace.open(workspace.basis()) as artifact:
        for space, parent in SPACES.items():
            name = f"{parent}/{basis}/modes/{'velocity' if field in COMPONENTS else field}"
            if name not in artifact:
                continue
            if max(numbers) > artifact.length(name):
                raise ArtifactError(f"{artifact.path} has no mode {max(numbers)} of {basis}")
            raster = frame_of(workspace.case).raster(artifact.read(POSITIONS[space]))
            for number in numbers:
                values = np.asarray(artifact.dataset(name)[number - 1])
                if field in COMPONENTS:
                    values = values[:, COMPONENTS[field]]
                title, label = f"{space} space\nmode {number}", f"{field} [{unit}]"
                fields.setdefault(space, []).append(Field(title, label, raster.picture(values)))
    return fields


def draw_modes(workspace: Workspace, basis: str) -> Figure:
    """Return density and velocity of the first modes that models use, spaces side by side."""
    with workspace.open(workspace.basis()) as artifact:
        kept = artifact.length(f"{SPACES['reference']}/{basis}/modes/density")
        in_both = f"{SPACES['Lagrangian']}/{basis}/modes/density" in artifact
    number = min([kept, *model_sizes(workspace, basis)[-1:]])
    most = MOST_MODES // (2 if in_both else 1)
    numbers = list(range(1, number + 1))
    if number > most:  # the first ones, and some of the others
        numbers = sorted({round(m) for m in np.geomspace(1, number, most)})
    rows = []
    for field in ("density", *COMPONENTS):
        spaces = mode_fields(workspace, basis, field, numbers)
        rows.append([each for fields in spaces.values() for each in fields])
    return draw_grid(rows, frame_of(workspace.case))


def model_sizes(workspace: Workspace, basis: str) -> list[int]:
    """Return how many modes of a basis models use."""
    case = workspace.case
    return sorted(
        {
            sized(workspace, model, point).size
            for model in case.rom
            for point in case.plan.rom_points(model)
            if case.plan.basis_for(model, point) == basis
        }
    )
