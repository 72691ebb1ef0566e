"""The kinds of artifacts, each declared once: see `sphrom.artifacts.declaration`."""

from sphrom.artifacts.declaration import DECLARED, schema_of_record
from sphrom.artifacts.records.basis import Basis
from sphrom.artifacts.records.comparison import Comparison
from sphrom.artifacts.records.coordinates import Coordinates
from sphrom.artifacts.records.fit import Fit
from sphrom.artifacts.records.operators import Operators
from sphrom.artifacts.records.splines import BSpline, Spline
from sphrom.artifacts.records.sweep import Sweep
from sphrom.artifacts.records.trajectory import (
    Checkpoint,
    Packing,
    ReferenceSnapshots,
    State,
    Trajectory,
    TrajectoryPart,
)
from sphrom.artifacts.schema import Schema

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

SCHEMAS: dict[str, Schema] = {
    kind: schema_of_record(kind, record) for kind, record in DECLARED.items()
}
