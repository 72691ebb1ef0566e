"""What estimates of errors need, read back from the operators' artifact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError
from sphrom.reduction.error_calibration import (
    FieldProducts,
)
from sphrom.reduction.error_estimate import ResidualFactor
from sphrom.reduction.held_out import UnheldShares
from sphrom.reduction.interpolation_weights import interpolation_weights
from sphrom.reduction.operators import PARTS

Array = NDArray[np.float64]


def places_of(points: Sequence[ParameterPoint]) -> Array:
    """Return where points are (n_points, n_parameters): parameters count by their ratios."""
    return np.log([list(point.as_dict().values()) for point in points])


def role_of(case: Case, basis: str, point: ParameterPoint) -> str:
    """Return what a point is to a basis: `trained`, else `predicted` inside of its training points.

    Outside of them it is `extrapolated`.
    """
    trained = case.bases[basis]
    if point in trained:
        return "trained"
    _, distance = interpolation_weights(places_of(trained), places_of([point])[0])
    return "extrapolated" if distance > 0.0 else "predicted"


def read_unheld(artifact: Artifact, name: str) -> UnheldShares:
    """Read what bases hold of snapshots that they have not learnt."""
    group = f"bases/{name}/estimate/unheld"
    if f"{group}/parameters" not in artifact:
        raise ArtifactError(
            f"{artifact.path} lacks what estimates of errors need, as an older version made it; "
            "`sphrom operators CASE --force` makes it anew"
        )
    return UnheldShares(artifact.read(f"{group}/parameters"), artifact.read(f"{group}/time"))


def read_factor(artifact: Artifact, name: str) -> ResidualFactor:
    """Read the residual's factor of a basis back."""
    group = f"bases/{name}/residual"
    inertia, viscosity, walls, force = (
        artifact.read(f"{group}/{part}") if f"{group}/{part}" in artifact else None
        for part in PARTS
    )
    if inertia is None or viscosity is None:
        raise ValueError(f"{group} is not complete")
    driven = artifact.number("walls_driven") == 1.0
    return ResidualFactor(inertia, viscosity, walls, force, driven)


def read_products(artifact: Artifact, name: str) -> FieldProducts:
    """Read the products of training snapshots with a basis back."""
    group = f"bases/{name}/estimate"
    return FieldProducts(
        *(artifact.read(f"{group}/{part}") for part in ("gram", "projections", "squares"))
    )
