"""Starts of runs (packed particles, the scene's fields, or the end of a spin-up), and their maps.

The map imports the kernels of SPH, which runs from stored starts do not need.
"""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.reduced_models import Starts
from sphrom.artifacts.records.runs import Start
from sphrom.case.points import ParameterPoint
from sphrom.sph.fluid import NONE, Factors, fluctuation_of
from sphrom.store.trained_models import read_points
from sphrom.store.workspace import Workspace

Fields = tuple[Array, Array]
"""Density fluctuation (n_points,) [kg/m3] and velocity (n_points, 2) [m/s]."""


def initial_positions(workspace: Workspace, values: Factors = NONE) -> Array:
    """Return the start positions (n_particles, 2) [m] for values of the scene's parameters.

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
    plan, flow = workspace.case.plan, workspace.case.plan.flow(point)
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    velocity = flow.initial_velocity(position)
    return Start(position=position, density_fluctuation=density, velocity=velocity)


def starts_record(workspace: Workspace) -> Starts:
    """Map the starts of the training runs; without a spin-up they are alike, and one is mapped."""
    case, mapped = workspace.case, MappedStarts(workspace)
    points = case.plan.train_points if case.time.spin_up > 0.0 else case.plan.train_points[:1]
    fields = [mapped.at(point) for point in points]
    return Starts(
        parameters=np.array([list(point.as_dict().values()) for point in points]),
        density_fluctuation=np.stack([density for density, _ in fields]),
        velocity=np.stack([velocity for _, velocity in fields]),
    )


class MappedStarts:
    """Starts of runs, mapped onto the reference points, and cached while they stay the same.

    No start depends on the viscosity. Without a spin-up, points have the same start if they agree
    in the parameters on which the scene's initial state depends.
    """

    def __init__(self, workspace: Workspace, operators: Artifact | None = None) -> None:
        """Use the starts stored in an artifact of operators, if one is given and has any."""
        self._workspace = workspace
        self._points = read_points(workspace)
        self._stored = None
        if operators is not None and "starts/parameters" in operators:
            self._stored = read_record(operators, Starts, "starts")
        self._latest: tuple[object, Fields] | None = None
        others = workspace.case.plan.parameter_names[1:]
        self._names = list(filter(workspace.case.scene.starts_by, others))

    def at(self, point: ParameterPoint) -> Fields:
        """Return the fields at the start of a run at a parameter point."""
        begin = self._workspace.case.plan.start_point(point)
        if self._latest is None or self._latest[0] != self._key(begin):
            self._latest = self._key(begin), self._fields_at(begin)
        return self._latest[1]

    def _key(self, begin: ParameterPoint) -> object:
        """Return the values that a start depends on: all, or those of the scene's initial state."""
        if self._workspace.case.time.spin_up > 0.0:
            return begin
        return tuple(begin.factors[name] for name in self._names)

    def _fields_at(self, begin: ParameterPoint) -> Fields:
        plan, stored = self._workspace.case.plan, self._stored
        if stored is not None:
            for k, values in enumerate(stored.parameters.tolist()):
                trained = plan.point(dict(zip(plan.parameter_names, values, strict=True)))
                if self._key(trained) == self._key(begin):
                    return stored.density_fluctuation[k], stored.velocity[k]
        from sphrom.setup.particles import map_onto

        to_points = map_onto(self._workspace.case, self._points)
        return to_points(**vars(start(self._workspace, begin)))
