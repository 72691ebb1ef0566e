"""The starts of runs: packed particles, the scene's fields, or the end of a spin-up."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.artifacts.records.runs import Start
from sphrom.case.points import ParameterPoint
from sphrom.sph.fluid import NONE, Factors, fluctuation_of
from sphrom.store.workspace import Workspace


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
    plan = workspace.case.plan
    flow = workspace.case.plan.flow(point)
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    velocity = flow.initial_velocity(position)
    return Start(position=position, density_fluctuation=density, velocity=velocity)
