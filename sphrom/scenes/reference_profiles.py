"""Profiles of incompressible reference solutions, by scene and Reynolds number.

They are dimensionless: lengths over the scene's reference length, velocities over its reference
speed U, pressures over rho U^2, times over length / U. Sources and accuracy stand in
`reference_data/README.md`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Quantity = Literal["u", "v", "p"]
Axis = Literal["x", "y"]
Datum = Literal["centre", "mean"]

REYNOLDS_TOLERANCE = 1e-6
"""How far, relatively, a Reynolds number may be from that of a reference."""


OPEN_CAVITY_SPEED = 2.0
"""The reference speed that the open cavity's reference is for [m/s]."""


@dataclass(frozen=True)
class ReferenceProfile:
    """One quantity along a line, both dimensionless."""

    quantity: Quantity
    axis: Axis
    """The axis that the line follows."""
    offset: float
    """Where the line crosses the other axis."""
    coordinate: Array
    """(n_points,) along the axis."""
    value: Array
    """(n_points,)"""
    reynolds: float
    time: float | None
    """Since the start from rest; None for a steady flow, or an average over time."""
    averaged: bool
    """Whether it is an average over time."""
    datum: Datum
    """Where the pressure is zero: at the domain's centre, or in the mean over it."""
    source: str

    @property
    def name(self) -> str:
        """How tables and plots call it, such as `u along y`."""
        return f"{self.quantity} along {self.axis}"


@dataclass(frozen=True)
class _File:
    """What the rows of one file have in common."""

    name: str
    kind: str
    lid: str | None
    source: str
    datum: Datum = "centre"
    offset: float = 0.5
    averaged: bool = False


FILES = (
    _File("uniform_lid", "lid-driven-cavity", "uniform", "Legendre-Galerkin"),
    _File("ghia", "lid-driven-cavity", "uniform", "Ghia et al. 1982"),
    _File("regularised_lid", "lid-driven-cavity", "regularised", "Legendre-Galerkin"),
    _File(
        "regularised_lid_transient",
        "lid-driven-cavity",
        "regularised",
        "Legendre-Galerkin",
        datum="mean",
    ),
    _File(
        "open_cavity_mean", "open-cavity", None, "finite differences", offset=1.25, averaged=True
    ),
)


def profiles_for(kind: str, lid: str | None, reynolds: float) -> tuple[ReferenceProfile, ...]:
    """Return what is known of a scene at a Reynolds number; nothing where nothing is.

    `kind` is the scene's, `lid` that of a driven cavity. Transient profiles are of the flow that
    starts impulsively from rest; the open cavity's is of the flow that the scene's defaults drive.
    """
    return tuple(
        profile
        for file in FILES
        if (file.kind, file.lid) == (kind, lid)
        for profile in _read(file)
        if math.isclose(profile.reynolds, reynolds, rel_tol=REYNOLDS_TOLERANCE)
    )


@cache
def _read(file: _File) -> tuple[ReferenceProfile, ...]:
    return tuple(_profiles(file))


def _profiles(file: _File) -> Iterator[ReferenceProfile]:
    rows: dict[tuple[float, float | None, str], list[tuple[float, float]]] = {}
    folder = resources.files("sphrom.scenes") / "reference_data"
    text = (folder / f"{file.name}.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(text.splitlines()):
        time = float(row["time"]) if "time" in row else None
        points = rows.setdefault((float(row["re"]), time, row["axis"]), [])
        points.append((float(row["coord"]), float(row["value"])))
    for (reynolds, time, along), points in rows.items():
        quantity, axis = _parts(along)
        coordinate, value = np.array(sorted(points)).T
        yield ReferenceProfile(
            quantity,
            axis,
            file.offset,
            coordinate,
            value,
            reynolds,
            time,
            file.averaged,
            file.datum,
            file.source,
        )


def _parts(along: str) -> tuple[Quantity, Axis]:
    """Return quantity and axis of a name such as `u_along_y`."""
    names: dict[str, tuple[Quantity, Axis]] = {
        "u_along_y": ("u", "y"),
        "v_along_x": ("v", "x"),
        "p_along_y": ("p", "y"),
    }
    return names[along]
