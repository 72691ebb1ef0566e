"""The sections of a case file that say how its full model is discretised and run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sphrom.case.fields import Duration, Flag, Number, Positive, Section, Whole, key
from sphrom.text import exact


class FluidSection(Section):
    """The fluid, and the scales that make it weakly compressible."""

    reference_density: Positive = key(1000.0, "density at zero pressure", unit="kg/m3")
    reference_speed: Positive = key(1.0, "largest speed of the flow, U_max", unit="m/s")
    mach_number: Number = key(
        0.1,
        "U_max over the speed of sound, which it decides, unless the body force or friction asks "
        "for a higher one; up to 0.3 a flow is weakly compressible",
        unit="-",
        ge=1e-3,
        le=0.3,
    )


class PackingSection(Section):
    """How particles are packed before the run."""

    seed: Whole = key(0, "seed of the random start", ge=0, le=2**32 - 1)
    tolerance: Number = key(1e-3, "unevenness at which packing is done", unit="-", ge=1e-12, le=1.0)


class ShiftingSection(Section):
    """Particle shifting inside the equations (Eq. 2.13-2.14)."""

    enabled: Flag = key(True, "whether particles are shifted at all")
    amplitude: Number = key(
        1.0, "chi of Eq. 2.14; the paper's 0.2 leaves more noise", unit="-", ge=0.0, le=10.0
    )
    form: Literal["sun", "paper"] = key(
        "sun", "the bracket of Eq. 2.14, with xi = 4: after Sun et al. 2017, or as printed"
    )
    transport: Literal["advective", "paper"] = key(
        "advective",
        "what shifting carries in Eq. 2.6-2.7: differences from neighbours, by a particle's own "
        "shifting velocity, or the terms as printed",
    )


class WallSection(Section):
    """How the ghost particles of walls take their fields from the fluid (Eq. 2.15-2.16)."""

    no_slip: Literal["linear", "whole", "paper"] = key(
        "linear",
        "ghosts' velocity: extrapolated from each particle through the wall (Morris et al. 1997), "
        "or of the interpolated velocity u 2 U_wall - u as a whole vector (Adami et al. 2012), or "
        "the tangential part of u turned round, as printed",
    )
    continuity: Literal["adjoint", "normal", "paper"] = key(
        "adjoint",
        "walls in continuity: minus the transpose of their pressure force, or ghosts' velocities "
        "across the wall only, or those as if ghosts were fluid",
    )
    layers: Annotated[Whole, Field(ge=1, le=32)] | None = key(
        None, "layers of ghosts; null takes as many as the kernel reaches"
    )


class DiscretizationSection(Section):
    """How the fluid is cut into particles."""

    resolution: Whole = key(
        100,
        "particles along the scene's length, of the open cavity its channel's",
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
        "alpha of the acoustic damper, a bulk viscosity of alpha h c0 (Sun et al. 2023); 0 for "
        "none, as in the paper",
        unit="-",
        ge=0.0,
        le=10.0,
    )
    viscosity: Literal["laplacian", "paper"] = key(
        "laplacian", "viscous operator: the velocity's Laplacian, or Eq. 2.12 as printed"
    )
    initial_particles: Literal["auto", "packed", "lattice"] = key(
        "auto",
        "where particles start: packed, or on a lattice, which breaks up noisily, but fits walls "
        "along the axes; auto takes the lattice for these alone",
    )
    packing: PackingSection = key(PackingSection(), "how particles are packed before the run")
    fixed_volume: Flag = key(
        True, "whether the mean of continuity is taken out, so that volumes keep filling the domain"
    )
    shifting: ShiftingSection = key(ShiftingSection(), "particle shifting (Eq. 2.13-2.14)")
    walls: WallSection = key(WallSection(), "ghost particles, where the scene has walls")


class TimeSection(Section):
    """How long, and in which steps, the full model runs."""

    spin_up: Duration = key(
        0.0, "time before which nothing is recorded, while the flow develops", unit="s"
    )
    final_time: Positive = key(1.0, "time at which every run ends", unit="s")
    step: Positive | Literal["auto"] = key(
        "auto", "time step; auto takes it from the Courant number and the other limits", unit="s"
    )
    # Up to the limit, errors against exact and independent solutions hardly depend on it.
    courant_number: Number = key(
        1.2,
        "c0 dt / h of the automatic step, 1.5 at most (Eq. 2.19); it takes the same share of the "
        "other limits",
        unit="-",
        ge=1e-6,
        le=1.5,
    )

    @model_validator(mode="after")
    def _rising(self) -> TimeSection:
        if self.spin_up >= self.final_time:
            begin, end = exact(self.spin_up), exact(self.final_time)
            raise ValueError(f"final_time: must be after time.spin_up, {begin} s; got {end}")
        return self


class SnapshotSection(Section):
    """Which instants are kept."""

    every: Whole = key(10, "steps from one snapshot to the next", ge=1, le=1_000_000_000)
