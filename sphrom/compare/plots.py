"""The figures of a comparison: fields, centrelines, errors, singular values, modes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.compare.point_results import Excerpt, PointResults
from sphrom.compare.reference_errors import ReferenceRow
from sphrom.compare.run_figures import frame_of
from sphrom.metrics.histories import History
from sphrom.metrics.measures import UNITS, FieldMeasure, components
from sphrom.metrics.samples import Probes
from sphrom.plots.canvas import Fields, save
from sphrom.plots.curves import draw_centrelines, draw_error_histories, draw_singular_values
from sphrom.plots.pictures import Modes, draw_fields, draw_modes, draw_overview
from sphrom.plots.series import ComparedProfile, draw_history, draw_measured, draw_profiles
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.setup.assembly import field_measures
from sphrom.store.operators import sized
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_MODES = 10
"""Pictures of modes beside each other."""


def draw_all(workspace: Workspace, results: Sequence[PointResults], probes: Probes) -> None:
    """Draw every figure of a comparison into the folder `plots`."""
    folder = workspace.folder("plots")
    for result in results:
        place = result.point.file_label
        stable = _stable_models(result)
        if stable:
            save(_fields(workspace, result, stable, probes), folder / f"fields-{place}.png")
            save(_overview(workspace, result, stable, probes), folder / f"overview-{place}.png")
        save(_centrelines(result, stable, probes), folder / f"centrelines-{place}.png")
        if told := _models_with_errors(result):
            save(_errors(result, told), folder / f"errors-{place}.png")
        if any(compared.row.settled for compared in result.references):
            save(_profiles(result), folder / f"profiles-{place}.png")
        for measured in workspace.case.scene.measured_walls:
            save(_force(result, stable, measured), folder / f"force-{measured}-{place}.png")
        for name, measure in field_measures(workspace.case).items():
            save(_measure(result, stable, name, measure), folder / f"measure-{name}-{place}.png")
        if len(probes.stations):
            save(_history_at_station(result, stable, probes), folder / f"history-{place}.png")
    for basis in workspace.case.bases if workspace.case.rom else ():
        save(_singular_values(workspace, basis), folder / f"singular-values-{basis}.png")
        save(_modes(workspace, basis), folder / f"modes-{basis}.png")


def spectra(workspace: Workspace) -> Iterator[tuple[str, str, str, Array]]:
    """Yield space, basis, part and singular values of everything that was decomposed."""
    with workspace.open(workspace.basis()) as artifact:
        for parent, space in (("bases", "reference"), ("lagrangian", "Lagrangian")):
            for name in artifact.datasets:
                match name.split("/"):
                    case [folder, basis, "singular_values", part] if folder == parent:
                        yield space, basis, part, artifact.read(name)


def _stable_models(result: PointResults) -> list[str]:
    """Return the reduced models that ran to the end, by name."""
    return [
        timing.model
        for timing in result.timings
        for comparison in result.comparisons
        if comparison.row.compared == timing.model
        and comparison.row.against == "full"
        and comparison.row.status == "complete"
    ]


def _models_with_errors(result: PointResults) -> list[str]:
    """Return the reduced models that have errors at some instants, if only until they diverged."""
    known = result.histories("full")
    return [name for name in result.models if name in known and len(known[name].time)]


def _on_grid(excerpt: Excerpt, probes: Probes) -> Fields:
    speed, pressure = excerpt.middle.speed[0], excerpt.middle.pressure[0]
    return Fields(probes.picture(speed[probes.on_grid]), probes.picture(pressure[probes.on_grid]))


def _on_line(excerpt: Excerpt, probes: Probes) -> Fields:
    line = probes.on_line
    return Fields(excerpt.middle.speed[0, line], excerpt.middle.pressure[0, line])


def _best(result: PointResults) -> History | None:
    """Return the best possible errors of the largest basis that was used."""
    best = [c for c in result.comparisons if c.row.compared.startswith("best") and c.row.n_modes]
    return max(best, key=lambda c: c.row.n_modes or 0).history if best else None


def _fields(
    workspace: Workspace, result: PointResults, models: list[str], probes: Probes
) -> Figure:
    reduced = {name: _on_grid(result.excerpt_of(name), probes) for name in models}
    return draw_fields(
        frame_of(workspace.case),
        _on_grid(result.full, probes),
        reduced,
        about=_instant(result),
    )


def _instant(result: PointResults) -> str:
    """Return where and when half-way is."""
    return f"{result.point.label}, t = {result.full.middle.time[0]:.3g} s"


def _overview(
    workspace: Workspace, result: PointResults, models: list[str], probes: Probes
) -> Figure:
    histories = result.histories("full")
    shown = next(m.name for m in workspace.case.models_by_speed if m.name in models)
    return draw_overview(
        frame_of(workspace.case),
        _on_grid(result.full, probes).speed,
        _on_grid(result.excerpt_of(shown), probes).speed,
        {name: histories[name] for name in models},
        reduced_label=shown,
        about=_instant(result),
    )


def _centrelines(result: PointResults, models: list[str], probes: Probes) -> Figure:
    return draw_centrelines(
        probes.line[:, 1],
        _on_line(result.full, probes),
        {name: _on_line(result.excerpt_of(name), probes) for name in models},
        exact=_on_line(result.exact, probes) if result.exact is not None else None,
        about=f"{_instant(result)}, along x = {probes.line[0, 0]:.4g} m",
    )


def _profiles(result: PointResults) -> Figure:
    """Draw the full run beside every reference that it can match, a panel for each quantity."""
    panels: dict[tuple[str, str], list[ComparedProfile]] = {}
    for compared in (c for c in result.references if c.row.settled):
        row, reference = compared.row, compared.reference
        state = row.state if row.reference_time is None else f"t = {row.reference_time:.3g} s"
        panels.setdefault(_profile_label(reference), []).append(
            ComparedProfile(
                f"{row.source}, {state}",
                f"full model, {_window(row)}",
                compared.line_coordinate,
                compared.line_value,
                reference.coordinate,
                reference.value,
            )
        )
    return draw_profiles(panels, title=result.point.label)


def _window(row: ReferenceRow) -> str:
    """Return the time of a profile, in words."""
    if row.n_snapshots == 1:
        return f"t = {row.time:.3g} s"
    return f"mean over {row.from_time:.3g} s to {row.time:.3g} s"


def _profile_label(reference: ReferenceProfile) -> tuple[str, str]:
    """Return the labels of a profile's axes."""
    unit = "ρ U²" if reference.quantity == "p" else "U"
    return f"{reference.axis} / L [–]", f"{reference.quantity} / {unit} [–]"


def _history_at_station(result: PointResults, models: list[str], probes: Probes) -> Figure:
    x, y = probes.stations[0]
    return draw_history(
        _at_station(result.full),
        {name: _at_station(result.excerpt_of(name)) for name in models},
        label="v [m/s]",
        title=f"{result.point.label}, at x = {x:.4g} m, y = {y:.4g} m",
    )


def _force(result: PointResults, models: list[str], measured: str) -> Figure:
    """Draw the force on a wall over time, full, projected and reduced, by component."""
    runs = {f.row.compared: f for f in result.forces if f.row.measured == measured}
    shown = _shown(runs, models)
    panels = {
        label: {name: runs[name].loads[:, component] for name in shown}
        for component, label in enumerate(("force x [N/m]", "force y [N/m]", "torque [N]"))
    }
    title = f"{measured}, {result.point.label}"
    return draw_measured(("time [s]", runs["full"].time), panels, title=title)


def _shown(runs: Iterable[str], models: Sequence[str]) -> list[str]:
    """Return the runs that figures of measurements show: full, mapped, projected and reduced."""
    others = [name for name in runs if name == "map" or name.startswith("best possible")]
    return ["full", *others, *models]


def _measure(
    result: PointResults, models: list[str], measured: str, measure: FieldMeasure
) -> Figure:
    """Draw what is measured over time, or at the end along a line, a panel for each component."""
    runs = {m.compared: m for m in result.measures if m.measured == measured}
    full, title = runs["full"], f"{measured}, {result.point.label}"
    along, is_line = ("time [s]", full.time), len(measure.position) > 1 and measure.normal is None
    if is_line:
        way = np.hypot(*(measure.position - measure.position[0]).T)
        along, title = ("along the line [m]", way), f"{title}, t = {full.time[-1]:.4g} s"
    panels: dict[str, dict[str, Array]] = {}
    for name in _shown(runs, models):
        for quantity, values in runs[name].quantities.items():
            for component, one in components(quantity, values).items():
                label = f"{component.replace('_', ' ')} [{UNITS[quantity]}]"
                # A flow rate is over time alone, a probe's fields are at one place.
                shown = one[-1] if is_line else one.reshape(len(full.time))
                panels.setdefault(label, {})[name] = shown
    return draw_measured(along, panels, title=title)


def _at_station(excerpt: Excerpt) -> tuple[Array, Array]:
    """Return times and v at the first station."""
    return excerpt.stations.time, excerpt.stations.velocity[:, 0, 1]


def _errors(result: PointResults, models: list[str]) -> Figure:
    histories = result.histories("full")
    return draw_error_histories(
        {name: histories[name] for name in models},
        best=_best(result),
        full_against_exact=result.histories("exact").get("full"),
        log_scale=True,
        about=result.point.label,
    )


def _singular_values(workspace: Workspace, basis: str) -> Figure:
    chosen = {
        f"{space} space" + ("" if part == "joint" else f", {part}"): values
        for space, name, part, values in spectra(workspace)
        if name == basis
    }
    return draw_singular_values(chosen, _sizes(workspace, basis))


def _sizes(workspace: Workspace, basis: str) -> list[int]:
    """Return how many modes of a basis models use."""
    case = workspace.case
    return sorted(
        {
            sized(workspace, model, point).size
            for model in case.rom
            for point in case.rom_points(model)
            if case.basis_for(model, point) == basis
        }
    )


def _modes(workspace: Workspace, basis: str) -> Figure:
    spaces: dict[str, Modes] = {}
    with workspace.open(workspace.basis()) as artifact:
        places = (
            ("bases", "reference", "reference_position"),
            ("lagrangian", "Lagrangian", "lagrangian_position"),
        )
        for parent, space, position in places:
            if f"{parent}/{basis}/modes/density" in artifact:
                spaces[space] = Modes(
                    position=artifact.read(position),
                    density=artifact.read(f"{parent}/{basis}/modes/density"),
                    velocity=artifact.read(f"{parent}/{basis}/modes/velocity"),
                )
    kept = len(spaces["reference"].density)
    numbers = _shown_modes(min([kept, *_sizes(workspace, basis)[-1:]]), len(spaces))
    unit = "1/m" if workspace.case.basis.inner_product == "acoustic" else "-"
    return draw_modes(spaces, numbers, unit=unit, solids=frame_of(workspace.case).solids)


def _shown_modes(number: int, n_spaces: int) -> list[int]:
    """Return which of so many modes are drawn: all, or where they are many the first and some."""
    most = MOST_MODES // n_spaces
    if number <= most:
        return list(range(1, number + 1))
    return sorted({round(m) for m in np.geomspace(1, number, most)})
