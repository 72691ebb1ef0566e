"""The sections of a case file for the full model, bases, reduced models and their comparison.

`sphrom.case.study_sections` has those of studies, `sphrom.case.scenes` the scenes and defaults.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from sphrom.case.fields import (
    Coordinate,
    Duration,
    Flag,
    Number,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.case.points import REYNOLDS, Interval, ReynoldsValues
from sphrom.case.study_sections import FigureSection
from sphrom.sph.walls.kinds import KINDS
from sphrom.text import exact, repeated


class FluidSection(Section):
    """The fluid, and the scales of its weak compressibility."""

    reference_density: Positive = key(1000.0, "density at zero pressure", unit="kg/m3")
    reference_speed: Positive = key(1.0, "largest speed of the flow, U_max", unit="m/s")
    mach_number: Number = key(
        0.1,
        "U_max over the speed of sound; a large body force or friction raises the speed of sound "
        "above this ratio. A flow is weakly compressible up to 0.3",
        unit="-",
        ge=1e-3,
        le=0.3,
    )


class PackingSection(Section):
    """The packing of particles before the run."""

    seed: Whole = key(0, "seed of the random start", ge=0, le=2**32 - 1)
    tolerance: Number = key(
        1e-3, "unevenness of the particles at which the packing stops", unit="-", ge=1e-12, le=1.0
    )


class ShiftingSection(Section):
    """Particle shifting inside the equations (Eq. 2.13-2.14)."""

    enabled: Flag = key(True, "whether to shift particles")
    amplitude: Number = key(
        1.0, "chi of Eq. 2.14; the paper uses 0.2, with more noise", unit="-", ge=0.0, le=10.0
    )
    form: Literal["sun", "paper"] = key(
        "sun", "bracket of Eq. 2.14, with xi = 4: as in Sun et al. 2017, or as printed"
    )
    transport: Literal["advective", "paper"] = key(
        "advective",
        "advection by the shifting velocity in Eq. 2.6-2.7: consistent terms, which vanish "
        "for uniform fields, or the terms as printed",
    )


if TYPE_CHECKING:
    WallKindName = str
else:
    WallKindName = Literal[tuple(KINDS)]

EARLIER_KEYS: Mapping[str, tuple[str, str]] = {
    "adjoint": ("linear", "adjoint"),
    "normal": ("linear", "normal"),
    "adami": ("whole", "normal"),
    "adami-as-fluid": ("whole", "paper"),
    "printed": ("paper", "paper"),
    "printed-normal": ("paper", "normal"),
}
"""The values of the earlier keys `no_slip` and `continuity`, by the kind of walls that replaces
them."""


class WallSection(Section):
    """The fields of the ghost particles of walls (Eq. 2.15-2.16)."""

    kind: WallKindName = key(
        "mirrored",
        "rule of walls: " + "; ".join(f"{name}, {kind.meaning}" for name, kind in KINDS.items()),
    )
    layers: Annotated[Whole, Field(ge=1, le=32)] | None = key(
        None, "layers of ghosts; null means as many as the kernel reaches"
    )

    @model_validator(mode="before")
    @classmethod
    def _of_earlier_keys(cls, values: Any) -> Any:
        """Replace the keys `no_slip` and `continuity` of earlier versions by the kind."""
        earlier = ("no_slip", "continuity")
        if not isinstance(values, Mapping) or values.keys().isdisjoint(earlier):
            return values
        given = dict(values)
        # A given key changes one of the two that the kind stands for.
        usual = EARLIER_KEYS.get(str(given.pop("kind", "adjoint")), ("", ""))
        wanted = tuple(map(given.pop, earlier, usual))
        for kind, meant in EARLIER_KEYS.items():
            if meant == wanted:
                return {**given, "kind": kind}
        reason = "no rule of walls has no_slip: {} with continuity: {}".format(*wanted)
        raise ValueError(f"{reason}; set kind to one of {', '.join(KINDS)}")


class DiscretizationSection(Section):
    """The discretisation of the fluid into particles."""

    resolution: Whole = key(
        100,
        "particles along the scene's length, for the open cavity the length of the channel",
        ge=8,
        le=100_000,
    )
    smoothing_length_ratio: Number = key(
        4.0, "smoothing length over particle spacing, h/dx", unit="-", ge=1.2, le=8.0
    )
    diffusion_coefficient: Number = key(
        0.1, "delta of the density diffusion (Eq. 2.6)", unit="-", ge=0.0, le=1.0
    )
    acoustic_damping: Number = key(
        1.0,
        "alpha of the acoustic damper, a bulk viscosity of alpha h c0 (Sun et al. 2023); 0 "
        "as in the paper switches it off",
        unit="-",
        ge=0.0,
        le=10.0,
    )
    viscosity: Literal["laplacian", "paper"] = key(
        "laplacian", "viscous operator: the Laplacian of the velocity, or Eq. 2.12 as printed"
    )
    initial_particles: Literal["auto", "packed", "lattice"] = key(
        "auto",
        "initial positions: packed, or on a lattice, which fits walls along the axes but "
        "adds noise when it breaks up; auto means lattice in scenes whose walls all follow "
        "the axes, else packed",
    )
    packing: PackingSection = key(PackingSection(), "packing of particles before the run")
    fixed_volume: Flag = key(
        True,
        "whether to subtract the mean of the continuity equation, so that the total volume "
        "is conserved",
    )
    pair_precision: Literal["float64", "float32"] = key(
        "float64",
        "precision of sums over pairs of particles: double, or single, which is faster; the state "
        "is always double",
    )
    shifting: ShiftingSection = key(ShiftingSection(), "particle shifting (Eq. 2.13-2.14)")
    walls: WallSection = key(WallSection(), "ghost particles, where the scene has walls")


class TimeSection(Section):
    """The duration and the time step of full runs."""

    spin_up: Duration = key(
        0.0, "time at which recording starts, after the flow has developed", unit="s"
    )
    final_time: Positive = key(1.0, "time at which runs end", unit="s")
    step: Positive | Literal["auto"] = key(
        "auto", "time step; auto derives it from the Courant number and the other limits", unit="s"
    )
    # Up to the limit, errors against exact and independent solutions hardly depend on it.
    courant_number: Number = key(
        1.2,
        "c0 dt / h of the automatic step, at most 1.5 (Eq. 2.19); the step uses the same share of "
        "the other limits",
        unit="-",
        ge=1e-6,
        le=1.5,
    )

    @model_validator(mode="after")
    def _rising(self) -> TimeSection:
        if self.spin_up >= self.final_time:
            begin = exact(self.spin_up)
            end = exact(self.final_time)
            raise ValueError(f"final_time: must be after time.spin_up, {begin} s; got {end}")
        return self


class SnapshotSection(Section):
    """The snapshots to store."""

    every: Whole = key(10, "number of steps between snapshots", ge=1, le=1_000_000_000)


class ReferenceSection(Section):
    """The reference space that snapshots are mapped onto (Eq. 3.13-3.15)."""

    points: Literal["initial", "relaxed", "lattice"] = key(
        "initial", "reference points: the initial particles, relaxed ones, or a lattice"
    )
    method: Literal["mls", "shepard"] = key(
        "mls", "second-order moving least squares, or the Shepard filter of Eq. 3.15"
    )
    smoothing_length_ratio: Annotated[Number, Field(ge=1.2, le=8.0)] | None = key(
        None,
        "smoothing length of the map over the spacing; null is 2 for mls, and that of the "
        "discretization for shepard",
        unit="-",
    )


class SubsetSection(Section):
    """A basis of some of the training runs."""

    reynolds: ReynoldsValues | None = key(
        None, "Reynolds numbers of its training runs; required without a box", unit="-"
    )
    interval: Interval | None = key(
        None,
        "half-open interval [low, high) of Reynolds numbers in which it is the local basis; null "
        "is the range of its training runs. With equal ends, it is never local",
        unit="-",
    )
    box: dict[SafeName, Interval] | None = key(
        None,
        "ranges of parameters, instead of reynolds and interval: its training runs are those in "
        "the box, in which it is the local basis",
    )

    @model_validator(mode="after")
    def _one_way(self) -> SubsetSection:
        if (self.reynolds is None) == (self.box is None):
            raise ValueError("give either reynolds, the values of training runs, or a box")
        if self.box is not None and self.interval is not None:
            raise ValueError("interval: can't be combined with a box, which has its own ranges")
        for label in repeated(map(exact, self.reynolds or ())):
            raise ValueError(f"reynolds: reynolds={label} is listed more than once")
        return self

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """The ends of its intervals by parameter; other parameters are not bounded."""
        if self.box is not None:
            return {name: (low, high) for name, (low, high) in self.box.items()}
        values = self.interval or self.reynolds or (0.0,)
        return {REYNOLDS: (min(values), max(values))}


class BasisSection(Section):
    """The trial basis (Eq. 3.16)."""

    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | None = key(
        None, "number of modes to keep; null means as many as the reduced models use"
    )
    inner_product: Literal["acoustic", "raw"] = key(
        "acoustic",
        "inner product of states: acoustic energy, which makes the reduced model stable, or "
        "the dot product of raw values",
    )
    mean_density: Literal["auto", "in-modes", "separate"] = key(
        "auto",
        "the spatial mean of the density: part of the modes, or a variable of its own; auto "
        "means separate if the product is acoustic and the volume is fixed or walls enclose "
        "the fluid",
    )
    lagrangian: Flag = key(False, "whether to store also the singular values of unmapped snapshots")
    subsets: dict[SafeName, SubsetSection] = key(
        {}, "further bases by name, each of some training runs; the basis `all` always exists"
    )


class SplineSection(Section):
    """Splines of the modes (Eq. 3.17-3.20)."""

    kind: Literal["auto", "polyharmonic", "b-spline"] = key(
        "auto",
        "local polyharmonic splines, or tensor-product cubic B-splines, which are faster; auto "
        "means b-spline if the reference points are a lattice and fluid fills the scene's box, "
        "else polyharmonic",
    )
    order: Whole = key(3, "k of Eq. 3.18, for kind: polyharmonic", ge=1, le=7)
    polynomial_degree: Whole = key(
        1, "degree of the polynomial part, for kind: polyharmonic", ge=0, le=3
    )


class OperatorSection(Section):
    """The projected operators of models on the reference points."""

    error_estimate: Flag | Literal["auto"] = key(
        "auto",
        "whether to store the data for error estimates; auto stores them for bases of at most 30 "
        "modes",
    )


class CompareSection(Section):
    """The comparison of reduced and full runs (Eq. 4.1-4.3)."""

    line: Coordinate | None = key(
        None,
        "x of the vertical line on which runs are compared; null is the middle of the scene, or "
        "five eighths of the open cavity's channel",
        unit="m",
    )
    line_points: Whole = key(101, "number of points on that line", ge=2, le=100_000)
    grid: Whole = key(
        50,
        "grid points along the longer side of the scene's box, for fields; a "
        "three-dimensional grid has fewer along each side, so that a cube has about as many "
        "points in all as a square",
        ge=2,
        le=2_000,
    )
    exact: Flag = key(True, "whether to compare with the exact solution, in scenes that have one")
    plots: Flag | None = key(
        None,
        "whether to draw figures; null draws the four most telling ones, and `sphrom report` the "
        "others",
    )
    from_time: Duration = key(0.0, "time from which errors are computed", unit="s")
    figures: tuple[FigureSection, ...] = key(
        (), "figures that `sphrom figures` draws, besides those of `sphrom compare`"
    )
