"""Snapshots of another program in the units and the frame of a case, checked.

Of density and pressure one is read, and the other follows by the state equation (Eq. 2.8).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.foreign_files import ForeignSnapshot
from sphrom.case.models import Case
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.meaning import UNITS, Meaning
from sphrom.sph import state_equation
from sphrom.sph.time_loop import DENSITY_LIMIT, Snapshot

Array = NDArray[np.float64]

FLUCTUATION = "density_fluctuation"
"""The field of files that this program exported: density less its reference value."""
ROUNDING = 1e-6
"""A third component of velocity up to this share of the largest speed is none."""
COUNT_TOLERANCE = 0.05
"""How far the number of particles may be from the case's, relatively: edges are filled in many
ways, but each particle has to stand for about the same area."""


def fitting_resolution(case: Case, n_found: int) -> int | None:
    """Return the resolution at which a case has about `n_found` particles; None if it has now."""
    expected = case.plan.n_particles
    limit = 0.0 if _is_exact(case) else COUNT_TOLERANCE
    if abs(n_found - expected) <= limit * expected:
        return None
    return round(case.discretization.resolution * (n_found / expected) ** 0.5)


def _is_exact(case: Case) -> bool:
    """Whether a case needs the very number of particles."""
    return case.basis.lagrangian


class Converter:
    """Converts snapshots of files into the case's units and frame; keeps their extremes."""

    def __init__(self, case: Case, meaning: Meaning, first: ForeignSnapshot) -> None:
        self._case = case
        self._domain = case.scene.domain
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
        if (fitting := fitting_resolution(self._case, self.n_particles)) is not None:
            raise CaseError(
                f"discretization.resolution: the case has {self._case.plan.n_particles} particles, "
                f"{self._first.path} has {self.n_particles}: "
                f"--set discretization.resolution={fitting} is nearest"
                + (", and basis.lagrangian needs the very number" if _is_exact(self._case) else "")
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
        if (depth := self._span(given, third)) <= 0.5 * self._case.plan.particle_spacing:
            return
        advice = "cases are two-dimensional"
        for flat, other in (tuple(self._position), tuple(self._position)[::-1]):
            if self._span(given, flat) <= 0.5 * self._case.plan.particle_spacing:
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
        return state_equation.density_fluctuation(pressure, self._case.plan.sound_speed)

    def _check_fluctuation(self, given: ForeignSnapshot, fluctuation: Array) -> None:
        largest = float(np.abs(fluctuation).max()) / self._case.fluid.reference_density
        self.largest_fluctuation = max(self.largest_fluctuation, largest)
        if largest > DENSITY_LIMIT:
            raise CaseError(
                f"{given.path}: |rho - rho_0| / rho_0 is {largest:.3g}, of a weakly compressible "
                f"flow at most {DENSITY_LIMIT:g}: check --density-unit or --pressure-unit, "
                "fluid.reference_density and fluid.mach_number"
            )
