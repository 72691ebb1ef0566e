"""What the options say that files of another program mean: names, units, frame and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.foreign_files import COMPONENTS, ForeignSnapshot
from sphrom.errors import CaseError

Array = NDArray[np.float64]

UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "density": {"kg/m3": 1.0, "g/cm3": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5},
}
"""Units in SI units, by quantity."""
VELOCITIES = (("u", "v", "w"), ("velocity.x", "velocity.y", "velocity.z"))
"""What velocities are called where --velocity doesn't tell, their third component at the end."""
PLANE = (0, 1, 2)
"""The axes of the plane of a flow, and the axis across it, where the options don't tell."""


@dataclass(frozen=True)
class Meaning:
    """The content of files: names and units, as the options give them."""

    array: str | None = None
    position: str | None = None
    velocity: str | None = None
    density: str | None = None
    pressure: str | None = None
    zero_mean_pressure: bool = False
    sort_by: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    """By quantity, a unit of `UNITS` or a number of SI units."""
    origin: str = "0,0"
    """Where the scene's (0, 0) is in the files, in their units."""
    time_step: float | None = None
    """Time from file to file, where they do not tell or are not to be believed."""
    start: float = 0.0
    """The time in the files at which the case begins; earlier snapshots are left out."""
    seconds: float | None = None
    """How long the other program took, for comparisons [s]; None where nobody knows."""

    def __post_init__(self) -> None:
        if self.density is not None and self.pressure is not None:
            raise CaseError(
                "--density, --pressure: name one of them; the other follows by the state equation"
            )
        if self.zero_mean_pressure and self.pressure is None:
            raise CaseError("--zero-mean-pressure: goes with --pressure")
        if self.time_step is not None and not 0.0 < self.time_step < np.inf:
            raise CaseError(f"--time-step: must be above zero; got {self.time_step:g}")
        for name, value in (("--start", self.start), ("--seconds", self.seconds)):
            if value is not None and not np.isfinite(value):
                raise CaseError(f"{name}: must be a finite number; got {value}")
        if self.seconds == 0.0:
            raise CaseError("--seconds: must be above zero; leave it out if unknown")

    def scale(self, quantity: str) -> float:
        """Return the unit of a quantity in SI units."""
        known = UNITS[quantity]
        unit = self.units.get(quantity) or next(iter(known))
        try:
            scale = known[unit] if unit in known else float(unit)
        except ValueError:
            scale = np.nan
        if not 0.0 < scale < np.inf:
            raise CaseError(
                f"--{quantity}-unit: must be one of {', '.join(known)}, or a number of "
                f"{next(iter(known))}; got {unit!r}"
            )
        return scale

    @property
    def origin_place(self) -> Array:
        """Where the scene's (0, 0) is in the files, in their units (2,)."""
        try:
            x, y = (float(text) for text in self.origin.split(","))
        except ValueError as error:
            raise CaseError(f"--origin: must be like 0.5,0.5; got {self.origin!r}") from error
        return np.array((x, y))

    def position_names(self, given: ForeignSnapshot) -> Components:
        """Return the fields of `position`."""
        return self._names("position", self.position or "x,y", given, PLANE)

    def velocity_names(self, given: ForeignSnapshot, position: Components) -> Components:
        """Return the fields of `velocity`, in the plane of `position` unless they are named."""
        plane = position.plane
        if self.velocity is None:
            known = next((n for n in VELOCITIES if n[0] in given.fields), VELOCITIES[0])
            return Components.of(known, plane)
        return self._names("velocity", self.velocity, given, plane)

    def _names(
        self, option: str, text: str, given: ForeignSnapshot, plane: tuple[int, int, int]
    ) -> Components:
        names = [name.strip() for name in text.split(",")]
        if not all(names) or len(names) > 3:
            raise CaseError(f"--{option}: must be one vector, or two fields like a,b; got {text!r}")
        if len(names) == 1:
            return Components.of([f"{names[0]}.{component}" for component in COMPONENTS], plane)
        if len(names) == 3:
            raise CaseError(
                f"--{option}: names three components, and cases are two-dimensional: name the two "
                f"in the plane of the flow, like {names[0]},{names[1]}; got {text!r}"
            )
        return Components(names[0], names[1], _third(names, given), chosen=True)


@dataclass(frozen=True)
class Components:
    """The names of the fields of a vector."""

    first: str
    second: str
    third: str | None = None
    """What a flow in a plane has no use for."""
    chosen: bool = False
    """Whether the two were named one by one."""

    @classmethod
    def of(cls, names: Sequence[str], plane: tuple[int, int, int]) -> Components:
        """Return those of three names that lie in a plane, and the one across it."""
        first, second, third = (names[axis] for axis in plane)
        return cls(first, second, third)

    def __iter__(self) -> Iterator[str]:
        """Give the two names of the plane."""
        return iter((self.first, self.second))

    @property
    def plane(self) -> tuple[int, int, int]:
        """The axes x, y, z of the two names and of the third, as far as the names tell."""
        axes = [COMPONENTS.index(n[-1]) if n[-1:] in COMPONENTS else -1 for n in self]
        if -1 in axes or axes[0] == axes[1]:
            return PLANE
        return axes[0], axes[1], 3 - sum(axes)


def _third(names: list[str], given: ForeignSnapshot) -> str | None:
    """Return the third component beside two that are named, where the file has one."""
    vectors = {name.rpartition(".")[0] for name in names}
    families: list[tuple[str, ...]] = [COMPONENTS, *VELOCITIES]
    families += [tuple(f"{vector}.{c}" for c in COMPONENTS) for vector in vectors if vector]
    for family in families:
        others = set(family) - set(names)
        if len(others) == 1 and others <= set(given.fields):
            return others.pop()
    return None
