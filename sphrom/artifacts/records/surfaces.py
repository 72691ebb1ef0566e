"""Reduced models of flows with a free surface: snapshots, bases, trained models and their runs."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.arrays import Array
from sphrom.artifacts.records.runs import (
    PARAMETERS,
    TIME,
    Force,
    Measured,
    Medium,
    Settings,
    Status,
)
from sphrom.declaration import Record, attribute, dataset, part
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph


class SurfaceSnapshots(Medium, kind="sphrom/surface-snapshots"):
    """The snapshots of one run as stream functions and elevations."""

    space: StreamSpace = part()
    time: Array = dataset("snapshot", *TIME)
    stream_function: Array = dataset(
        "snapshot coefficient", "m2/s", "coefficients of the stream function's B-splines", "psi"
    )
    elevation: Array = dataset(
        "snapshot column", "m", "height y of the surface at the midpoints of equal columns", "eta"
    )
    residual: Array = dataset(
        "snapshot", "1", "norm of the velocity that the fit leaves out, over that of the particles"
    )
    speed: Array = dataset("snapshot", "m/s", "root mean square velocity of the particles")
    parameters: Mapping[str, float] = attribute(*PARAMETERS, default_factory=dict)


class StoredSurfaceBasis(SurfaceBasis):
    """A basis and the singular values of its snapshots."""

    singular_values: Mapping[str, Array] = dataset(
        "singular_value", "m2/s", "singular values of the snapshots", "sigma", "Eq. 3.16"
    )


class SurfaceBases(Medium, kind="sphrom/surface-basis"):
    """Modes of stream functions and elevations."""

    bases: Mapping[str, StoredSurfaceBasis] = part()


class SurfaceModels(Record, kind="sphrom/surface-operators"):
    """Reduced models of a flow with a free surface, trained for some numbers of modes."""

    sizes: Mapping[str, TrainedGraph] = part(at="sizes/*")


class SurfaceRun(Settings, kind="sphrom/surface-run"):
    """The time series of a reduced run with a free surface."""

    time: Array = dataset("snapshot", *TIME)
    generalized_coordinates: Array = dataset(
        "snapshot coordinate", "of the modes, m",
        "coordinates of the velocity's modes, then those of the elevation's", "omega-hat",
        "Eq. 3.11",
    )  # fmt: skip
    force: Mapping[str, Force] = part(default_factory=dict)
    measure: Mapping[str, Measured] = part(default_factory=dict)
    status: Status = attribute("", "how the run ended")
    status_detail: str | None = attribute("", "why it ended early, where and when", default=None)
