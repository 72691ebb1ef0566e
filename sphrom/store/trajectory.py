"""Trajectories in their artifacts: snapshots of particles, and measurements over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.errors import ArtifactError, UnstableError
from sphrom.metrics.measures import FieldMeasure, Quantities, of_loads, with_coefficients
from sphrom.metrics.quantities import MEASURABLE
from sphrom.sph.fluid import pressure_of

if TYPE_CHECKING:  # it imports kernels, which take long and which reduced runs do not need
    from sphrom.setup.particles import MeasuredParticles
    from sphrom.sph.domain import Walls
    from sphrom.sph.functional import WallForces
    from sphrom.sph.space_functional import SpaceWallForces
    from sphrom.sph.time_loop import Item, Snapshot
    from sphrom.sph.watch import Watch


PARTS = ("pressure", "viscous")
"""The parts of a force."""


def force_datasets(name: str, loads: Array, n_dim: int = 2) -> dict[str, Array]:
    """Return the loads (..., 2, 3) of a measurement, as in `of_loads`, by dataset."""
    parts = [of_loads(loads[..., i, :], n_dim) for i in range(len(PARTS))]
    forces = {f"force/{name}/{p}": each["force"] for p, each in zip(PARTS, parts, strict=True)}
    if n_dim == 2:
        forces |= {
            f"force/{name}/{p}_torque": each["torque"] for p, each in zip(PARTS, parts, strict=True)
        }
    return forces


def read_forces(artifact: Artifact, name: str) -> Array:
    """Return the pressure and the viscous loads (n_snapshots, 2, 3), as in `of_loads`."""
    read = [[f"force/{name}/{p}", f"force/{name}/{p}_torque"] for p in PARTS]
    parts = [np.column_stack([artifact.read(p) for p in paths if p in artifact]) for paths in read]
    return np.stack(parts, axis=1)


def field_datasets(measured: Mapping[str, Quantities]) -> dict[str, Array]:
    """Return measured fields by dataset."""
    return {
        f"measure/{name}/{quantity}": values
        for name, quantities in measured.items()
        for quantity, values in quantities.items()
    }


def write_positions(artifact: ArtifactWriter, measures: Mapping[str, FieldMeasure]) -> None:
    """Write the places of measured fields [m]."""
    for name, measure in measures.items():
        if not measure.is_integral:
            artifact.write(f"measure/{name}/position", measure.position)


def read_quantities(artifact: Artifact, name: str) -> Quantities:
    """Return the recorded values of a measurement, by quantity (n_snapshots, ...)."""
    if f"force/{name}/pressure" in artifact:
        in_plane = f"force/{name}/pressure_torque" in artifact
        return totals(read_forces(artifact, name), 2 if in_plane else 3)
    paths = {quantity: f"measure/{name}/{quantity}" for quantity in MEASURABLE}
    return {quantity: artifact.read(p) for quantity, p in paths.items() if p in artifact}


def totals(loads: Array, n_dim: int) -> Quantities:
    """Return total force and torque, by quantity, from the parts of loads (..., 2, 3)."""
    return of_loads(loads.sum(axis=-2), n_dim)


def measured_of(case: Case, artifact: Artifact) -> dict[str, Quantities]:
    """Return all measurements of a run by name."""
    measured = {name: read_quantities(artifact, name) for name in case.scene.recorded}
    return with_coefficients(measured, case.plan.coefficients)


class TrajectoryWriter:
    """The datasets of a trajectory, written snapshot by snapshot."""

    def __init__(
        self,
        artifact: ArtifactWriter,
        n_snapshots: int,
        n_particles: int,
        sound_speed: float,
        n_modes: int | None = None,
        *,
        n_dim: int = 2,
        separate_mean: bool = False,
        walls: Walls | None = None,
        forces: WallForces | SpaceWallForces | None = None,
        fields: MeasuredParticles | None = None,
        watch: Watch | None = None,
    ) -> None:
        self._artifact = artifact
        self._watch = watch
        self._forces = forces
        self._fields = fields
        self._sound_speed = sound_speed
        shapes: dict[str, tuple[int, ...]] = {
            "time": (),
            "step": (),
            "position": (n_particles, n_dim),
            "velocity": (n_particles, n_dim),
            "density_fluctuation": (n_particles,),
            "pressure": (n_particles,),
        }
        if n_modes is not None:
            shapes["generalized_coordinates"] = (n_modes,)
        if separate_mean:
            shapes["mean_density_fluctuation"] = ()
        at_rest: dict[str, Array] = {}
        for wall in () if forces is None else forces.walls:
            at_rest |= force_datasets(wall, np.zeros((2, 3)), n_dim)
        if fields is not None:
            write_positions(artifact, fields.measures)
            at_rest |= field_datasets(fields.at_rest)
        shapes |= {name: np.shape(values) for name, values in at_rest.items()}
        self._streams = {
            name: artifact.stream(name, shape, n_snapshots) for name, shape in shapes.items()
        }
        if walls is not None:
            artifact.write("ghost/position", walls.position)
            artifact.write("ghost/wall_velocity", walls.velocity)

    def append(self, time: float, step: int, snapshot: Snapshot) -> Item:
        """Write one snapshot, and return the written values.

        Raises UnstableError if there are too few particles near a measured place.
        """
        values = {
            "time": np.asarray(time),
            "step": np.asarray(step, dtype=np.int64),
            "position": snapshot.position.T,
            "velocity": snapshot.velocity.T,
            "density_fluctuation": snapshot.density_fluctuation,
            "pressure": pressure_of(snapshot.density_fluctuation, self._sound_speed),
            "generalized_coordinates": np.asarray(snapshot.coordinates),
            "mean_density_fluctuation": np.asarray(snapshot.mean_density_fluctuation),
        }
        if self._forces is not None:
            state = np.vstack((snapshot.position, snapshot.density_fluctuation, snapshot.velocity))
            for name, loads in self._forces(state, time).items():
                values |= force_datasets(name, loads, len(snapshot.position))
        if self._fields is not None:
            try:
                values |= field_datasets(
                    self._fields(
                        snapshot.position.T, snapshot.density_fluctuation, snapshot.velocity.T
                    )
                )
            except UnstableError as error:
                raise UnstableError(f"{error}, at t = {time:.6g} s") from error
        item = {name: values[name] for name in self._streams}
        self.write(item)
        return item

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the datasets with one entry per snapshot."""
        return tuple(self._streams)

    def write(self, item: Item) -> None:
        """Write one snapshot that `append` returned before."""
        for name, stream in self._streams.items():
            stream.append(item[name])
        if self._watch is not None:
            self._watch.see(
                float(item["time"]), item["position"], item["velocity"], item["density_fluctuation"]
            )

    def finish(
        self, failure: UnstableError | None, seconds: float | None, checkpoint_seconds: float = 0.0
    ) -> None:
        """Record the end of the run, and the time of its steps and its checkpoints [s].

        `seconds` is None if it is unknown.
        """
        self._artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            self._artifact.annotate("status_detail", str(failure))
        if self._watch is not None and (found := list(self._watch.findings())):
            self._artifact.annotate("unphysical", "\n".join(found))
        if seconds is not None:
            self._artifact.annotate("timing/integration", seconds)
        self._artifact.annotate("timing/checkpoints", checkpoint_seconds)


def require_complete(trajectory: Artifact) -> None:
    """Raise ArtifactError for a trajectory that ended unstable."""
    if trajectory.text("status") != "complete":
        raise ArtifactError(
            f"{trajectory.path} is of a run that became unstable ("
            f"{trajectory.text('status_detail')}): change the case and run it again"
        )


def snapshot_fields(trajectory: Artifact, snapshot: int) -> tuple[Array, Array, Array]:
    """Return position (N, n_dim), density fluctuation (N,) and velocity of one snapshot."""
    names = ("position", "density_fluctuation", "velocity")
    position, density, velocity = (np.asarray(trajectory.dataset(n)[snapshot]) for n in names)
    return position, density, velocity
