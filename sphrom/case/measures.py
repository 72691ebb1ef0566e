"""What a case measures over time."""

from __future__ import annotations

from sphrom.case.fields import SafeName, Section, key


class MeasureSection(Section):
    """One measurement at every snapshot."""

    force_on: SafeName = key(
        ..., "a wall: its force, and the torque about its centroid, or the box's centre for a side"
    )
