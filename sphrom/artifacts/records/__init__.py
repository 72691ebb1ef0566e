"""The kinds of artifacts, each declared once: see `sphrom.declaration`."""

from sphrom.artifacts.records.comparison import Comparison
from sphrom.artifacts.records.coordinates import Coordinates
from sphrom.artifacts.records.fit import Fit
from sphrom.artifacts.records.operators import Basis, BSpline, Operators, Spline
from sphrom.artifacts.records.sweep import Sweep
from sphrom.artifacts.records.trajectory import (
    Checkpoint,
    Packing,
    ReferenceSnapshots,
    State,
    Trajectory,
    TrajectoryPart,
)
from sphrom.declaration import DECLARED, Schema

__all__ = [
    "SCHEMAS",
    "BSpline",
    "Basis",
    "Checkpoint",
    "Comparison",
    "Coordinates",
    "Fit",
    "Operators",
    "Packing",
    "ReferenceSnapshots",
    "Spline",
    "State",
    "Sweep",
    "Trajectory",
    "TrajectoryPart",
]

SCHEMAS = {kind: Schema.of(kind, record) for kind, record in DECLARED.items()}
