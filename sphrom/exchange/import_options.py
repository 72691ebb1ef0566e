"""The options of `import`: names, units, frame and times of another program's files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import typer

from sphrom.errors import CaseError

UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "km": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "velocity": {
        "m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "km/h": 1.0 / 3.6, "km/s": 1e3,
        "mm/ms": 1.0, "cm/ms": 10.0, "m/ms": 1e3, "mm/us": 1e3, "um/us": 1.0, "um/ms": 1e-3,
    },
    "density": {
        "kg/m3": 1.0, "g/cm3": 1e3, "g/mm3": 1e6, "kg/mm3": 1e9, "t/m3": 1e3, "t/mm3": 1e12,
        "kg/l": 1e3, "g/l": 1.0, "g/m3": 1e-3,
    },
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "mbar": 1e2, "bar": 1e5,
    },
}  # fmt: skip
"""Values of units in SI units, by quantity; if two are equal, messages name the first."""
LARGEST = 1e12
"""Largest number of an option, and largest value of a unit in SI units, or of its inverse."""


def _option(metavar: str | None, text: str) -> object:
    return typer.Option(metavar=metavar, help=text)


@dataclass(frozen=True)
class ImportOptions:
    """The names, units and frame of fields in files; each field is a command-line option."""

    array: Annotated[
        str | None,
        _option("NAME", "Particles to import: PySPH's name, or a field's value such as Type=3."),
    ] = None
    position: Annotated[
        str | None,
        _option(
            "A,B",
            "Two fields, or three in three dimensions, or components such as pos.x,pos.y.  "
            "[default: x,y, or x,y,z]",
        ),
    ] = None
    velocity: Annotated[
        str | None,
        _option(
            "A,B",
            "The fields of the velocity. [default: u,v, or velocity.x,velocity.y; in three "
            "dimensions with w or z]",
        ),
    ] = None
    density: Annotated[str | None, _option("NAME", "Density.  [default: rho]")] = None
    pressure: Annotated[str | None, _option("NAME", "Pressure, instead of the density.")] = None
    zero_mean_pressure: Annotated[
        bool, typer.Option("--zero-mean-pressure", help="Subtract the mean of each pressure field.")
    ] = False
    sort_by: Annotated[str | None, _option("NAME", "Field that numbers the particles.")] = None
    units: Annotated[
        str, _option("UNITS", "Units that are not SI, like length=mm,velocity=cm/s,time=0.1.")
    ] = ""
    origin: Annotated[
        str | None,
        _option("X,Y", "Origin of the scene in the files' coordinates and units. [default: 0,0]"),
    ] = None
    time_step: Annotated[
        float | None, _option("TIME", "Time between files in order of names.  [default: as stored]")
    ] = None
    start: Annotated[float, _option("TIME", "Start of the case; earlier files are left out.")] = 0.0
    seconds: Annotated[
        float | None, _option("SECONDS", "Wall-clock time of the run, shown beside the model's.")
    ] = None

    def __post_init__(self) -> None:
        if self.density is not None and self.pressure is not None:
            raise CaseError("--density, --pressure: name only one; the other follows from it")
        if self.zero_mean_pressure and self.pressure is None:
            raise CaseError("--zero-mean-pressure: needs --pressure")
        for name, value in {"--time-step": self.time_step, "--seconds": self.seconds}.items():
            if value is not None and not 0.0 < value <= LARGEST:
                raise CaseError(
                    f"{name}: must be a number above zero, up to {LARGEST:g}; got {value:g}"
                )
        if not abs(self.start) <= LARGEST:
            raise CaseError(f"--start: must be a number up to {LARGEST:g}; got {self.start:g}")

    @property
    def words(self) -> list[str]:
        """The options of the command line that are not the defaults."""
        changed = {k: v for k, v in vars(self).items() if v != getattr(ImportOptions, k)}
        texts = {k: "" if value is True else f"={value}" for k, value in changed.items()}
        return [f"--{name.replace('_', '-')}{text}" for name, text in texts.items()]

    @property
    def scales(self) -> dict[str, float]:
        """The unit of each quantity in SI units. Raises CaseError for an unknown unit."""
        scales = dict.fromkeys(UNITS, 1.0)
        for part in filter(None, self.units.split(",")):
            quantity, _, unit = part.partition("=")
            try:
                units = UNITS[quantity]
                scales[quantity] = units[unit] if unit in units else float(unit)
            except (KeyError, ValueError):
                scales[quantity] = math.nan
            if not 1.0 / LARGEST <= scales[quantity] <= LARGEST:
                allowed = "; ".join(f"{name}={', '.join(units)}" for name, units in UNITS.items())
                raise CaseError(
                    f"--units: must be a number from {1.0 / LARGEST:g} to {LARGEST:g}, or one "
                    f"of {allowed}; got {part!r}"
                )
        return scales

    def fitting(self, quantity: str, factor: float) -> str:
        """Return advice on a unit that is about `factor` times the chosen one, if there is one."""
        units = {u: scale / self.scales[quantity] / factor for u, scale in UNITS[quantity].items()}
        unit = min(units, key=lambda u: abs(math.log(units[u])))
        fits = 0.2 < units[unit] < 5.0 and not 0.2 < factor * units[unit] < 5.0
        return f"; {quantity}={unit} of --units would fit" if fits else ""


NUMBERS = {2: "two", 3: "three"}
"""Numbers of components in words."""


def component_fields(option: str, text: str, n_dim: int) -> tuple[str, ...]:
    """Return the fields of a vector's components. Raises CaseError unless there are n_dim."""
    parts = tuple(part.strip() for part in text.split(","))
    if len(parts) != n_dim or not all(parts):
        like = ",".join("abc"[:n_dim])
        raise CaseError(f"--{option}: must be {NUMBERS[n_dim]} names, like {like}; got {text!r}")
    return parts


def place(option: str, text: str, n_dim: int) -> tuple[float, ...]:
    """Return the coordinates in an option. Raises CaseError unless they are n_dim numbers."""
    try:
        coordinates = tuple(map(float, text.split(",")))
        if len(coordinates) != n_dim or not all(abs(x) <= LARGEST for x in coordinates):
            raise ValueError("is no place")  # also NaN
    except ValueError as error:
        like = ",".join(("0.5",) * n_dim)
        raise CaseError(
            f"--{option}: must be {NUMBERS[n_dim]} numbers up to {LARGEST:g}, like {like}; got "
            f"{text!r}"
        ) from error
    return coordinates
