"""Profiles of reference solutions, by scene and Reynolds number.

They are dimensionless: lengths over the scene's reference length, velocities over its reference
speed U, pressures over rho U^2, times over length / U. `reference_data/README.md` has the sources.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from sphrom.arrays import Array

REYNOLDS_TOLERANCE = 1e-6
"""Largest relative difference from the Reynolds number of a reference."""
OPEN_CAVITY_SPEED = 2.0
"""The speed [m/s] to which the open cavity's reference profiles are scaled."""


@dataclass(frozen=True)
class ReferenceProfile:
    """One quantity along a line, both dimensionless."""

    quantity: str
    """u, v or p."""
    axis: str
    """The axis that the line follows, x or y."""
    coordinate: Array
    """(n_points,) along the axis."""
    value: Array
    """(n_points,)"""
    reynolds: float
    time: float | None
    """Since the start from rest; None for a steady flow or a time average."""
    source: str
    offset: float = 0.5
    """Position of the line along the other axis."""
    averaged: bool = False
    """Whether it is a time average."""
    datum: str = "centre"
    """Reference of the pressure: zero at the domain's `centre`, or zero `mean`."""

    @property
    def name(self) -> str:
        """The name in tables and plots, such as `u along y`."""
        return f"{self.quantity} along {self.axis}"


FILES: dict[str, tuple[str, str | None, dict[str, Any]]] = {
    "uniform_lid": ("lid-driven-cavity", "uniform", {"source": "Legendre-Galerkin"}),
    "ghia": ("lid-driven-cavity", "uniform", {"source": "Ghia et al. 1982"}),
    "regularised_lid": ("lid-driven-cavity", "regularised", {"source": "Legendre-Galerkin"}),
    "regularised_lid_transient": (
        "lid-driven-cavity",
        "regularised",
        {"source": "Legendre-Galerkin", "datum": "mean"},
    ),
    "open_cavity_mean": (
        "open-cavity",
        None,
        {"source": "finite differences", "offset": 1.25, "averaged": True},
    ),
}
"""Kind of scene, kind of its lid, and properties shared by all profiles, by file name."""


def profiles_for(kind: str, lid: str | None, reynolds: float) -> tuple[ReferenceProfile, ...]:
    """Return the profiles for a scene at a Reynolds number; empty if there are none.

    `kind` is the kind of scene, `lid` that of a driven cavity's lid. Transient profiles are for an
    impulsive start from rest; those of the open cavity, for the scene's default force.
    """
    return tuple(
        profile
        for name, (*scene, _) in FILES.items()
        if scene == [kind, lid]
        for profile in _read(name)
        if math.isclose(profile.reynolds, reynolds, rel_tol=REYNOLDS_TOLERANCE)
    )


@cache
def _read(name: str) -> tuple[ReferenceProfile, ...]:
    rows: dict[tuple[str, float, float | None], list[tuple[float, float]]] = {}
    file = resources.files("sphrom.scenes") / "reference_data" / f"{name}.csv"
    for row in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
        time = float(row["time"]) if "time" in row else None
        points = rows.setdefault((row["axis"], float(row["re"]), time), [])
        points.append((float(row["coord"]), float(row["value"])))
    shared = FILES[name][-1]
    profiles = []
    for (along, reynolds, time), points in rows.items():  # such as `u_along_y`
        coordinate, value = np.array(sorted(points)).T
        profiles.append(
            ReferenceProfile(
                quantity=along[0],
                axis=along[-1],
                coordinate=coordinate,
                value=value,
                reynolds=reynolds,
                time=time,
                **shared,
            )
        )
    return tuple(profiles)
