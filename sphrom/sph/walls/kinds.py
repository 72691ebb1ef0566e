"""The list of wall rules, with their properties that cases need before loading their code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphrom.sph.walls.rule import WallRule

LARGEST_WAVE_NUMBER = 1.4
"""Largest resolved wave number of sound, times h: sqrt of the largest eigenvalue of -D G."""


@dataclass(frozen=True)
class WallKind:
    """A wall rule."""

    code: str
    """Its module in this folder, and its class there."""
    meaning: str
    at_fixed_points: bool = False
    """Whether it has matrices at fixed points, with D = -G^T."""
    along_axes: bool = True
    """Whether it is for walls along the axes only."""
    below_surfaces: bool = True
    """Whether it is for fluid with a free surface, too."""
    drives_slip: bool = False
    """Whether its walls give energy to fluid that slips freely along them."""
    wave_number: float = LARGEST_WAVE_NUMBER
    """Largest wave number of sound beside its walls, times h."""
    viscous_limit: float = 0.22
    """Largest nu dt / (h dx), because velocities are extrapolated from close by."""
    stiffer_at_corners: float = 0.2
    """Increase of the largest friction rate beside walls at a corner, relative to its sharpness."""

    @property
    def rule(self) -> type[WallRule]:
        """The class of the rule, whose module is imported here."""
        rule: type[WallRule] = resolve_name(f"sphrom.sph.walls.{self.code}")
        return rule


KINDS: Mapping[str, WallKind] = {
    "mirrored": WallKind(
        "mirrored:Mirrored",
        "pressure of a linear fit around each ghost's mirror point in the fluid (compare English "
        "et al. 2022), velocity extrapolated from each particle through the wall (Morris et al. "
        "1997), and minus the transpose of the pressure force in continuity",
        at_fixed_points=True,
        along_axes=False,
        below_surfaces=False,
        wave_number=1.47,
        viscous_limit=0.21,
        stiffer_at_corners=0.15,
    ),
    "adjoint": WallKind(
        "rules:Adjoint",
        "velocity extrapolated, and minus the transpose of the pressure force in continuity",
        at_fixed_points=True,
        along_axes=False,
    ),
    "normal": WallKind(
        "rules:Normal",
        "velocity extrapolated, and only its part across the wall in continuity",
        drives_slip=True,
    ),
    "adami": WallKind(
        "rules:Adami",
        "2 U_wall - u of the interpolated velocity u (Adami et al. 2012), and only its part across "
        "the wall in continuity",
        drives_slip=True,
    ),
    "adami-as-fluid": WallKind(
        "rules:AdamiAsFluid",
        "2 U_wall - u, and ghosts count like fluid in continuity",
        along_axes=False,
    ),
    "printed": WallKind(
        "rules:Printed",
        "as printed: u with its tangential part reversed, and ghosts count like fluid",
    ),
    "printed-normal": WallKind(
        "rules:PrintedNormal",
        "u with its tangential part reversed, and only its part across the wall in continuity",
        drives_slip=True,
    ),
}
"""The rules by the value of `discretization.walls.kind`."""
