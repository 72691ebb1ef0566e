"""Snapshots of another program in the units and the frame of a case, checked.

Of density and pressure one is read, and the other follows by the state equation (Eq. 2.8).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.foreign_files import COMPONENTS, ForeignSnapshot
from sphrom.case.geometry import n_particles
from sphrom.case.models import Case
from sphrom.errors import ArtifactError, CaseError
from sphrom.setup import assembly
from sphrom.sph import state_equation
from sphrom.sph.time_loop import DENSITY_LIMIT, Snapshot

Array = NDArray[np.float64]

UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "density": {"kg/m3": 1.0, "g/cm3": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5},
}
"""Units in SI units, by quantity."""
FLUCTUATION = "density_fluctuation"
"""The field of files that this program exported: density less its reference value."""
VELOCITIES = (("u", "v", "w"), ("velocity.x", "velocity.y", "velocity.z"))
"""What velocities are called where --velocity doesn't tell, their third component at the end."""
PLANE = (0, 1, 2)
"""The axes of the plane of a flow, and the axis across it, where the options don't tell."""
ROUNDING = 1e-6
"""A third component of velocity up to this share of the largest speed is none."""
COUNT_TOLERANCE = 0.05
"""How far the number of particles may be from the case's, relatively: edges are filled in many
ways, but each particle has to stand for about the same area."""


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


class Converter:
    """Converts snapshots of files into the case's units and frame; keeps their extremes."""

    def __init__(self, case: Case, meaning: Meaning, first: ForeignSnapshot) -> None:
        self._case = case
        self._domain = assembly.domain(case)
        self._meaning = meaning
        self._first = first
        self._position = meaning.position_names(first)
        self._velocity = meaning.velocity_names(first, self._position)
        self._origin = meaning.origin_place
        self._scales = {quantity: meaning.scale(quantity) for quantity in UNITS}
        self.n_particles = len(first.field(self._position.first, "--position"))
        self.largest_speed = 0.0
        self.largest_fluctuation = 0.0
        self.largest_left_out = 0.0
        self._check_count()

    @property
    def left_out(self) -> str | None:
        """What of the velocities is left out, in words; None where nothing is."""
        if self.largest_left_out <= ROUNDING * self.largest_speed:
            return None
        return (
            f"{self._velocity.third}, up to {self.largest_left_out:.4g} m/s, is left out: the flow "
            f"is taken as two-dimensional, in {self._velocity.first} and {self._velocity.second}"
        )

    def __call__(self, given: ForeignSnapshot) -> Snapshot:
        """Return a snapshot in SI units and the scene's frame, its particles in the box.

        Raises CaseError or ArtifactError as `run` does.
        """
        order = self._order(given)
        position = self._place(given, order)
        velocity = np.stack([given.field(name, "--velocity")[order] for name in self._velocity])
        velocity = velocity * self._scales["velocity"]
        fluctuation = self._fluctuation(given)[order]
        self._check_fluctuation(given, fluctuation)
        self.largest_speed = max(self.largest_speed, float(np.hypot(*velocity).max()))
        self._check_plane(given)
        return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)

    def _check_plane(self, given: ForeignSnapshot) -> None:
        """Raise CaseError where velocities leave the plane, unless its components were named."""
        third = self._velocity.third
        if third is None or third not in given.fields:
            return
        largest = float(np.abs(given.fields[third]).max()) * self._scales["velocity"]
        self.largest_left_out = max(self.largest_left_out, largest)
        if not self._velocity.chosen and self.left_out is not None:
            raise CaseError(
                f"{given.path}: is three-dimensional: {third} is up to {largest:.4g} m/s; cases "
                f"are two-dimensional: --velocity {','.join(self._velocity)} takes these two and "
                f"leaves {third} out"
            )

    def _check_count(self) -> None:
        expected = n_particles(self._case)
        limit = 0.0 if self._case.basis.lagrangian else COUNT_TOLERANCE
        if abs(self.n_particles - expected) > limit * expected:
            fitting = self._case.discretization.resolution * (self.n_particles / expected) ** 0.5
            raise CaseError(
                f"discretization.resolution: the case has {expected} particles, {self._first.path} "
                f"has {self.n_particles}: --set discretization.resolution={fitting:.0f} is nearest"
                + (", and basis.lagrangian needs the very number" if limit == 0.0 else "")
            )

    def _order(self, given: ForeignSnapshot) -> NDArray[np.intp]:
        """Return the order in which particles are the same ones in all files."""
        n_found = len(given.field(self._position.first, "--position"))
        if n_found != self.n_particles:
            raise ArtifactError(
                f"{given.path}: holds {n_found} particles, {self._first.path} "
                f"{self.n_particles}: particles that enter or leave can't be imported"
            )
        if self._meaning.sort_by is None:
            return np.arange(n_found)
        numbers, firsts = (
            snapshot.field(self._meaning.sort_by, "--sort-by") for snapshot in (given, self._first)
        )
        unique = np.unique(numbers)
        if len(unique) < n_found or not np.array_equal(unique, np.sort(firsts)):
            raise ArtifactError(
                f"{given.path}: {self._meaning.sort_by} (--sort-by) does not give each particle a "
                "number of its own, the same in all files"
            )
        return np.argsort(numbers)

    def _place(self, given: ForeignSnapshot, order: NDArray[np.intp]) -> Array:
        """Return positions (n_particles, 2) [m] in the scene, checked."""
        self._check_flat(given)
        columns = [given.field(name, "--position")[order] for name in self._position]
        position = self._domain.wrap(
            (np.stack(columns, axis=1) - self._origin) * self._scales["length"]
        )
        outside = np.flatnonzero(~self._domain.contains(position))
        if outside.size:
            low, high, lower, upper = (
                f"({x:.6g}, {y:.6g})"
                for x, y in (
                    position.min(0),
                    position.max(0),
                    self._domain.lower,
                    self._domain.upper,
                )
            )
            x, y = position[outside[0]]
            raise CaseError(
                f"{given.path}: {outside.size} particles are outside the scene, such as one at "
                f"({x:.6g}, {y:.6g}) m; they span {low} to {high} m, the scene {lower} to {upper} "
                "m: check --length-unit, --origin, --array and the scene's size"
            )
        return position

    def _check_flat(self, given: ForeignSnapshot) -> None:
        """Raise CaseError when particles differ in a third coordinate."""
        third = self._position.third
        if third is None or third not in given.fields:
            return
        if (depth := self._span(given, third)) <= 0.5 * self._case.particle_spacing:
            return
        advice = "cases are two-dimensional"
        for flat, other in (tuple(self._position), tuple(self._position)[::-1]):
            if self._span(given, flat) <= 0.5 * self._case.particle_spacing:
                plane = f"{other},{third}"
                advice = f"if {flat} is across the plane of the flow, --position {plane} names it"
        raise CaseError(
            f"{given.path}: is three-dimensional: {third} spans {depth:.4g} m; {advice}"
        )

    def _span(self, given: ForeignSnapshot, name: str) -> float:
        return float(np.ptp(given.field(name, "--position"))) * self._scales["length"]

    def _fluctuation(self, given: ForeignSnapshot) -> Array:
        """Return the density less its reference value (n_particles,) [kg/m3]."""
        if self._meaning.pressure is None:
            name = self._meaning.density
            if name is None:
                name = FLUCTUATION if FLUCTUATION in given.fields else "rho"
            density = given.field(name, "--density, or use --pressure") * self._scales["density"]
            reference = 0.0 if name == FLUCTUATION else self._case.fluid.reference_density
            return density - reference
        pressure = given.field(self._meaning.pressure, "--pressure") * self._scales["pressure"]
        if self._meaning.zero_mean_pressure:
            pressure = pressure - pressure.mean()
        return state_equation.density_fluctuation(pressure, self._case.sound_speed)

    def _check_fluctuation(self, given: ForeignSnapshot, fluctuation: Array) -> None:
        largest = float(np.abs(fluctuation).max()) / self._case.fluid.reference_density
        self.largest_fluctuation = max(self.largest_fluctuation, largest)
        if largest > DENSITY_LIMIT:
            raise CaseError(
                f"{given.path}: |rho - rho_0| / rho_0 is {largest:.3g}, of a weakly compressible "
                f"flow at most {DENSITY_LIMIT:g}: check --density-unit or --pressure-unit, "
                "fluid.reference_density and fluid.mach_number"
            )
