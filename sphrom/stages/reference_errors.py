"""Full runs against the profiles of reference solutions, where there are any of their flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.scenes import LidDrivenCavityScene, OpenCavityScene
from sphrom.metrics.probes import spread
from sphrom.scenes.reference_profiles import ReferenceProfile, profiles_for
from sphrom.sph.wall_distance import wall_distance
from sphrom.stages import assembly
from sphrom.stages.sampling import (
    ON_WALL,
    ROUNDING,
    Probes,
    Samples,
    fluid_spans,
    sample_snapshot,
    sampler,
)

Array = NDArray[np.float64]

OPEN_CAVITY_SPEED = 2.0
"""The reference speed that the open cavity's reference is for [m/s]."""
SETTLING_SHARE = 0.1
"""The part of a run, at its end, over which a steady flow should no longer change."""
SETTLED = 0.01
"""How much it may change all the same, over U, or rho U2 for a pressure."""
SCALE = {"unit": "U, or rho U2"}


@dataclass(frozen=True)
class ReferenceRow:
    """One profile in a table; errors are dimensionless."""

    parameters: str
    profile: str
    state: str
    """`steady`, `time average`, or `transient`."""
    from_time: float = field(metadata={"unit": "s"})
    """Of the snapshot, or of the first one that an average is over."""
    time: float = field(metadata={"unit": "s"})
    """Of the snapshot, or of the last one."""
    reference_time: float | None = field(metadata={"unit": "s"})
    """Of a transient reference."""
    largest_error: float = field(metadata=SCALE)
    rms_error: float = field(metadata=SCALE)
    last_change: float | None = field(metadata=SCALE)
    """How much the run's profile changed, at most, over its last tenth, if it should be steady."""
    settled: bool
    """Whether nothing that should be steady changed more than it may."""
    source: str


@dataclass(frozen=True)
class ProfileComparison:
    """A run's profile beside that of a reference, both dimensionless."""

    row: ReferenceRow
    reference: ReferenceProfile
    coordinate: Array
    """(n_points,) where they are compared: the reference's coordinates that are off the walls."""
    reference_value: Array
    """(n_points,)"""
    value: Array
    """(n_points,) of the run."""
    line_coordinate: Array
    """(n_line,) along the whole line."""
    line_value: Array
    """(n_line,) of the run."""


def profiles_of(case: Case, point: ParameterPoint) -> tuple[ReferenceProfile, ...]:
    """Return the profiles that are known of the flow at a parameter point."""
    scene = case.scene
    if isinstance(scene, LidDrivenCavityScene):
        known = profiles_for(scene.kind, scene.lid, point.reynolds)
        # Those on the way to the steady flow are of a lid that started at once.
        return known if scene.lid_ramp == 0.0 else tuple(p for p in known if p.time is None)
    if isinstance(scene, OpenCavityScene) and _as_in_reference(case, scene):
        return profiles_for(scene.kind, None, point.reynolds)
    return ()


def _as_in_reference(case: Case, scene: OpenCavityScene) -> bool:
    """Whether the open cavity has the geometry and is driven as the reference was."""
    standard = OpenCavityScene(kind="open-cavity")
    return scene == standard and case.fluid.reference_speed == OPEN_CAVITY_SPEED


def compare_with_references(
    case: Case,
    point: ParameterPoint,
    trajectory: Artifact,
    probes: Probes,
    advance: Callable[[int], None],
) -> list[ProfileComparison]:
    """Compare a full run with every profile that is known of its flow.

    A profile of an instant that the run did not reach or record is left out.
    """
    times = trajectory.read("time")
    comparisons = []
    for reference in profiles_of(case, point):
        chosen = _snapshots(case, reference, times)
        if chosen:
            line = _Line(case, reference, probes)
            comparisons.append(_comparison(case, point, line, trajectory, times, chosen))
        advance(1)
    return _judged(comparisons)


def _judged(comparisons: list[ProfileComparison]) -> list[ProfileComparison]:
    """Say of all steady profiles whether the flow was steady, if a velocity shows that it wasn't.

    Pressure has noise that never settles.
    """
    changes = [
        c.row.last_change
        for c in comparisons
        if c.row.last_change is not None and c.reference.quantity != "p"
    ]
    if max(changes, default=0.0) <= SETTLED:
        return comparisons
    return [
        c if c.row.last_change is None else replace(c, row=replace(c.row, settled=False))
        for c in comparisons
    ]


def _snapshots(case: Case, reference: ReferenceProfile, times: Array) -> list[int]:
    """Return the snapshots to hold against a reference: the nearest, the last, or all."""
    if reference.averaged:
        return list(range(len(times)))
    if reference.time is None:
        return [len(times) - 1]
    distance = np.abs(times - reference.time * _time_scale(case))
    nearest = int(distance.argmin())
    interval = float(np.diff(times).max()) if len(times) > 1 else 0.0
    return [nearest] if distance[nearest] <= 0.5 * interval * (1.0 + ROUNDING) else []


def _time_scale(case: Case) -> float:
    return case.scene.reference_length / case.fluid.reference_speed


class _Line:
    """The points of one reference's line, and a run's profile there."""

    def __init__(self, case: Case, reference: ReferenceProfile, probes: Probes) -> None:
        self.case = case
        self.reference = reference
        domain, length = assembly.domain(case), case.scene.reference_length
        on_line = self._points(reference.coordinate * length)
        inside = wall_distance(domain, on_line) > ON_WALL * case.particle_spacing
        # On the walls themselves a run has its boundary conditions, not a solution.
        self.compared = inside & domain.contains(on_line)
        along = self._whole_line(len(probes.line))
        self.coordinate = along / length
        gauge = self._gauge(probes)
        self.n_compared, self.n_line = int(self.compared.sum()), len(along)
        points = (on_line[self.compared], self._points(along), gauge)
        self.sample = sampler(case, np.concatenate(points))

    def profiles(self, trajectory: Artifact, snapshots: list[int]) -> tuple[Array, Array]:
        """Return the run, averaged over snapshots, at the reference's points and on the line."""
        sampled = [sample_snapshot(self.case, trajectory, self.sample, i) for i in snapshots]
        samples = Samples(
            np.array(snapshots, dtype=float),
            np.array([velocity for velocity, _ in sampled]),
            np.array([pressure for _, pressure in sampled]),
        )
        mean = self._scaled(samples).mean(axis=0)
        return mean[: self.n_compared], mean[self.n_compared : self.n_compared + self.n_line]

    def _scaled(self, samples: Samples) -> Array:
        """Return the dimensionless quantity (n_snapshots, n_points)."""
        speed = self.case.fluid.reference_speed
        if self.reference.quantity != "p":
            component = "uv".index(self.reference.quantity)
            return samples.velocity[..., component] / speed
        zero = samples.pressure[:, self.n_compared + self.n_line :].mean(axis=1, keepdims=True)
        return (samples.pressure - zero) / (self.case.fluid.reference_density * speed**2)

    def _points(self, along: Array) -> Array:
        """Return points (n_points, 2) [m] at distances along the reference's line."""
        across = np.full_like(along, self.reference.offset * self.case.scene.reference_length)
        columns = (along, across) if self.reference.axis == "x" else (across, along)
        return np.stack(columns, axis=1)

    def _whole_line(self, n_points: int) -> Array:
        domain = assembly.domain(self.case)
        if self.reference.axis == "y":
            across = self.reference.offset * self.case.scene.reference_length
            return spread(fluid_spans(domain, across), n_points)
        return spread([(domain.lower[0], domain.upper[0])], n_points)

    def _gauge(self, probes: Probes) -> Array:
        """Return where the mean of the pressure is zero."""
        if self.reference.quantity != "p":
            return np.empty((0, 2))
        if self.reference.gauge == "mean":
            return probes.grid
        domain = assembly.domain(self.case)
        return 0.5 * np.add(domain.lower, domain.upper)[None]


def _comparison(
    case: Case,
    point: ParameterPoint,
    line: _Line,
    trajectory: Artifact,
    times: Array,
    chosen: list[int],
) -> ProfileComparison:
    reference = line.reference
    value, line_value = line.profiles(trajectory, chosen)
    expected = reference.value[line.compared]
    error = value - expected
    last_change = None
    if reference.time is None and not reference.averaged:
        before = int(np.searchsorted(times, times[-1] - SETTLING_SHARE * (times[-1] - times[0])))
        earlier, _ = line.profiles(trajectory, [max(0, min(before, len(times) - 2))])
        last_change = float(np.abs(value - earlier).max())
    transient = None if reference.time is None else reference.time * _time_scale(case)
    row = ReferenceRow(
        parameters=point.label,
        profile=reference.name,
        state=_state(reference),
        from_time=float(times[chosen[0]]),
        time=float(times[chosen[-1]]),
        reference_time=transient,
        largest_error=float(np.abs(error).max()),
        rms_error=float(np.sqrt(np.mean(error**2))),
        last_change=last_change,
        settled=True,
        source=reference.source,
    )
    return ProfileComparison(
        row=row,
        reference=reference,
        coordinate=reference.coordinate[line.compared],
        reference_value=expected,
        value=value,
        line_coordinate=line.coordinate,
        line_value=line_value,
    )


def _state(reference: ReferenceProfile) -> str:
    if reference.averaged:
        return "time average"
    return "steady" if reference.time is None else "transient"
