"""Tables of velocity and pressure over time at some points, as CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import ArtifactError, CaseError
from sphrom.online.rebuilt_run import FieldsAt, fields_of
from sphrom.plots.tables import write_csv
from sphrom.setup.measured_fields import sampler
from sphrom.store.sampling import probes_of
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace, make_folder

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProbeRow:
    """Velocity and pressure at one point and time."""

    time: float = field(metadata={"unit": "s"})
    x: float = field(metadata={"unit": "m"})
    y: float = field(metadata={"unit": "m"})
    u: float = field(metadata={"unit": "m/s"})
    v: float = field(metadata={"unit": "m/s"})
    pressure: float = field(metadata={"unit": "Pa"})


def write_probe_tables(workspace: Workspace, folder: Path, at: Sequence[str]) -> None:
    """Write a table of every run that is there, at points like `0.5,0.5`, or along the line.

    Raises
    ------
    ArtifactError
        When no run is there, one does not belong to the case, or a table can't be written.
    CaseError
        When a point is not in the fluid.
    """
    points = _points(workspace, at)
    sample = sampler(workspace.case, points)
    there = [found for found in _runs(workspace) if found[0].path.exists()]
    if not there:
        raise ArtifactError(f"{workspace.out}: there is no run; make some with `sphrom run CASE`")
    for target, point, model in there:
        path = folder / f"{target.path.stem}.csv"
        if path.exists() and not workspace.context.force:
            raise ArtifactError(f"{path} exists already; --force replaces it")
        with workspace.open(target) as run:
            fields_at = fields_of(workspace, run, sample, point, model)
            ended_well = run.text("status") == "complete"
            rows = list(_rows(run.read("time"), points, fields_at, ended_well))
        if not rows:
            workspace.context.report.warn(f"{target.path.name}: became unstable at once: no table")
            continue
        make_folder(folder, "--into")
        write_csv(path, rows)
        workspace.context.report.info(f"wrote {path}: {len(points)} points")


def _points(workspace: Workspace, at: Sequence[str]) -> Array:
    """Return the points that are asked for (n_points, 2) [m], checked."""
    if not at:
        return probes_of(workspace.case).line
    domain = workspace.case.scene.domain
    points = []
    for text in at:
        try:
            x, y = (float(number) for number in text.split(","))
        except ValueError as error:
            raise CaseError(f"--at: must be like 0.5,0.5; got {text!r}") from error
        if not domain.contains(np.array([[x, y]]))[0]:
            raise CaseError(f"--at: ({x:g}, {y:g}) m is not in the fluid")
        points.append((x, y))
    return np.array(points)


def _runs(
    workspace: Workspace,
) -> Iterator[tuple[Target, ParameterPoint, ReducedModelSection | None]]:
    """Yield every run of the case, at the parameter points that are asked for."""
    case, chosen = workspace.case, workspace.context.chosen
    for point in chosen(case.plan.points):
        yield workspace.full_run(point), point, None
    for model in case.rom:
        for point in chosen(case.plan.rom_points(model)):
            yield workspace.reduced_run(model, point), point, model


def _rows(times: Array, points: Array, fields_at: FieldsAt, ended_well: bool) -> Iterator[ProbeRow]:
    """Yield all points of a snapshot after the other; a run that went wrong, as far as it went."""
    for snapshot, time in enumerate(times):
        try:
            velocity, pressure = fields_at(snapshot)
        except ValueError as error:
            if ended_well:
                raise CaseError(f"--at: at t = {time:g} s: {error}") from error
            return
        for (x, y), (u, v), p in zip(points, velocity, pressure, strict=True):
            yield ProbeRow(*map(float, (time, x, y, u, v, p)))
