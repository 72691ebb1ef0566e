"""The contents of comparisons of runs."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset, part

_PLACES = {"line": "on the line", "field": "over the whole field"}
_NORMS = {"velocity": "velocity", "pressure": "pressure minus its mean there"}
_VALUES = {"velocity": "speed", "pressure": "pressure"}
_RANGES = {"line": "on the line", "field": "of the whole field"}


def _norms(ending: str, relative_to: str = "") -> dict[str, str]:
    """Return the meanings of L2 norms of errors, by names with an ending."""
    return {
        f"{quantity}_{place}_{ending}": f"{norm}, {where}{relative_to}"
        for quantity, norm in _NORMS.items()
        for place, where in _PLACES.items()
    }


class Series(Record):
    """The errors of one run over time."""

    time: Array = dataset("snapshot", "s", "time of each snapshot", "t", "Eq. 2.18")
    relative_l2: Mapping[str, Array] = dataset(
        "snapshot",
        "%",
        "relative L2 error of %s",
        names=_norms("relative_l2"),
        at="*",
        default_factory=dict,
    )
    over_rms: Mapping[str, Array] = dataset(
        "snapshot",
        "%",
        "L2 error of %s",
        names=_norms("l2_over_rms", ", over the root mean square in time"),
        at="*",
        default_factory=dict,
    )
    eq41: Mapping[str, Array] = dataset(
        "snapshot",
        "%",
        "relative discrepancy of %s",
        equation="Eq. 4.1",
        names={
            f"{quantity}_{place}_eq41_by_{over}_range": f"{value}, {where}, over the range {of}"
            for quantity, value in _VALUES.items()
            for place, where in _PLACES.items()
            for over, of in _RANGES.items()
        },
        at="*",
        default_factory=dict,
    )
    status: str | None = attribute("", "how the run ended", default=None)
    figures: Mapping[str, float] = attribute(
        "", "figure of merit over the whole run", at="*", default_factory=dict
    )


class Samples(Record):
    """Velocity and pressure at some places over time."""

    position: Array = dataset("point component", "m", "the places", "x")
    time: Array = dataset("snapshot", "s", "time of each snapshot", "t", "Eq. 2.18")
    velocity: Array = dataset("snapshot point component", "m/s", "velocity at the point", "u")
    pressure: Array = dataset("snapshot point", "Pa", "pressure at the point", "p")


class Ranges(Record):
    """Ranges of the full run over line and grid, the denominators of Eq. 4.1."""

    time: Array = dataset("snapshot", "s", "time of each snapshot", "t", "Eq. 2.18")
    speed: Array = dataset("snapshot", "m/s", "largest less smallest speed", equation="Eq. 4.1")
    pressure: Array = dataset(
        "snapshot", "Pa", "largest less smallest pressure", equation="Eq. 4.1"
    )


class ReferenceProfile(Record):
    """A published or independent profile, and that of a full run."""

    coordinate: Array = dataset(
        "point", "1", "coordinate along a reference's profile, divided by the reference length"
    )
    reference_value: Array = dataset(
        "point", "1", "value of the reference at the point, divided by U or rho U^2"
    )
    value: Array = dataset("point", "1", "the full run there, averaged over a window of time")
    scatter: Array = dataset(
        "point", "1", "standard deviation of its snapshots there in the window"
    )


class Comparison(Record, kind="sphrom/comparison"):
    """Figures of merit over time, by compared run and by parameter."""

    series: Mapping[str, Series] = part(at="series/*/*", default_factory=dict)
    centreline: Mapping[str, Samples] = part(at="centreline/*/*")
    stations: Mapping[str, Samples] = part(at="stations/*/*", default_factory=dict)
    ranges: Mapping[str, Ranges] = part(at="ranges/*", default_factory=dict)
    reference: Mapping[str, ReferenceProfile] = part(at="reference/*/*", default_factory=dict)
