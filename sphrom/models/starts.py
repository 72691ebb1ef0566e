"""The starts of runs: packed particles, the scene's fields, or the end of a spin-up."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.artifacts.records.runs import Start
from sphrom.case.points import ParameterPoint
from sphrom.sph.fluid import NONE, Factors, fluctuation_of
from sphrom.store.workspace import Workspace

S = TypeVar("S")
"""The start of a run, in the form that a model needs."""


def initial_positions(workspace: Workspace, values: Factors = NONE) -> Array:
    """Return the start positions (n_particles, n_dim) [m] for values of the scene's parameters.

    Raises ArtifactError if they have to be packed first.
    """
    case = workspace.case
    if not case.plan.packed:
        return case.scene.fill(case.plan.particle_spacing, values)
    with workspace.open(workspace.packing()) as artifact:
        return np.asarray(artifact.read("position"))


def start(workspace: Workspace, point: ParameterPoint) -> Start:
    """Return the start of the recorded part of a run: the scene's state or the end of the spin-up.

    Raises ArtifactError if the spin-up, or the packed particles, have to be made first.
    """
    if workspace.case.time.spin_up == 0.0:
        return scene_start(workspace, point)
    with workspace.open(workspace.spin_up(point)) as artifact:
        return read_record(artifact, Start)


def scene_start(workspace: Workspace, point: ParameterPoint) -> Start:
    """Return the scene's initial state, from which a spin-up or a run without one starts."""
    position = initial_positions(workspace, point.factors)
    plan = workspace.case.plan
    flow = workspace.case.plan.flow(point)
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    velocity = flow.initial_velocity(position)
    return Start(position=position, density_fluctuation=density, velocity=velocity)


class RunStarts(Generic[S]):
    """Starts of runs in the form that a model needs, cached while they stay the same.

    No start depends on the viscosity. Without a spin-up, points have the same start if they agree
    in the parameters on which the scene's initial state depends.
    """

    def __init__(
        self,
        workspace: Workspace,
        make: Callable[[ParameterPoint], S],
        parameters: Array | None = None,
        known: Iterable[S] = (),
    ) -> None:
        """Use the `known` starts at parameters (n_starts, n_parameters), and make others."""
        plan = workspace.case.plan
        self._plan = plan
        self._spun_up = workspace.case.time.spin_up > 0.0
        self._names = list(filter(workspace.case.scene.starts_by, plan.parameter_names[1:]))
        self._make = make
        self._latest: tuple[object, S] | None = None
        rows = [] if parameters is None else parameters.tolist()
        points = (plan.point(dict(zip(plan.parameter_names, row, strict=True))) for row in rows)
        self._known = dict(zip(map(self._key, points), known, strict=True))

    def at(self, point: ParameterPoint) -> S:
        """Return the start of a run at a parameter point."""
        begin = self._plan.start_point(point)
        key = self._key(begin)
        if self._latest is None or self._latest[0] != key:
            self._latest = key, self._known[key] if key in self._known else self._make(begin)
        return self._latest[1]

    def _key(self, begin: ParameterPoint) -> object:
        """Return the values that a start depends on: all, or those of the scene's initial state."""
        return begin if self._spun_up else tuple(begin.factors[name] for name in self._names)
