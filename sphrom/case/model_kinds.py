"""The kinds of reduced models that a case can ask for, and what others need to know of each.

A closure is added here, in `sphrom.reduction.particle_model` (its equations) and in
`sphrom.online.basis_model` (how a case sets it up).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

ProjectionName = Literal["galerkin", "apg"]
EvaluationName = Literal["particles", "operators"]


@dataclass(frozen=True)
class Projection:
    """A way to project the rates onto the modes."""

    title: str
    """As tables and plots name it."""
    keys: frozenset[str]
    """Keys of a reduced model that are for this projection, and not for all."""
    has_memory: bool = False
    """Whether its closure has a memory length, and projected operators of its own."""


@dataclass(frozen=True)
class Evaluation:
    """A way to compute the rates of a reduced model."""

    title: str
    """What the name of a model says of it in tables and plots; nothing for projected operators."""
    keys: frozenset[str]
    """Keys of a reduced model that are for this evaluation, and not for all."""
    projections: tuple[ProjectionName, ...]
    """The projections that it can be combined with."""
    from_operators: bool
    """Whether its rates are polynomials of the coordinates alone. Otherwise they are evaluated on
    moving particles, and a run needs and makes a trajectory."""


PROJECTIONS: Mapping[str, Projection] = {
    "galerkin": Projection("Galerkin", frozenset({"calibrated"})),
    "apg": Projection("APG", frozenset({"memory_length", "jacobian_step"}), has_memory=True),
}
EVALUATIONS: Mapping[str, Evaluation] = {
    "particles": Evaluation(
        ", on particles",
        frozenset({"advection", "jacobian_step"}),
        ("galerkin", "apg"),
        from_operators=False,
    ),
    "operators": Evaluation(
        "",
        frozenset(
            {
                "output",
                "calibrated",
                "corrected",
                "integrated_modes",
                "until",
                "steady",
                "tracers",
            }
        ),
        ("galerkin", "apg"),
        from_operators=True,
    ),
}
