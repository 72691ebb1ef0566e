"""A picture of a case before it runs (`sphrom case draw`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from sphrom.arrays import Array
from sphrom.case.measure_sections import ElevationMeasure, ForceMeasure
from sphrom.case.models import Case
from sphrom.case.plan_flows import BEYOND
from sphrom.errors import CaseError
from sphrom.metrics.grids import VIEWS, Extent, Slices, midpoints
from sphrom.plots import panels
from sphrom.plots.frames import Frame, Solids
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.domain import SIDES, Domain, Walls, lattice_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PIXELS = 500
"""Resolution along the longer side of the picture, for distances from walls."""
MOST_PARTICLES = 200_000
"""Largest number of particles in a picture."""
VECTORS_BELOW = 5_000
"""Largest number of particles that are drawn as vector graphics."""
WIDTH, HEIGHT = 9.0, 7.5
"""Largest size of the frame [inch]."""
LONGEST_ARROW, MOST_ARROWS = 0.08, 12
"""Length for the fastest wall, relative to the frame's diagonal, and number per wall."""
FLUID, GHOST, MOVING, MEASURED = panels.COLOURS[5], "#8a8a8a", panels.COLOURS[1], panels.COLOURS[3]
NAME: Any = {
    "fontsize": 8.5,
    "bbox": {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.2},
    "zorder": 7,
}
"""The style of names in the picture."""
CENTRED: Any = {"ha": "center", "va": "center", **NAME}


def run(context: StageContext, output: Path | None = None, folder: Path | None = None) -> None:
    """Draw a case's geometry into a file, by default `<name of the case>.png` in a folder or here.

    Raises CaseError if the file's suffix is unknown, or the file exists and must not be
    overwritten; ArtifactError if it cannot be written.
    """
    case = context.case
    path = output or (folder or Path()) / f"{case.name}.png"
    if path.suffix.lower() not in panels.FORMATS:
        raise CaseError(f"--output: must end in {' or '.join(panels.FORMATS)}; got {path}")
    if path.is_dir() or (path.exists() and not context.force):
        reason = "is a folder" if path.is_dir() else "is there already; --force writes over it"
        raise CaseError(f"{path}: {reason}")
    (folder or Path()).mkdir(parents=True, exist_ok=True)
    panels.save(draw(case), path)
    context.report.info(f"wrote {path}")


def draw(case: Case) -> Figure:
    """Return the picture of a case: particles, ghosts, walls by name, inflow, measurements.

    A box in space is shown by three slices, see `sphrom.metrics.grids.Slices`. Particles are shown
    at their start, before packing. Raises CaseError if there are too many.
    """
    spacing = case.plan.particle_spacing
    domain = case.scene.domain
    in_plane = domain.n_dim == 2
    number = domain.n_particles(spacing)
    if (number if in_plane else len(VIEWS) * number ** (2.0 / 3.0)) > MOST_PARTICLES:
        raise CaseError(
            f"{number} particles are too many to draw, more than {MOST_PARTICLES}: try "
            f"--set discretization.resolution={case.discretization.resolution // 4}"
        )
    walls = particles.walls(case, case.plan.flow(case.plan.points[0]))
    reach = spacing * case.plan.n_wall_layers if walls is not None and in_plane else 0.0
    beyond = np.where(domain.periodic, 0.0, reach)
    slices = Slices((domain.lower - beyond).tolist(), (domain.upper + beyond).tolist())
    left, right, low, high = frame = slices.extent
    size = np.array((right - left, high - low))
    width, height = size * min((WIDTH, HEIGHT) / size)
    arrow = LONGEST_ARROW * float(np.hypot(*size))
    with panels.styled():
        figure = panels.new_figure(max(5.0, width + 0.9), height + 1.8)
        axes = figure.subplots()
        dot = max(0.4, 36.0 * width * spacing / size[0]) ** 2
        if in_plane:
            _draw_points(axes, case.scene.fill(spacing), dot, FLUID, "fluid particles")
            if walls is not None:
                ghosts = walls.position
                inside = np.all((ghosts >= slices.lower) & (ghosts <= slices.upper), axis=1)
                _draw_points(axes, ghosts[inside], dot, GHOST, "ghosts")
                _draw_walls(axes, case, walls, solids_within(domain, frame), arrow)
            _draw_in_fluid(axes, case, 0.6 * arrow)
            _draw_compared(axes, case)
            _draw_measured(axes, case, 0.6 * arrow)
        else:
            _draw_slices(axes, case, slices, dot, arrow)
            axes.set_xticks(*slices.ticks(0))
            axes.set_yticks(*slices.ticks(1))
        x_label, y_label = Frame(frame, slices=None if in_plane else slices).labels
        axes.set(xlim=frame[:2], ylim=frame[2:], xlabel=x_label, ylabel=y_label, aspect="equal")
        packed = ", before packing" if case.plan.packed else ""
        axes.set_title(f"{case.name}: spacing {spacing:.4g} m{packed}")
        handles, labels = axes.get_legend_handles_labels()
        shown = dict(zip(labels, handles, strict=True))
        figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=3)
    return figure


def solids_within(domain: Domain, frame: Extent) -> Solids:
    """Return signed distances from walls on a grid over a frame (left, right, lower, upper) [m]."""
    left, right, lower, upper = frame
    width = max(right - left, upper - lower) / PIXELS
    nx, ny = (max(2, round(length / width)) for length in (right - left, upper - lower))
    x = np.linspace(left, right, nx)
    y = np.linspace(lower, upper, ny)
    return x, y, domain.distance_and_normal(lattice_points(x, y))[0].reshape(ny, nx)


def _draw_points(axes: Axes, position: Array, size: float, colour: str, label: str) -> None:
    """Draw points (n_points, 2) as dots of a size [points squared]."""
    x, y = position.T
    many = len(position) > VECTORS_BELOW
    label = f"{label}, {len(position)}"
    axes.scatter(x, y, s=size, color=colour, linewidths=0.0, label=label, rasterized=many)


def _draw_walls(axes: Axes, case: Case, walls: Walls, solids: Solids, arrow: float) -> None:
    """Draw walls with their names; the fastest velocity is as long as an arrow [m]."""
    domain = case.scene.domain
    spacing = case.plan.particle_spacing
    panels.cover(axes, solids)
    axes.contour(*solids, levels=(0.0,), colors=[panels.INK], linewidths=1.6)
    surface = -domain.distance_and_normal(walls.position)[0] < spacing
    speed = np.hypot(*walls.velocity.T)
    fastest = float(speed[surface].max(initial=0.0))
    for index, name in enumerate(domain.wall_names):
        mine = np.flatnonzero(walls.wall == index)
        if not len(mine):
            continue
        # The name is in the middle of the wall's ghosts, or at the ghost nearest to it.
        ghosts = walls.position[mine]
        middle = ghosts.mean(axis=0)
        if domain.contains(middle[None])[0] or domain.nearest_wall(middle[None])[0] != index:
            middle = ghosts[np.argmin(np.sum((ghosts - middle) ** 2, axis=1))]
        beside_fluid = mine[surface[mine]]
        largest = float(speed[beside_fluid].max(initial=0.0))
        text = _wall_text(case, name, largest)
        colour = MOVING if largest else panels.INK
        turned = 90.0 if name in SIDES[0] else 0.0
        axes.text(middle[0], middle[1], text, color=colour, rotation=turned, **CENTRED)
        if largest:
            shown = beside_fluid[:: -(-len(beside_fluid) // MOST_ARROWS)]
            place = domain.on_wall(walls.position[shown])
            arrows = arrow / fastest * walls.velocity[shown]
            label = f"velocity of walls, at most {fastest:.3g} m/s"
            _draw_arrows(axes, place, arrows, MOVING, label)


def _wall_text(case: Case, name: str, speed: float) -> str:
    """Return the name of a wall, its speed [m/s] if it moves, and the forces measured on it."""
    measured = case.scene.measure.items()
    forces = [n for n, m in measured if isinstance(m, ForceMeasure) and m.force_on == name]
    words = [name, f"{speed:.3g} m/s" * bool(speed), f"force: {', '.join(forces)}" * bool(forces)]
    return ", ".join(filter(None, words))


def _draw_arrows(axes: Axes, place: Array, way: Array, colour: str, label: str = "") -> None:
    """Draw arrows from places (n, 2) along ways (n, 2) [m]."""
    in_metres: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver(*place.T, *way.T, **in_metres, width=0.0035, color=colour, zorder=5)
    if label:
        axes.plot([], [], color=colour, label=label)


def _draw_in_fluid(axes: Axes, case: Case, arrow: float) -> None:
    """Draw porous bodies, the strip of an inflow with an arrow [m] along it, and a level."""
    from shapely.plotting import plot_polygon  # late, because it loads matplotlib

    domain = case.scene.domain
    strip = case.plan.strip
    level = case.scene.level_at()
    look: Any = {"add_points": False, "alpha": 0.35, "linewidth": 0.0, "zorder": 3}
    for name, section in getattr(case.scene, "porous", {}).items():
        shape = section.geometry()
        plot_polygon(shape, axes, color=panels.COLOURS[4], label="porous bodies", **look)
        point = shape.representative_point()
        axes.text(point.x, point.y, name, **CENTRED)
    if strip is not None:
        low = np.array(domain.lower)
        high = np.array(domain.upper)
        low[strip.axis] = strip.start
        high[strip.axis] = strip.end
        box = shapely.box(*low, *high)
        plot_polygon(box, axes, color=panels.COLOURS[2], label="strip of the inflow", **look)
        centre = box.intersection(domain.fluid).representative_point()
        middle = shapely.get_coordinates(centre)[0]
        along = np.where(np.arange(2) == strip.axis, np.copysign(arrow, strip.speed), 0.0)
        _draw_arrows(axes, (middle - 0.5 * along)[None], along[None], panels.COLOURS[2])
        offset: Any = {"xytext": (0.0, 12.0), "textcoords": "offset points", **CENTRED}
        axes.annotate(f"inflow, at most {abs(strip.speed):.3g} m/s", middle, **offset)
    if np.isfinite(level):
        ends, label = (domain.lower[0], domain.upper[0]), f"level, y = {level:.4g} m"
        axes.plot(ends, (level, level), color=panels.INK, ls="--", lw=1.2, label=label)


def _draw_compared(axes: Axes, case: Case) -> None:
    """Draw the line of comparisons, stations, and periodic edges."""
    domain = case.scene.domain
    x = case.plan.probe_line
    for interval in domain.sections(x):
        axes.plot(
            [x, x], interval, color=panels.COLOURS[0], ls="--", label="compared line", zorder=4
        )
    for station in case.scene.stations(x):
        axes.plot(*station, "D", ms=6.0, color=MEASURED, label="stations", zorder=5)
    periodic = [axis for axis in range(2) if domain.periodic[axis]]
    label = f"repeats along {' and '.join('xy'[axis] for axis in periodic)}"
    for axis in periodic:
        draw_edge = (axes.axvline, axes.axhline)[axis]
        for end in (domain.lower[axis], domain.upper[axis]):
            draw_edge(end, color=panels.COLOURS[2], ls=":", lw=2.5, label=label, zorder=4)


def _draw_measured(axes: Axes, case: Case, arrow: float) -> None:
    """Draw probes, lines, sections and gauges; an arrow [m] shows the direction of flow."""
    for name, measure in case.scene.measured_fields.items():
        ends = np.array(measure.ends)
        middle = ends.mean(axis=0)
        dx, dy = ends[1] - ends[0]
        look: dict[str, Any] = {"ls": "-" if measure.is_flow else "-.", "lw": 1.8}
        if not np.hypot(dx, dy):
            look = {"marker": "o", "ls": "none", "ms": 6.0}
        if measure.is_flow:
            flow = arrow * np.array([[dy, -dx]]) / np.hypot(dx, dy)
            _draw_arrows(axes, middle[None], flow, MEASURED)
        axes.plot(*ends.T, **look, label=measure.title, color=MEASURED, zorder=5)
        offset: Any = {"xytext": (5.0, 5.0), "textcoords": "offset points", **NAME}
        axes.annotate(name, 0.75 * ends[0] + 0.25 * ends[1], color=MEASURED, **offset)
    low, high = case.scene.domain.lower[1], case.scene.domain.upper[1]
    for name, gauge in case.scene.measured_surface.items():
        if isinstance(gauge, ElevationMeasure):
            x = gauge.elevation
            look = {"ls": "--", "lw": 1.8, "color": MEASURED, "zorder": 5}
            axes.plot((x, x), (low, high), **look, label="elevation of the surface")
            offset = {"xytext": (5.0, -12.0), "textcoords": "offset points", **NAME}
            axes.annotate(name, (x, high), color=MEASURED, **offset)


def _draw_slices(axes: Axes, case: Case, slices: Slices, size: float, arrow: float) -> None:
    """Draw the slices of a box in space: particles, sides, and places of measurements.

    Particles are dots of a size [points squared]; the fastest wall has an arrow of a length [m].
    """
    spacing = case.plan.particle_spacing
    ends = np.array((case.scene.domain.lower, case.scene.domain.upper))
    middle = ends.mean(axis=0)
    fluid = case.scene.fill(spacing)
    in_slices = []
    for view, along in enumerate(VIEWS):
        # The middle may be between two layers of particles, of which one is shown.
        layer = np.round((fluid - middle)[:, 3 - sum(along)] / spacing - 0.25)
        in_slices.append(slices.shown(view, fluid[layer == 0.0]))
    _draw_points(axes, np.concatenate(in_slices), size, FLUID, "fluid particles in the slices")
    _draw_sides(axes, case, slices, arrow)
    line = np.tile(middle, (2, 1))
    line[:, 0] = case.plan.probe_line
    line[:, 1] = ends[:, 1]
    axes.plot(
        *slices.shown(0, line).T, color=panels.COLOURS[0], ls="--", label="compared line", zorder=4
    )
    for name, measure in case.scene.measured_fields.items():
        outline = corners = np.array(measure.ends)
        if measure.is_flow:  # opposite corners of a rectangle
            second = np.flatnonzero(corners[0] != corners[1])[1]
            outline = corners[[0, 1, 1, 0, 0]]
            outline[:, second] = corners[[0, 0, 1, 1, 0], second]
        look: dict[str, Any] = {"ls": "-" if measure.is_flow else "-.", "lw": 1.8}
        if not np.ptp(outline, axis=0).any():
            look = {"marker": "o", "ls": "none", "ms": 6.0}
        for view in range(len(VIEWS)):
            place = slices.shown(view, outline)
            axes.plot(*place.T, **look, label=measure.title, color=MEASURED, zorder=5)
            offset: Any = {"xytext": (5.0, 5.0), "textcoords": "offset points", **NAME}
            axes.annotate(name, 0.75 * place[0] + 0.25 * place[1], color=MEASURED, **offset)


def _draw_sides(axes: Axes, case: Case, slices: Slices, arrow: float) -> None:
    """Draw the sides of a box in space around its slices: walls by name, and periodic ones."""
    domain = case.scene.domain
    flow = case.plan.flow(case.plan.points[0])
    ends = np.array((domain.lower, domain.upper))
    repeats = [axis for axis in range(3) if domain.periodic[axis]]
    label = f"repeats along {' and '.join('xyz'[axis] for axis in repeats)}"
    moving: list[tuple[int, Array, Array]] = []
    for view, along in enumerate(VIEWS):
        for axis, other, end in ((*pair, end) for pair in (along, along[::-1]) for end in (0, 1)):
            # An odd number of places, one of them in the middle, where lids are fastest.
            side = np.tile(ends.mean(axis=0), (MOST_ARROWS + 1, 1))
            side[:, other] = midpoints(ends[0, other], ends[1, other], len(side))
            side[:, axis] = ends[end, axis]
            edge = side[[0, -1]]
            edge[:, other] = ends[:, other]
            place = slices.shown(view, edge)
            if domain.periodic[axis]:
                axes.plot(*place.T, color=panels.COLOURS[2], ls=":", lw=2.5, label=label, zorder=4)
                continue
            beyond = side.copy()
            beyond[:, axis] += (2 * end - 1) * BEYOND * case.plan.particle_spacing
            velocity = flow.wall_velocity(beyond)
            moving.append((view, side, velocity))
            largest = float(np.linalg.norm(velocity, axis=1).max())
            name = SIDES[axis][end]
            text = _wall_text(case, name, largest)
            colour = MOVING if largest else panels.INK
            axes.plot(*place.T, color=panels.INK, lw=1.6)
            turned = 90.0 if axis == along[0] else 0.0
            x, y = place.mean(axis=0).tolist()
            axes.text(x, y, text, color=colour, rotation=turned, **CENTRED)
    speeds = [float(np.linalg.norm(velocity, axis=1).max()) for _, _, velocity in moving]
    fastest = max(speeds, default=0.0)
    for (view, side, velocity), speed in zip(moving, speeds, strict=True):
        if speed:
            # Centred, and no longer than the places are apart, no arrow leaves its slice.
            apart = float(np.linalg.norm(side[1] - side[0]))
            way = min(arrow, apart) / fastest * velocity[:, VIEWS[view]]
            label = f"velocity of walls, at most {fastest:.3g} m/s"
            _draw_arrows(axes, slices.shown(view, side) - 0.5 * way, way, MOVING, label)
