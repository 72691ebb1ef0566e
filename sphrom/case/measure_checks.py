"""Checks of what a case measures against its geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sphrom.case.measures import KINDS, MeasureSection
from sphrom.case.models import Case
from sphrom.case.yaml_reader import Problem

Array = NDArray[np.float64]

WITHIN_WALL = 0.1
"""How far a place may be in the solid, over the particles' spacing: a circle is a polygon."""
PER_SPACING = 4
"""Places along a segment that are looked at, for each spacing of the particles."""
MOST_LOOKED_AT = 100_000


def check_measures(case: Case) -> Iterator[Problem]:
    """Check that there are the measured walls, and that places and segments are in the fluid."""
    for name, measured in case.scene.measure.items():
        kind = next(kind for kind in KINDS if getattr(measured, kind) is not None)
        if (reason := _problem(case, measured)) is not None:
            yield Problem(("scene", "measure", name, kind), reason)


def _problem(case: Case, measured: MeasureSection) -> str | None:
    if measured.force_on is not None:
        names = case.scene.domain.wall_names
        if measured.force_on in names:
            return None
        return f"there is no such wall; the walls are {', '.join(names) or 'none'}"
    if measured.probe is not None:
        return outside_fluid(case, np.array([measured.probe]))
    assert measured.segment is not None
    start, end = np.array(measured.segment)
    length = math.dist(start, end)
    if not length > 0.0:
        return "its ends are one place"
    number = min(2 + math.ceil(PER_SPACING * length / case.particle_spacing), MOST_LOOKED_AT)
    along = np.linspace(0.0, 1.0, number)[:, None]
    return outside_fluid(case, start + along * (end - start))


def outside_fluid(case: Case, place: Array) -> str | None:
    """Return which of some places (n_places, 2) is out of the box or in a solid, in words."""
    domain = case.scene.domain
    slack = WITHIN_WALL * case.particle_spacing
    beyond = (place < np.array(domain.lower)) | (place > np.array(domain.upper))
    for x, y in place[beyond.any(axis=1)][:1]:
        return f"({x:g}, {y:g}) m is outside of the box"
    in_solid = domain.distance_and_normal(place)[0] < -slack
    for x, y in place[in_solid][:1]:
        more = "; give a segment for each part of the fluid" if len(place) > 1 else ""
        return f"({x:g}, {y:g}) m is in a solid{more}"
    return None
