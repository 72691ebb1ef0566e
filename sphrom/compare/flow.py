"""The flow of a stored run, and the bulk velocity of a scene's channel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.metrics.samples import Probes, Samples

Array = NDArray[np.float64]


class StoredRun:
    """The fields of a trajectory."""

    def __init__(self, trajectory: Artifact) -> None:
        self.time = trajectory.read("time")
        self.mass = trajectory.number("mass")
        self._velocities = trajectory.dataset("velocity")
        self._pressures = trajectory.dataset("pressure")

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] of one snapshot."""
        return np.asarray(self._velocities[snapshot]), np.asarray(self._pressures[snapshot])


def bulk_velocity(case: Case, samples: Samples, probes: Probes) -> float | None:
    """Return the mean of u over the scene's channel, and over time [m/s]; None without one."""
    channel = case.scene.channel
    if channel is None or not len(samples.time):
        return None
    inside = channel.contains(probes.grid)
    # Points on the channel's floor are left out of the grid: fluid is at rest there.
    step = case.scene.domain.lengths[1] / probes.grid_shape[0]
    height = channel.height * len(np.unique(probes.grid[inside, 0]))
    flux = samples.velocity[:, probes.on_grid][:, inside, 0].sum(axis=1) * step
    return float(flux.mean()) / height
