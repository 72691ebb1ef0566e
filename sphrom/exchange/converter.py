"""Snapshots of another program in the units and the frame of a case, checked.

Of density and pressure one is read, and the other follows by the state equation (Eq. 2.8).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.foreign_files import COMPONENTS, ForeignSnapshot
from sphrom.exchange.meaning import Meaning
from sphrom.sph import state_equation
from sphrom.sph.time_loop import DENSITY_LIMIT, Snapshot

Array = NDArray[np.float64]

VELOCITIES = (("u", "v", "w"), ("velocity.x", "velocity.y", "velocity.z"))
"""The names of velocities that are looked for unless --velocity names others."""
FLUCTUATION = "density_fluctuation"
"""The field of files that this program exported: density less its reference value."""
ROUNDING = 1e-6
"""A third component of velocity up to this share of the largest speed is none."""
COUNT_TOLERANCE = 0.05
"""How far the number of particles may be from the case's, relatively: edges are filled in many
ways, but each particle has to stand for about the same area."""


@dataclass(frozen=True)
class Components:
    """The names of the fields of a vector: two in the plane of the flow, and one across it."""

    names: tuple[str, str]
    third: str | None = None
    chosen: bool = False
    """Whether the two were named one by one."""

    @classmethod
    def of(
        cls, option: str, text: str, fields: Collection[str], plane: tuple[int, int, int]
    ) -> Components:
        """Return the components of a vector, or two fields, that an option names.

        The axes of the plane and the axis across it are those of a vector.
        """
        names = [name.strip() for name in text.split(",")]
        if not all(names) or len(names) > 2:
            raise CaseError(
                f"--{option}: must be one vector, or two fields like a,b in the plane of the flow; "
                f"got {text!r}"
            )
        if len(names) == 1:
            return cls.in_plane(_components(names[0]), plane)
        vectors = {name.rpartition(".")[0] for name in names} - {""}
        families = [COMPONENTS, *VELOCITIES, *map(_components, vectors)]
        others = (set(family) - set(names) for family in families)
        thirds = [other for other in others if len(other) == 1 and other <= set(fields)]
        return cls((names[0], names[1]), thirds[0].pop() if thirds else None, chosen=True)

    @classmethod
    def in_plane(cls, family: tuple[str, ...], plane: tuple[int, int, int]) -> Components:
        """Return three components, those in the plane first."""
        first, second, third = (family[axis] for axis in plane)
        return cls((first, second), third)

    @property
    def plane(self) -> tuple[int, int, int]:
        """The axes x, y, z of the two names and of the third, as far as the names tell."""
        first, second = (COMPONENTS.index(n[-1]) if n[-1] in COMPONENTS else -1 for n in self.names)
        if -1 in (first, second) or first == second:
            return 0, 1, 2
        return first, second, 3 - first - second


def _components(vector: str) -> tuple[str, ...]:
    return tuple(f"{vector}.{component}" for component in COMPONENTS)


def fitting_resolution(case: Case, n_found: int) -> int | None:
    """Return the resolution at which a case has about `n_found` particles; None if it has now."""
    expected = case.plan.n_particles
    # Lagrangian bases need the very number of particles.
    limit = 0.0 if case.basis.lagrangian else COUNT_TOLERANCE
    if abs(n_found - expected) <= limit * expected:
        return None
    return round(case.discretization.resolution * (n_found / expected) ** 0.5)


class Converter:
    """Converts snapshots of files into the case's units and frame; keeps their extremes."""

    def __init__(self, case: Case, meaning: Meaning, first: ForeignSnapshot) -> None:
        self._case = case
        self._domain = case.scene.domain
        self._meaning = meaning
        self._first = first
        self._position = Components.of("position", meaning.position, first.fields, (0, 1, 2))
        plane = self._position.plane
        if meaning.velocity is None:
            known = next((n for n in VELOCITIES if n[0] in first.fields), VELOCITIES[0])
            self._velocity = Components.in_plane(known, plane)
        else:
            self._velocity = Components.of("velocity", meaning.velocity, first.fields, plane)
        self._origin = meaning.origin_place
        self._scales = meaning.scales
        self.n_particles = len(self._at(first, self._position.names[0]))
        self.largest_speed = 0.0
        self.largest_fluctuation = 0.0
        self.largest_left_out = 0.0
        if (fitting := fitting_resolution(case, self.n_particles)) is not None:
            raise CaseError(
                f"discretization.resolution: the case has {case.plan.n_particles} particles, "
                f"{first.path} has {self.n_particles}: "
                f"--set discretization.resolution={fitting} is nearest"
                + (", and basis.lagrangian needs the very number" * case.basis.lagrangian)
            )

    @property
    def left_out(self) -> str | None:
        """The component of velocity that is left out, in words; None where none is."""
        if self.largest_left_out <= ROUNDING * self.largest_speed:
            return None
        return (
            f"{self._velocity.third}, up to {self.largest_left_out:.4g} m/s, is left out: the flow "
            f"is taken as two-dimensional, in {' and '.join(self._velocity.names)}"
        )

    def __call__(self, given: ForeignSnapshot) -> Snapshot:
        """Return a snapshot in SI units and the scene's frame, its particles in the box.

        Raises CaseError or ArtifactError where it does not fit the case or the first one.
        """
        order = self._order(given)
        position = self._place(given, order)
        velocity = np.stack([given.field(n, "--velocity")[order] for n in self._velocity.names])
        velocity = velocity * self._scales["velocity"]
        fluctuation = self._fluctuation(given)[order]
        self.largest_speed = max(self.largest_speed, float(np.hypot(*velocity).max()))
        self._check_third_velocity(given)
        return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)

    def _at(self, given: ForeignSnapshot, name: str) -> Array:
        return given.field(name, "--position")

    def _check_third_velocity(self, given: ForeignSnapshot) -> None:
        """Raise CaseError where velocities leave the plane, unless its components were named."""
        third = self._velocity.third
        if third is None or third not in given.fields:
            return
        largest = float(np.abs(given.fields[third]).max()) * self._scales["velocity"]
        self.largest_left_out = max(self.largest_left_out, largest)
        if not self._velocity.chosen and self.left_out is not None:
            raise CaseError(
                f"{given.path}: is three-dimensional: {third} is up to {largest:.4g} m/s; cases "
                f"are two-dimensional: --velocity {','.join(self._velocity.names)} takes these two "
                f"and leaves {third} out"
            )

    def _order(self, given: ForeignSnapshot) -> NDArray[np.intp]:
        """Return the order in which particles are the same ones in all files."""
        n_found = len(self._at(given, self._position.names[0]))
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
        columns = [self._at(given, name)[order] for name in self._position.names]
        position = self._domain.wrap(
            (np.stack(columns, axis=1) - self._origin) * self._scales["length"]
        )
        outside = np.flatnonzero(~self._domain.contains(position))
        if outside.size:
            low, high, lower, upper = (
                f"({x:.6g}, {y:.6g})"
                for x, y in (*_extremes(position), self._domain.lower, self._domain.upper)
            )
            x, y = position[outside[0]]
            raise CaseError(
                f"{given.path}: {outside.size} particles are outside the scene, such as one at "
                f"({x:.6g}, {y:.6g}) m; they span {low} to {high} m, the scene {lower} to {upper} "
                "m: check --units, --origin, --array and the scene's size"
            )
        return position

    def _check_flat(self, given: ForeignSnapshot) -> None:
        """Raise CaseError when particles differ in a third coordinate."""
        third = self._position.third
        limit = 0.5 * self._case.plan.particle_spacing
        if third is None or third not in given.fields or self._span(given, third) <= limit:
            return
        advice = "cases are two-dimensional"
        for flat, other in (self._position.names, self._position.names[::-1]):
            if self._span(given, flat) <= limit:
                plane = f"{other},{third}"
                advice = f"if {flat} is across the plane of the flow, --position {plane} names it"
        depth = self._span(given, third)
        raise CaseError(
            f"{given.path}: is three-dimensional: {third} spans {depth:.4g} m; {advice}"
        )

    def _span(self, given: ForeignSnapshot, name: str) -> float:
        return float(np.ptp(self._at(given, name))) * self._scales["length"]

    def _fluctuation(self, given: ForeignSnapshot) -> Array:
        """Return the density less its reference value (n_particles,) [kg/m3], checked."""
        reference = self._case.fluid.reference_density
        if self._meaning.pressure is None:
            name = self._meaning.density
            if name is None:
                name = FLUCTUATION if FLUCTUATION in given.fields else "rho"
            density = given.field(name, "--density, or use --pressure") * self._scales["density"]
            fluctuation = density - (0.0 if name == FLUCTUATION else reference)
        else:
            pressure = given.field(self._meaning.pressure, "--pressure") * self._scales["pressure"]
            if self._meaning.zero_mean_pressure:
                pressure = pressure - pressure.mean()
            fluctuation = state_equation.density_fluctuation(pressure, self._case.plan.sound_speed)
        largest = float(np.abs(fluctuation).max()) / reference
        self.largest_fluctuation = max(self.largest_fluctuation, largest)
        if largest > DENSITY_LIMIT:
            raise CaseError(
                f"{given.path}: |rho - rho_0| / rho_0 is {largest:.3g}, of a weakly compressible "
                f"flow at most {DENSITY_LIMIT:g}: check the density or pressure of --units, "
                "fluid.reference_density and fluid.mach_number"
            )
        return fluctuation


def _extremes(position: Array) -> tuple[Array, Array]:
    return position.min(axis=0), position.max(axis=0)
