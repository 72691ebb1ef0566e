"""Trajectories, full and reduced: writing snapshots one by one, and the watch over a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.errors import ArtifactError, UnstableError
from sphrom.integrate.runge_kutta import runge_kutta_step
from sphrom.sph import state_equation

Array = NDArray[np.float64]

DENSITY_LIMIT = 0.1
"""Largest |rho - rho_0| / rho_0: ten times what a weakly compressible flow may show."""


class TrajectoryWriter:
    """The datasets of a trajectory, written one snapshot after the other."""

    def __init__(
        self,
        artifact: ArtifactWriter,
        n_snapshots: int,
        n_particles: int,
        sound_speed: float,
        n_modes: int | None = None,
    ) -> None:
        self._artifact = artifact
        self._sound_speed = sound_speed
        self._times = artifact.stream("time", (), n_snapshots)
        self._steps = artifact.stream("step", (), n_snapshots)
        self._positions = artifact.stream("position", (n_particles, 2), n_snapshots)
        self._velocities = artifact.stream("velocity", (n_particles, 2), n_snapshots)
        self._fluctuations = artifact.stream("density_fluctuation", (n_particles,), n_snapshots)
        self._pressures = artifact.stream("pressure", (n_particles,), n_snapshots)
        self._coordinates = (
            None
            if n_modes is None
            else artifact.stream("generalized_coordinates", (n_modes,), n_snapshots)
        )

    def append(
        self,
        time: float,
        step: int,
        position: Array,
        density_fluctuation: Array,
        velocity: Array,
        coordinates: Array | None = None,
    ) -> None:
        """Write one snapshot; positions and velocities are (2, n_particles)."""
        self._times.append(np.float64(time))
        self._steps.append(np.int64(step))
        self._positions.append(position.T)
        self._velocities.append(velocity.T)
        self._fluctuations.append(density_fluctuation)
        self._pressures.append(state_equation.pressure(density_fluctuation, self._sound_speed))
        if self._coordinates is not None and coordinates is not None:
            self._coordinates.append(coordinates)

    def finish(self, failure: UnstableError | None, seconds: float) -> None:
        """Say how the run ended, and how long its time steps took."""
        self._artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            self._artifact.annotate("status_detail", str(failure))
        self._artifact.annotate("timing/integration", seconds)


def check_state(state: Array, reference_density: float, step: int, time: float) -> None:
    """Raise UnstableError when a full state (5, n_particles) is no longer one of the model's."""
    excess = np.abs(state[2]) / reference_density
    # A comparison with NaN is false: every bad particle fails it.
    bad = np.flatnonzero(~((excess <= DENSITY_LIMIT) & np.isfinite(state).all(axis=0)))
    if bad.size:
        i = int(bad[0])
        raise UnstableError(
            f"unstable at step {step}, t = {time:.6g} s: particle {i} at "
            f"({state[0, i]:.6g}, {state[1, i]:.6g}) m has (rho - rho0)/rho0 = "
            f"{state[2, i] / reference_density:.3g} and velocity ({state[3, i]:.3g}, "
            f"{state[4, i]:.3g}) m/s; {bad.size} such particles; a smaller time step may help"
        )


def watched_step(
    functional: Callable[[Array], Array], state: Array, time_step: float, step: int
) -> Array:
    """Take step number `step`, and raise UnstableError when it can't be taken.

    A state that has left the model's range can make its equations unsolvable: a basis at
    particles that are no longer spread out, or positions that are no longer finite.
    """
    try:
        return runge_kutta_step(functional, state, time_step)
    except (np.linalg.LinAlgError, ValueError, UnstableError) as error:
        raise UnstableError(
            f"unstable within step {step}, before t = {step * time_step:.6g} s: {error}; "
            "a smaller time step may help"
        ) from error


def require_complete(trajectory: Artifact) -> None:
    """Raise ArtifactError for a trajectory that ended unstable."""
    if trajectory.text("status") != "complete":
        raise ArtifactError(
            f"{trajectory.path} is of a run that became unstable ("
            f"{trajectory.text('status_detail')}): change the case and run it again"
        )
