"""What drives a flow by parameter: each moves walls or pushes the fluid in proportion to its value.

Walls' velocities and the body force are affine in the parameters: those that were given, and a part
for each parameter times its value. So are all operators that follow from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, TypeVar

T = TypeVar("T")
Factors = Mapping[str, float]
"""The values of the parameters by name."""
NONE: Factors = MappingProxyType({})


@dataclass(frozen=True)
class Drive(Generic[T]):
    """What walls and the body force give per unit of a parameter; None for nothing."""

    walls: T | None = None
    force: T | None = None
