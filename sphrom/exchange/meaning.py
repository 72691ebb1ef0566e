"""The options of `import`: names, units, frame and times of another program's files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sphrom.errors import CaseError

UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "density": {"kg/m3": 1.0, "g/cm3": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5},
}
"""Units in SI units, by quantity."""


def _option(default: object, metavar: str | None, text: str) -> Any:
    return field(default=default, metadata={"metavar": metavar, "help": text})


@dataclass(frozen=True)
class Meaning:
    """What files mean; each field is an option of the command line, with its help."""

    array: str | None = _option(None, "NAME", "PySPH's name of the particles to take.")
    position: str = _option("x,y", "NAMES", "A vector, or two fields.")
    velocity: str | None = _option(
        None, "NAMES", "A vector, or two fields.  [default: u,v, or the vector velocity]"
    )
    density: str | None = _option(
        None, "NAME", "Density; pressure follows.  [default: rho, or density_fluctuation]"
    )
    pressure: str | None = _option(None, "NAME", "Pressure; density follows.")
    zero_mean_pressure: bool = _option(False, None, "Take the mean out of each pressure.")
    sort_by: str | None = _option(None, "NAME", "Field that numbers the particles.")
    units: str = _option(
        "",
        "UNITS",
        "Of length, time, velocity, density and pressure, like length=mm,velocity=cm/s; a number "
        "is one of SI units.  [default: SI]",
    )
    origin: str = _option("0,0", "X,Y", "Where the scene's (0, 0) is, in the files' units.")
    time_step: float | None = _option(
        None,
        "TIME",
        "Time from file to file, in the order of their names.  [default: as files tell]",
    )
    start: float = _option(
        0.0, "TIME", "The files' time at which the case begins; earlier ones are left out."
    )
    seconds: float | None = _option(
        None, "SECONDS", "Time that the run took; unless it is given, no speed-up is known."
    )

    def __post_init__(self) -> None:
        if self.density is not None and self.pressure is not None:
            raise CaseError(
                "--density, --pressure: name one of them; the other follows by the state equation"
            )
        if self.zero_mean_pressure and self.pressure is None:
            raise CaseError("--zero-mean-pressure: goes with --pressure")
        if not math.isfinite(self.start):
            raise CaseError(f"--start: must be a finite number; got {self.start}")
        for name, value in (("--time-step", self.time_step), ("--seconds", self.seconds)):
            if value is not None and not 0.0 < value < math.inf:
                raise CaseError(f"{name}: must be a finite number above zero; got {value:g}")

    @property
    def scales(self) -> dict[str, float]:
        """The unit of each quantity in SI units. Raises CaseError where one is unknown."""
        scales = dict.fromkeys(UNITS, 1.0)
        for part in filter(None, self.units.split(",")):
            quantity, _, unit = part.partition("=")
            if quantity not in UNITS:
                raise CaseError(
                    f"--units: must be like length=mm,time=ms, of {', '.join(UNITS)}; got {part!r}"
                )
            known = UNITS[quantity]
            try:
                scales[quantity] = known[unit] if unit in known else float(unit)
            except ValueError:
                scales[quantity] = math.nan
            if not 0.0 < scales[quantity] < math.inf:
                raise CaseError(
                    f"--units: {quantity} must be one of {', '.join(known)}, or a number of "
                    f"{next(iter(known))}; got {unit!r}"
                )
        return scales

    @property
    def origin_place(self) -> tuple[float, float]:
        """Where the scene's (0, 0) is in the files, in their units."""
        try:
            x, y = (float(text) for text in self.origin.split(","))
        except ValueError as error:
            raise CaseError(f"--origin: must be like 0.5,0.5; got {self.origin!r}") from error
        return x, y
