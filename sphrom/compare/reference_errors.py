"""Full runs against the profiles of reference solutions, where there are any of their flow.

Profiles are means over a window of time; the scatter of its snapshots stands beside the errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.reference_lines import SETTLING_SHARE, Line, Snapshots, time_scale, window_of
from sphrom.metrics.samples import Probes
from sphrom.scenes.reference_profiles import ReferenceProfile

Array = NDArray[np.float64]

SETTLED = 0.01
"""The largest change of a settled flow, over U, or rho U2 for a pressure."""
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


def profiles_of(case: Case, point: ParameterPoint) -> tuple[ReferenceProfile, ...]:
    """Return the known profiles of the flow at a parameter point: with the scene's own drive."""
    if any(value != case.own_values[name] for name, value in point.others):
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
