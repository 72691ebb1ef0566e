"""Sums of constant tensors times products of parameters, which serve all parameters.

Everything that is projected is affine in a few products of the parameters: the rates, their
residual, a closure, a calibration and the forces on walls. The factor of a part is such a product,
written as the names of its parameters; an empty one is one. The amplitude of a body force or of
driven walls changes in time, so sums are kept by its power.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Tensors

Factor = tuple[str, ...]
"""The names of the parameters whose product it is."""

# Parameters of a case are identifiers, so they never have such a name.
VISCOSITY = "kinematic viscosity"
AMPLITUDE = "driving amplitude"

FACTORS: Mapping[str, Factor] = {
    "inertia": (),
    "viscosity": (VISCOSITY,),
    "walls": (VISCOSITY,),
    "force": (AMPLITUDE,),
    "pressure": (),
    "viscous": (VISCOSITY,),
    "body_force": (AMPLITUDE,),
    "push": (AMPLITUDE,),
    "strain": (VISCOSITY,),
    "slowing": (),
}
"""The factors of the parts of rates (`sphrom.reduction.forms`), and then of those of forces."""


def factor_of(part: str, walls_driven: bool) -> Factor:
    """Return the factor of a part, such as `walls` or, per unit of a parameter, `walls/lid`.

    `walls_driven` is whether walls move with the amplitude.
    """
    name, *parameters = part.split("/")
    driven = (AMPLITUDE,) if walls_driven and name == "walls" else ()
    return (*FACTORS[name], *driven, *parameters)


@dataclass(frozen=True)
class Affine:
    """A sum of parts: tensors times a factor each."""

    parts: Sequence[tuple[Factor, Tensors]]
    """The tensors of a part may end before those of earlier ones, and so may their last axes: the
    rest of them is zero."""

    def at(self, values: Mapping[str, float | Array]) -> tuple[Tensors, ...]:
        """Return the tensors (..., n, ...) of the sum, by power 0, 1, ... of the amplitude.

        Values of the parameters may have axes (...), such as one of runs.
        """
        ones = np.ones(np.broadcast_shapes(*map(np.shape, values.values())))
        powers = list[list[Array]]()
        for factor, tensors in self.parts:
            power = factor.count(AMPLITUDE)
            value = math.prod((values[name] for name in factor if name != AMPLITUDE), start=ones)
            powers += [[] for _ in range(len(powers), power + 1)]
            total = powers[power]
            for degree, tensor in enumerate(tensors):
                term = np.multiply.outer(value, tensor)
                if degree == len(total):
                    total.append(term)
                elif term.shape == total[degree].shape:
                    total[degree] += term
                else:
                    total[degree][..., : tensor.shape[-1]] += term
        return tuple(map(tuple, powers))
