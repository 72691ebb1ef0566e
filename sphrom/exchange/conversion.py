"""Other programs' fields in the units, the frame and with the particles of a case, checked.

Either density or pressure is read, and the other follows from the equation of state (Eq. 2.8).
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from sphrom.arrays import Array
from sphrom.case.loader import given_keys, load_case
from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.foreign_files import COMPONENTS, ForeignSnapshot, Source, read_foreign
from sphrom.exchange.import_options import ImportOptions, component_fields, place
from sphrom.exchange.instants import TIME_TOLERANCE, find_sources, interval, series
from sphrom.sph import fluid
from sphrom.sph.fluid import fluctuation_of
from sphrom.sph.time_loop import DENSITY_LIMIT, Snapshot

VELOCITIES = (("u", "v", "w"), ("velocity.x", "velocity.y", "velocity.z"))
"""Default names of the components of velocity."""
FLUCTUATION = "density_fluctuation"
"""Name of the density minus its reference value in files that this program exported."""
ROUNDING = 1e-6
"""Share of the largest speed up to which a third component of velocity counts as zero."""
MOST_SPEED = 5.0
"""Speed relative to that of the scene, above which the unit is probably wrong."""
MOST_EMPTY, EMPTY = 0.01, 2.0
"""Largest empty share of a three-dimensional box, and the distance from the nearest particle, in
spacings, at which a place counts as empty."""
COUNT_TOLERANCE = 0.05
"""Relative tolerance of the number of particles: programs fill edges differently."""


class Converter:
    """Reads and checks snapshots, converts them to the case's units and frame, keeps extremes."""

    def __init__(self, case: Case, options: ImportOptions, source: Source) -> None:
        self.options = options
        self._case = case
        self._first = first = read_foreign(source, options.array)
        n_dim = case.scene.domain.n_dim
        usual = next((names for names in VELOCITIES if names[0] in first.fields), VELOCITIES[0])
        position = options.position or ",".join(COMPONENTS[:n_dim])
        velocity = options.velocity or ",".join(usual[:n_dim])
        self._position = component_fields("position", position, n_dim)
        self._velocity = component_fields("velocity", velocity, n_dim)
        self._origin = place("origin", options.origin or ",".join("0" * n_dim), n_dim)
        self._scales = options.scales
        self.n_particles = first.n_particles
        self.largest_speed = self.largest_fluctuation = 0.0
        if (fitting := _fitting_resolution(case, self.n_particles)) is not None:
            raise CaseError(
                f"discretization.resolution: the case has {case.plan.n_particles} particles, "
                f"{first.path} has {self.n_particles}: "
                f"--set discretization.resolution={fitting} is nearest; --write-case FILE sets it"
                + (", and basis.lagrangian needs the exact number" * case.basis.lagrangian)
            )

    def __call__(self, source: Source) -> Snapshot:
        """Return a snapshot in SI units and the scene's frame, with its particles in the box.

        Raises CaseError or ArtifactError if it does not fit the case or the first snapshot.
        """
        foreign = read_foreign(source, self.options.array)
        order = self._order(foreign)
        velocity = np.stack([foreign.field(name, "--velocity")[order] for name in self._velocity])
        velocity = velocity * self._scales["velocity"]
        self.largest_speed = max(self.largest_speed, float(np.hypot.reduce(velocity, axis=0).max()))
        if len(self._position) == 2:
            self._require_flat(foreign)
        position = self._place(foreign)[order]
        scene = self._case.plan.max_speed
        largest = self.largest_speed
        is_fast = largest > MOST_SPEED * scene
        fitting = self.options.fitting("velocity", scene / largest) if is_fast else ""
        if fitting or largest > self._case.plan.sound_speed:
            raise CaseError(
                f"{foreign.path}: the largest speed is {largest:.4g} m/s, that of the scene is "
                f"about {scene:.4g} m/s (fluid.reference_speed){fitting}"
            )
        fluctuation = self._fluctuation(foreign)[order]
        return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)

    def _order(self, foreign: ForeignSnapshot) -> NDArray[np.intp]:
        """Return the order in which particles are the same in all files."""
        if foreign.n_particles != self.n_particles:
            raise ArtifactError(
                f"{foreign.path}: has {foreign.n_particles} particles, {self._first.path} has "
                f"{self.n_particles}; particles that enter or leave can't be imported"
            )
        if (name := self.options.sort_by) is None:
            return np.arange(self.n_particles)
        numbers = foreign.field(name, "--sort-by")
        firsts = self._first.field(name, "--sort-by")
        unique = np.unique(numbers)
        if len(unique) < self.n_particles or not np.array_equal(unique, np.sort(firsts)):
            raise ArtifactError(
                f"{foreign.path}: {name} (--sort-by) must be a unique number of each "
                "particle, the same in all files"
            )
        return np.argsort(numbers)

    def _place(self, foreign: ForeignSnapshot) -> Array:
        """Return positions (n_particles, n_dim) [m] in the scene, checked."""
        domain = self._case.scene.domain
        columns = [foreign.field(name, "--position") for name in self._position]
        position = (np.stack(columns, axis=1) - self._origin) * self._scales["length"]
        low = position.min(axis=0)
        high = position.max(axis=0)
        spacing = self._case.plan.particle_spacing
        # In lattices the fourth neighbour, in space the sixth, is one spacing away, and nearly so
        # if particles pair.
        n_near = 2 * domain.n_dim
        distance = float(np.median(KDTree(position).query(position, n_near + 1)[0][:, n_near]))
        position = domain.wrap(position)
        outside = int(np.sum(~domain.contains(position)))
        if outside or not 0.7 < distance / spacing < 1.9:
            fitting = self.options.fitting("length", spacing / (distance or spacing))
            beyond = f", and {outside} of them are outside of its fluid" if outside else ""
            raise CaseError(
                f"{foreign.path}: the particles span {_spans(low, high)}, with a spacing of "
                f"{distance:.3g} m; the scene spans {_spans(domain.lower, domain.upper)}, with a "
                f"spacing of {spacing:.3g} m{beyond}; check --units, --origin, --array and the "
                f"size of the scene{fitting}"
            )
        if domain.n_dim == 3:
            self._require_filled(foreign, position)
        return position

    def _require_filled(self, foreign: ForeignSnapshot, position: Array) -> None:
        """Raise CaseError unless particles (n_particles, 3) [m] fill the whole box."""
        spacing = self._case.plan.particle_spacing
        places = self._case.scene.domain.fill(spacing)
        empty = float(np.mean(KDTree(position).query(places)[0] > EMPTY * spacing))
        if empty > MOST_EMPTY:
            raise CaseError(
                f"{foreign.path}: {100.0 * empty:.2g} % of the box has no particles. In three "
                "dimensions fluid fills a box without solids; free surfaces, solids and bodies are "
                "not modelled. Name the particles of the fluid with --array, or choose scene.box "
                "so that they fill it"
            )

    def _require_flat(self, foreign: ForeignSnapshot) -> None:
        """Raise CaseError if points or velocities leave the plane; named components may."""
        third = _third(self._position, foreign.fields)
        depth = 0.0 if third is None else float(np.ptp(foreign.fields[third]))
        is_flat = depth * self._scales["length"] <= 0.5 * self._case.plan.particle_spacing
        if is_flat and self.options.velocity is None:
            third = _third(self._velocity, foreign.fields)
            depth = 0.0 if third is None else float(np.abs(foreign.fields[third]).max())
            is_flat = depth * self._scales["velocity"] <= ROUNDING * self.largest_speed
        if not is_flat:
            raise CaseError(
                f"{foreign.path}: is three-dimensional: {third} reaches {depth:.4g}; name the "
                "components in the plane of the flow with --position and --velocity"
            )

    def _fluctuation(self, foreign: ForeignSnapshot) -> Array:
        """Return the density minus its reference value (n_particles,) [kg/m3], checked."""
        reference = self._case.fluid.reference_density
        if self.options.pressure is None:
            usual = FLUCTUATION if FLUCTUATION in foreign.fields else "rho"
            name = self.options.density or usual
            density = foreign.field(name, "--density, or use --pressure") * self._scales["density"]
            fluctuation = density - (0.0 if name == FLUCTUATION else reference)
        else:
            pressure = foreign.field(self.options.pressure, "--pressure") * self._scales["pressure"]
            if self.options.zero_mean_pressure:
                pressure = pressure - pressure.mean()
            fluctuation = fluctuation_of(pressure, self._case.plan.sound_speed)
        largest = float(np.abs(fluctuation).max()) / reference
        self.largest_fluctuation = max(self.largest_fluctuation, largest)
        if largest > DENSITY_LIMIT:
            raise CaseError(
                f"{foreign.path}: |rho - rho_0| / rho_0 is {largest:.3g}, above the limit of "
                f"{DENSITY_LIMIT:g} for a weakly compressible flow; check the density or pressure "
                "of --units, fluid.reference_density and fluid.mach_number"
            )
        return fluctuation


def _spans(lower: Iterable[float], upper: Iterable[float]) -> str:
    """Return the ends of a box in words, axis by axis [m]."""
    ends = zip(lower, upper, strict=True)
    return " and ".join(f"{start:.6g} to {end:.6g} m" for start, end in ends)


def _third(names: tuple[str, ...], fields: Collection[str]) -> str | None:
    """Return the field of a vector's third component, given the names of two; None if missing."""
    vector = names[0].rpartition(".")[0]
    families = (COMPONENTS, ("u", "v", "w"), tuple(f"{vector}.{c}" for c in COMPONENTS))
    others = [set(family) - set(names) for family in families if set(names) <= set(family)]
    return next((name for other in others for name in other if name in fields), None)


def fitted_case(
    source: Path,
    overrides: Sequence[str],
    files: Sequence[Path],
    options: ImportOptions,
    into: Path,
) -> tuple[str, list[str]]:
    """Return the text of a case fitted to files, and the changed keys as `key=value`.

    The times change and, if the number of particles differs, the resolution. The time step is a
    whole fraction of the time between two snapshots, as stable as the case requires. Paths in the
    case are relative to the folder `into`.

    Raises CaseError when the case is not valid, or the files have fewer than two snapshots;
    ArtifactError when a file can't be read.
    """
    sources = find_sources(files, options)
    case = load_case(source, overrides)
    keys = list[str]()
    n_foreign = read_foreign(sources[0], options.array).n_particles
    if (resolution := _fitting_resolution(case, n_foreign)) is not None:
        keys.append(f"discretization.resolution={resolution}")
    if case.time.spin_up > 0.0:
        keys.append("time.spin_up=0")
    case = load_case(source, [*overrides, *keys])
    plan = case.plan
    between = interval(sources)
    limit = case.time.courant_number / fluid.COURANT_LIMIT * plan.limits.least
    every = max(1, math.ceil(between / limit))
    n = int(sources[-1].time / between + TIME_TOLERANCE)
    keys += [
        f"time.final_time={float(f'{between * n:.12g}')!r}",
        f"time.step={float(f'{between / every:.12g}')!r}",
        f"snapshots.every={every}",
    ]
    try:
        load_case(source, [*overrides, *keys])
    except CaseError as error:  # the user gave none of these keys
        reason = re.sub(r"^because of --set [^:]*: ", "", str(error))
        raise CaseError(f"fitted to {series(sources)}, the case is invalid: {reason}") from error
    text = dump_yaml(given_keys(source, [*overrides, *keys], into))
    return f"# {source.name}, fitted to {files[0].name} and others.\n{text}", keys


def _fitting_resolution(case: Case, n_particles: int) -> int | None:
    """Return the resolution for about so many particles; None if the case has as many already."""
    ratio = n_particles / case.plan.n_particles
    # Lagrangian bases need the exact number of particles.
    if abs(ratio - 1.0) <= (0.0 if case.basis.lagrangian else COUNT_TOLERANCE):
        return None
    return round(case.discretization.resolution * ratio ** (1.0 / case.scene.domain.n_dim))
