"""The options of `import`: names, units, frame and times of another program's files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import typer

from sphrom.errors import CaseError

UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "density": {"kg/m3": 1.0, "g/cm3": 1e3, "kg/mm3": 1e9},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5},
}
"""Units in SI units, by quantity."""


def _option(metavar: str | None, text: str) -> object:
    return typer.Option(metavar=metavar, help=text)


@dataclass(frozen=True)
class ImportOptions:
    """What files mean; each field is an option of the command line, with its help."""

    array: Annotated[
        str | None,
        _option("NAME", "Particles to take: PySPH's name, or a field's value such as Type=3."),
    ] = None
    position: Annotated[
        str, _option("A,B", "Two fields; of a vector such as points.x,points.y.")
    ] = "x,y"
    velocity: Annotated[
        str | None, _option("A,B", "Two fields.  [default: u,v, or velocity.x,velocity.y]")
    ] = None
    density: Annotated[str | None, _option("NAME", "Density.  [default: rho]")] = None
    pressure: Annotated[str | None, _option("NAME", "Pressure, in place of the density.")] = None
    zero_mean_pressure: Annotated[
        bool, typer.Option("--zero-mean-pressure", help="Take the mean out of each pressure.")
    ] = False
    sort_by: Annotated[str | None, _option("NAME", "Field that numbers the particles.")] = None
    units: Annotated[
        str, _option("UNITS", "Those that aren't SI's, like length=mm,velocity=cm/s,time=0.1.")
    ] = ""
    origin: Annotated[str, _option("X,Y", "Where the scene's (0, 0) is, in the files' units.")] = (
        "0,0"
    )
    time_step: Annotated[
        float | None, _option("TIME", "From file to file by name.  [default: as files tell]")
    ] = None
    start: Annotated[
        float, _option("TIME", "When the case begins; earlier files are left out.")
    ] = 0.0
    seconds: Annotated[
        float | None, _option("SECONDS", "Time that the run took, stated beside the model's time.")
    ] = None

    def __post_init__(self) -> None:
        if self.density is not None and self.pressure is not None:
            raise CaseError("--density, --pressure: name one, from which the other follows")
        if self.zero_mean_pressure and self.pressure is None:
            raise CaseError("--zero-mean-pressure: goes with --pressure")
        for name, value in {"--time-step": self.time_step, "--seconds": self.seconds}.items():
            if value is not None and not 0.0 < value < math.inf:
                raise CaseError(f"{name}: must be a finite number above zero; got {value:g}")

    @property
    def words(self) -> list[str]:
        """The options of the command line that are not the defaults."""
        changed = {k: v for k, v in vars(self).items() if v != getattr(ImportOptions, k)}
        texts = {k: "" if value is True else f"={value}" for k, value in changed.items()}
        return [f"--{name.replace('_', '-')}{text}" for name, text in texts.items()]

    @property
    def scales(self) -> dict[str, float]:
        """The unit of each quantity in SI units. Raises CaseError where one is unknown."""
        scales = dict.fromkeys(UNITS, 1.0)
        for part in filter(None, self.units.split(",")):
            quantity, _, unit = part.partition("=")
            try:
                known = UNITS[quantity]
                scales[quantity] = known[unit] if unit in known else float(unit)
            except (KeyError, ValueError):
                scales[quantity] = math.nan
            if not 0.0 < scales[quantity] < math.inf:
                allowed = "; ".join(f"{name}={', '.join(units)}" for name, units in UNITS.items())
                raise CaseError(f"--units: got {part!r}; must be a number, or of {allowed}")
        return scales

    def fitting(self, quantity: str, factor: float) -> str:
        """Return advice on the unit that is about a factor larger than the given one, if one is."""
        units = {u: scale / self.scales[quantity] / factor for u, scale in UNITS[quantity].items()}
        unit = min(units, key=lambda u: abs(math.log(units[u])))
        fits = 0.2 < units[unit] < 5.0 and not 0.2 < factor * units[unit] < 5.0
        return f"; {quantity}={unit} of --units would fit" if fits else ""


def pair(option: str, text: str) -> tuple[str, str]:
    """Return the two parts of an option such as `0.5,0.5`. Raises CaseError for another number."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2 or not all(parts):
        raise CaseError(f"--{option}: must be two, like a,b; got {text!r}")
    return parts[0], parts[1]


def place(option: str, text: str) -> tuple[float, float]:
    """Return the coordinates that an option gives. Raises CaseError where it gives none."""
    try:
        x, y = map(float, text.split(","))
    except ValueError as error:
        raise CaseError(f"--{option}: must be like 0.5,0.5; got {text!r}") from error
    return x, y
