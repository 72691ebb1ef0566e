"""Starts of runs on the reference points: mapped when operators are projected, or when asked for.

The map loads the kernels of SPH, which runs from stored starts don't need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.operators import Starts
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.setup import assembly
from sphrom.store.basis import read_points
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.store.start import Start

Array = NDArray[np.float64]
Fields = tuple[Array, Array]
"""Density fluctuation (n_points,) [kg/m3] and velocity (n_points, 2) [m/s]."""


def starts_record(workspace: Workspace) -> Starts:
    """Map the starts of the training runs; where the scene is the start of all, that of one."""
    case, mapped = workspace.case, MappedStarts(workspace)
    points = case.plan.train_points if case.time.spin_up > 0.0 else case.plan.train_points[:1]
    fields = [mapped.at(point) for point in points]
    return Starts(
        parameters=np.array([list(point.as_dict().values()) for point in points]),
        density_fluctuation=np.stack([density for density, _ in fields]),
        velocity=np.stack([velocity for _, velocity in fields]),
    )


class MappedStarts:
    """Starts of runs, mapped onto the reference points, and kept while they stay the same.

    No start depends on the viscosity, so that points with the same other parameters start alike;
    with a spin-up each has its own.
    """

    def __init__(self, workspace: Workspace, operators: Artifact | None = None) -> None:
        """Use the starts that an artifact of operators holds, if one is given and has any."""
        self._workspace = workspace
        self._points = read_points(workspace)
        self._stored = None
        if operators is not None and "starts/parameters" in operators:
            self._stored = read_record(operators, Starts, "starts")
        self._read: dict[ParameterPoint, Start] = {}
        self._last: tuple[Start, Fields] | None = None
        self._latest: tuple[ParameterPoint, Fields] | None = None

    def at(self, point: ParameterPoint) -> Fields:
        """Return the fields at the start of a run at a parameter point."""
        begin = self._workspace.case.plan.start_point(point)
        if self._latest is None or not self._alike(self._latest[0], begin):
            self._latest = begin, self._found(begin)
        return self._latest[1]

    def _alike(self, one: ParameterPoint, other: ParameterPoint) -> bool:
        spun_up = self._workspace.case.time.spin_up > 0.0
        return one == other if spun_up else one.others == other.others

    def _found(self, begin: ParameterPoint) -> Fields:
        if self._stored is not None:
            for k, values in enumerate(self._stored.parameters):
                if _starts_alike(self._workspace.case, begin, values, self._points):
                    return self._stored.density_fluctuation[k], self._stored.velocity[k]
        return self._mapped(begin)

    def _mapped(self, point: ParameterPoint) -> Fields:
        from sphrom.setup.particles import map_onto

        begin = self._start(point)
        if self._last is None or not _same(self._last[0], begin):
            to_points = map_onto(self._workspace.case, self._points)
            fields = to_points(begin.position, begin.density_fluctuation, begin.velocity)
            self._last = begin, fields
        return self._last[1]

    def _start(self, point: ParameterPoint) -> Start:
        """Return the start of a run; particles, and the end of a spin-up, are read once."""
        from sphrom.store.start import Start, start

        case = self._workspace.case
        spun_up = case.time.spin_up > 0.0
        if point not in self._read and (spun_up or not self._read):
            self._read[point] = start(self._workspace, point)
        if point in self._read:
            return self._read[point]
        position = next(iter(self._read.values())).position
        return Start(position, *assembly.initial_fields(case, point, position))


def _starts_alike(case: Case, point: ParameterPoint, values: Array, positions: Array) -> bool:
    """Return whether runs at a point start as runs at some values of the parameters do.

    The scene is the start of both, unless there is a spin-up.
    """
    known = case.plan.point(dict(zip(case.plan.parameter_names, values.tolist(), strict=True)))
    if point == known or case.time.spin_up > 0.0:
        return point == known
    one, other = (assembly.initial_fields(case, p, positions) for p in (point, known))
    return all(map(np.array_equal, one, other))


def _same(one: Start, other: Start) -> bool:
    return one is other or all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("position", "density_fluctuation", "velocity")
    )
