"""The sections of a case file for the discretisation and the run of its full model."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sphrom.case.fields import Duration, Flag, Number, Positive, Section, Whole, key
from sphrom.text import exact


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
        1e-3, "unevenness of particles at which packing stops", unit="-", ge=1e-12, le=1.0
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
        "advection by shifting in Eq. 2.6-2.7: differences to neighbours with a particle's own "
        "shifting velocity, or the terms as printed",
    )


class WallSection(Section):
    """The fields of the ghost particles of walls (Eq. 2.15-2.16)."""

    no_slip: Literal["linear", "whole", "paper"] = key(
        "linear",
        "velocity of ghosts: linear, extrapolated from each particle through the wall (Morris et "
        "al. 1997); whole, 2 U_wall - u of the interpolated velocity u (Adami et al. 2012); paper, "
        "u with its tangential part reversed, as printed",
    )
    continuity: Literal["adjoint", "normal", "paper"] = key(
        "adjoint",
        "walls in continuity: adjoint, minus the transpose of their pressure force; normal, the "
        "normal part of ghosts' velocities only; paper, ghosts count like fluid",
    )
    layers: Annotated[Whole, Field(ge=1, le=32)] | None = key(
        None, "layers of ghosts; null means as many as the kernel reaches"
    )


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
        "alpha of the acoustic damper, a bulk viscosity of alpha h c0 (Sun et al. 2023); the paper "
        "has none, 0",
        unit="-",
        ge=0.0,
        le=10.0,
    )
    viscosity: Literal["laplacian", "paper"] = key(
        "laplacian", "viscous operator: the Laplacian of the velocity, or Eq. 2.12 as printed"
    )
    initial_particles: Literal["auto", "packed", "lattice"] = key(
        "auto",
        "initial positions: packed, or on a lattice, which fits walls along the axes but breaks up "
        "with noise; auto means lattice in scenes with walls along the axes only, else packed",
    )
    packing: PackingSection = key(PackingSection(), "packing of particles before the run")
    fixed_volume: Flag = key(
        True, "whether to subtract the mean of continuity, so that the total volume is conserved"
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
            begin, end = exact(self.spin_up), exact(self.final_time)
            raise ValueError(f"final_time: must be after time.spin_up, {begin} s; got {end}")
        return self


class SnapshotSection(Section):
    """The snapshots to store."""

    every: Whole = key(10, "number of steps between snapshots", ge=1, le=1_000_000_000)
