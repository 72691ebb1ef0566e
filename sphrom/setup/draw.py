"""A picture of a case before it runs (`sphrom case draw`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.plots.canvas import FORMATS, save
from sphrom.plots.pictures import Extent, Solids
from sphrom.plots.preview import NamedWall, Preview, draw_preview
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.sph.box_domain import SIDES
from sphrom.sph.domain import Domain
from sphrom.sph.walls import Walls

Array = NDArray[np.float64]

PIXELS = 500
"""Along the longer side of the picture, at which distances from walls are looked up."""
MOST_PARTICLES = 200_000
"""More would be no picture that shows particles."""
AT_LABEL = 0.5
"""A name stands where the solid is at least so deep, over the depth of ghosts."""


def run(context: StageContext, output: Path | None = None) -> None:
    """Draw a case's geometry into a file, by default `<name of the case>.png`.

    Raises CaseError when the file's name ends in no known format, or the file is there already and
    may not be written over; ArtifactError when it can't be written.
    """
    case = context.case
    path = output or Path(f"{case.name}.png")
    if path.suffix.lower() not in FORMATS:
        raise CaseError(f"--output: must end in {' or '.join(FORMATS)}; got {path}")
    if path.is_dir() or (path.exists() and not context.force):
        what = "is a folder" if path.is_dir() else "is there already; --force writes over it"
        raise CaseError(f"{path}: {what}")
    save(draw_preview(preview(case)), path)
    context.report.info(f"wrote {path}")


def preview(case: Case) -> Preview:
    """Return what there is to see of a case before it runs.

    Particles are where they start, or where packing starts from.
    """
    spacing, domain = case.particle_spacing, assembly.domain(case)
    if (number := domain.n_particles(spacing)) > MOST_PARTICLES:
        raise CaseError(
            f"{number} particles are too many to draw, more than {MOST_PARTICLES}: try "
            f"--set discretization.resolution={case.discretization.resolution // 4}"
        )
    flow = assembly.scene(case, case.points[0])
    walls = particles.walls(case, flow)
    reach = spacing * case.n_wall_layers if walls is not None else 0.0
    beyond = [0.0 if periodic else reach for periodic in domain.periodic]
    (left, lower), (right, upper) = (
        np.subtract(domain.lower, beyond), np.add(domain.upper, beyond)
    )  # fmt: skip
    solids = solids_within(domain, (left, right, lower, upper))
    packed = ", before packing" if case.packed else ""
    ghosts = np.empty((0, 2)) if walls is None else walls.position
    inside = np.all((ghosts >= (left, lower)) & (ghosts <= (right, upper)), axis=1)
    measured = case.scene.measured_fields
    return Preview(
        frame=(left, right, lower, upper),
        spacing=spacing,
        position=domain.fill(spacing),
        ghost_position=ghosts[inside],
        solids=solids,
        walls=() if walls is None else _named_walls(case, walls, solids),
        periodic=[name for name, p in zip("xy", domain.periodic, strict=True) if p],
        line=(case.probe_line, domain.sections(case.probe_line)),
        stations=case.scene.stations(case.probe_line),
        title=f"{case.name}: spacing {spacing:.4g} m{packed}",
        measured={name: np.array(m.segment or (m.probe,)) for name, m in measured.items()},
        sections=[name for name, m in measured.items() if m.flow_rate is not None],
    )


def solids_within(domain: Domain, frame: Extent) -> Solids:
    """Return where in a frame (left, right, lower, upper edge, [m]) there is no fluid."""
    left, right, lower, upper = frame
    width = max(right - left, upper - lower) / PIXELS
    nx, ny = (max(2, round(length / width)) for length in (right - left, upper - lower))
    x, y = np.linspace(left, right, nx), np.linspace(lower, upper, ny)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return Solids(x, y, domain.distance_and_normal(points)[0].reshape(ny, nx))


def _named_walls(case: Case, walls: Walls, solids: Solids) -> list[NamedWall]:
    """Return the walls by name, each named within the solid, near its middle."""
    points = np.stack(np.meshgrid(solids.x, solids.y), axis=-1).reshape(-1, 2)
    distance = solids.wall_distance.ravel()
    domain, spacing = assembly.domain(case), case.particle_spacing
    enough = AT_LABEL * case.n_wall_layers * spacing
    solid = points[distance < 0.0]
    depth, wall_of = -distance[distance < 0.0], domain.nearest_wall(solid)
    surface = np.flatnonzero(-domain.distance_and_normal(walls.position)[0] < spacing)
    named = []
    for index, name in enumerate(domain.wall_names):
        mine = wall_of == index
        if not mine.any():
            continue
        deep = solid[mine][depth[mine] >= min(enough, depth[mine].max())]
        middle = np.sum((deep - solid[mine].mean(axis=0)) ** 2, axis=1)
        first = surface[walls.wall[surface] == index]
        named.append(
            NamedWall(
                name=name,
                label_at=deep[np.argmin(middle)],
                upright=name in SIDES[0],
                place=domain.on_wall(walls.position[first]),
                velocity=walls.velocity[first],
            )
        )
    return named
