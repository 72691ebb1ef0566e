"""What runs start from: packed particles, the scene's fields, or the end of a spin-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def initial_positions(workspace: Workspace) -> Array:
    """Return where particles start (n_particles, 2) [m].

    Raises
    ------
    ArtifactError
        When they have to be packed first.
    """
    case = workspace.case
    if not case.plan.packed:
        return case.scene.domain.fill(case.plan.particle_spacing)
    with workspace.open(workspace.packing()) as artifact:
        return np.asarray(artifact.read("position"))


@dataclass(frozen=True)
class Start:
    """The state that the recorded part of a run starts from."""

    position: Array
    """(n_particles, 2) [m]."""
    density_fluctuation: Array
    """(n_particles,) [kg/m3]."""
    velocity: Array
    """(n_particles, 2) [m/s]."""

    @property
    def state(self) -> Array:
        """The full state (5, n_particles)."""
        return np.vstack((self.position.T, self.density_fluctuation, self.velocity.T))


def start(workspace: Workspace, point: ParameterPoint) -> Start:
    """Return what the recorded part of a run starts from: the scene's state, or the spin-up's end.

    Raises
    ------
    ArtifactError
        When the spin-up, or the packed particles, have to be made first.
    """
    if workspace.case.time.spin_up == 0.0:
        return scene_start(workspace, point)
    with workspace.open(workspace.spin_up(point)) as artifact:
        return Start(
            artifact.read("position"),
            artifact.read("density_fluctuation"),
            artifact.read("velocity"),
        )


def scene_start(workspace: Workspace, point: ParameterPoint) -> Start:
    """Return the scene's state, from which a spin-up or a run without one starts."""
    position = initial_positions(workspace)
    return Start(position, *assembly.initial_fields(workspace.case, point, position))
