"""Full runs against the profiles of reference solutions, where there are any of their flow.

An instant of a run has the sound of a weakly compressible model and the noise of particles that
rearrange, so that errors of one instant change with the output step. Profiles are therefore means
over a window of time; the scatter of its snapshots stands beside the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.samples import Probes, Samples, spread
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.setup.particles import sampler
from sphrom.store.sampling import ON_WALL, ROUNDING, sample_snapshot

Array = NDArray[np.float64]

SETTLED = 0.01
"""The largest change of a settled flow, over U, or rho U2 for a pressure."""
SETTLING_SHARE = 0.1
"""The part of a run, at its end, over which a steady flow should no longer change.

Unless the case says otherwise, steady profiles are means over it.
"""
SCALE = {"unit": "U, or rho U2"}


@dataclass(frozen=True)
class ReferenceRow:
    """One profile in a table; errors are dimensionless."""

    parameters: str
    profile: str
    state: str
    """`steady`, `time average`, or `transient`."""
    from_time: float = field(metadata={"unit": "s"})
    """Of the first snapshot of the window whose mean is compared."""
    time: float = field(metadata={"unit": "s"})
    """Of the last one."""
    n_snapshots: int
    """In the window."""
    reference_time: float | None = field(metadata={"unit": "s"})
    """Of a transient reference."""
    largest_error: float = field(metadata=SCALE)
    """Of the mean over the window."""
    largest_scatter: float | None = field(metadata=SCALE)
    """Standard deviation of the window's snapshots, where it is largest; None for one snapshot."""
    rms_error: float = field(metadata=SCALE)
    rms_scatter: float | None = field(metadata=SCALE)
    """Its root mean square over the points."""
    last_change: float | None = field(metadata=SCALE)
    """How much the mean changed, at most, over the run's last tenth, if it should be steady."""
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
    """(n_points,) of the run, its mean over the window."""
    scatter: Array
    """(n_points,) the standard deviation of the window's snapshots; 0 where there is one."""
    line_coordinate: Array
    """(n_line,) along the whole line."""
    line_value: Array
    """(n_line,) of the run, its mean over the window."""


def window_of(case: Case, reference: ReferenceProfile, times: Array) -> range:
    """Return the snapshots whose mean is compared with a reference; none for one out of reach.

    Those of an average are all. Steady profiles have the last tenth of the run, transient ones
    a period of the longest sound wave around their instant, in which the flow hardly changes: a
    window about an instant leaves its linear change out, and is cut on both sides where the run
    ends.
    """
    if reference.averaged:
        return range(len(times))
    if reference.time is None:
        length = SETTLING_SHARE * float(times[-1] - times[0])
        first = int(np.searchsorted(times, times[-1] - length - ROUNDING * times[-1]))
        return range(first, len(times))
    distance = np.abs(times - reference.time * time_scale(case))
    nearest = int(distance.argmin())
    interval = float(np.diff(times).max()) if len(times) > 1 else 0.0
    if distance[nearest] > 0.5 * interval * (1.0 + ROUNDING):
        return range(0)
    period = case.plan.longest_sound_period
    within = np.abs(times - times[nearest]) <= 0.5 * period * (1.0 + ROUNDING)
    n_before, n_after = int(within[:nearest].sum()), int(within[nearest + 1 :].sum())
    n_beside = min(n_before, n_after)
    return range(nearest - n_beside, nearest + n_beside + 1)


def time_scale(case: Case) -> float:
    """Return the unit of a reference's times [s]."""
    return case.scene.length_scale / case.fluid.reference_speed


class Line:
    """The points of one reference's line, and a run's profile there."""

    def __init__(
        self, case: Case, reference: ReferenceProfile, probes: Probes, window: range
    ) -> None:
        self.case = case
        self.reference = reference
        self.window = window
        domain, length = case.scene.domain, case.scene.length_scale
        on_line = self._points(reference.coordinate * length)
        inside = domain.wall_distance(on_line) > ON_WALL * case.plan.particle_spacing
        # On the walls themselves a run has its boundary conditions, not a solution.
        self.compared = inside & domain.contains(on_line)
        along = self._whole_line(len(probes.line))
        self.coordinate = along / length
        datum = self._datum(probes)
        self.n_compared, self.n_line = int(self.compared.sum()), len(along)
        self.points = np.concatenate((on_line[self.compared], self._points(along), datum))

    def profiles(self, samples: Samples) -> tuple[Array, Array]:
        """Return samples at the reference's points and on the line (n_snapshots, n_points)."""
        scaled = self._scaled(samples)
        return scaled[:, : self.n_compared], scaled[:, self.n_compared :][:, : self.n_line]

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
        across = np.full_like(along, self.reference.offset * self.case.scene.length_scale)
        columns = (along, across) if self.reference.axis == "x" else (across, along)
        return np.stack(columns, axis=1)

    def _whole_line(self, n_points: int) -> Array:
        domain = self.case.scene.domain
        if self.reference.axis == "y":
            across = self.reference.offset * self.case.scene.length_scale
            return spread(domain.sections(across), n_points)
        return spread([(domain.lower[0], domain.upper[0])], n_points)

    def _datum(self, probes: Probes) -> Array:
        """Return where the mean of the pressure is zero."""
        if self.reference.quantity != "p":
            return np.empty((0, 2))
        if self.reference.datum == "mean":
            return probes.grid
        domain = self.case.scene.domain
        return 0.5 * np.add(domain.lower, domain.upper)[None]


class Snapshots:
    """A run's snapshots at the points of several lines, each sampled once."""

    def __init__(self, case: Case, trajectory: Artifact, lines: Sequence[Line]) -> None:
        self._case, self._trajectory = case, trajectory
        ends = np.cumsum([0, *(len(line.points) for line in lines)])
        self._where = {
            id(line): slice(*pair) for line, pair in zip(lines, pairwise(ends), strict=True)
        }
        self._sample = sampler(case, np.concatenate([line.points for line in lines]))
        self._sampled: dict[int, tuple[Array, Array]] = {}

    def of(self, line: Line, snapshots: range) -> tuple[Array, Array]:
        """Return a line's profiles at snapshots, as `Line.profiles` does."""
        for i in snapshots:
            if i not in self._sampled:
                self._sampled[i] = sample_snapshot(self._case, self._trajectory, self._sample, i)
        where = self._where[id(line)]
        velocities = [self._sampled[i][0][where] for i in snapshots]
        pressures = [self._sampled[i][1][where] for i in snapshots]
        times = np.array(snapshots, dtype=float)
        return line.profiles(Samples(times, np.array(velocities), np.array(pressures)))


def profiles_of(case: Case, point: ParameterPoint) -> tuple[ReferenceProfile, ...]:
    """Return the known profiles of the flow at a parameter point: with the scene's own drive."""
    if any(value != case.plan.own_values[name] for name, value in point.others):
        return ()
    return case.scene.reference_profiles(point.reynolds, case.fluid.reference_speed)


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
    known = profiles_of(case, point)
    windows = [window_of(case, reference, times) for reference in known]
    lines = [
        Line(case, reference, probes, chosen)
        for reference, chosen in zip(known, windows, strict=True)
        if len(chosen)
    ]
    advance(len(known) - len(lines))
    if not lines:
        return []
    snapshots = Snapshots(case, trajectory, lines)
    comparisons = []
    for line in lines:
        comparisons.append(_comparison(case, point, line, times, snapshots))
        advance(1)
    return _judged(comparisons)


def _judged(comparisons: list[ProfileComparison]) -> list[ProfileComparison]:
    """Mark all steady profiles as unsettled, if a velocity shows that the flow still changed.

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


def _comparison(
    case: Case, point: ParameterPoint, line: Line, times: Array, snapshots: Snapshots
) -> ProfileComparison:
    reference, chosen = line.reference, line.window
    values, line_values = snapshots.of(line, chosen)
    value, scatter = values.mean(axis=0), values.std(axis=0)
    expected = reference.value[line.compared]
    error = value - expected
    steady = reference.time is None and not reference.averaged
    transient = None if reference.time is None else reference.time * time_scale(case)
    row = ReferenceRow(
        parameters=point.label,
        profile=reference.name,
        state=_state(reference),
        from_time=float(times[chosen[0]]),
        time=float(times[chosen[-1]]),
        n_snapshots=len(chosen),
        reference_time=transient,
        largest_error=float(np.abs(error).max()),
        largest_scatter=float(scatter.max()) if len(chosen) > 1 else None,
        rms_error=_rms(error),
        rms_scatter=_rms(scatter) if len(chosen) > 1 else None,
        last_change=_last_change(line, times, snapshots) if steady else None,
        settled=True,
        source=reference.source,
    )
    return ProfileComparison(
        row=row,
        reference=reference,
        coordinate=reference.coordinate[line.compared],
        reference_value=expected,
        value=value,
        scatter=scatter,
        line_coordinate=line.coordinate,
        line_value=line_values.mean(axis=0),
    )


def _last_change(line: Line, times: Array, snapshots: Snapshots) -> float:
    """Return how much the mean over a window changed, at most, since one a tenth of a run before.

    A window that reaches beyond the start is cut there.
    """
    earlier = times[-1] - SETTLING_SHARE * (times[-1] - times[0])
    last = min(int(np.searchsorted(times, earlier)), len(times) - 2)
    before = range(max(0, last + 1 - len(line.window)), max(0, last) + 1)
    now, then = (snapshots.of(line, window)[0].mean(axis=0) for window in (line.window, before))
    change = now - then
    return float(np.abs(change).max())


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _state(reference: ReferenceProfile) -> str:
    if reference.averaged:
        return "time average"
    return "steady" if reference.time is None else "transient"
