"""The section `trade` of a case: the models that `sphrom trade` runs, times and compares."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sphrom.case.fields import Flag, Number, SafeName, Section, Whole, key

Modes = Annotated[Whole, Field(ge=1, le=10_000)]
Factor = Annotated[Number, Field(ge=0.01, le=100.0)]
Courant = Annotated[Number, Field(ge=1e-3, le=1.5)]
Resolution = Annotated[Whole, Field(ge=8, le=100_000)]
Mach = Annotated[Number, Field(ge=1e-3, le=0.3)]
SmoothingRatio = Annotated[Number, Field(ge=1.2, le=8.0)]


class ExtremeSection(Section):
    """The ranges of `sphrom trade --extremes`, whose models have the sizes that `trade` lists."""

    reynolds_factors: Annotated[tuple[Factor, ...], Field(min_length=1)] = key(
        (0.1, 0.3, 1.0, 3.0, 10.0),
        "Reynolds numbers: below 1 over the least that is trained, from 1 on over the greatest",
        unit="-",
    )
    mach_numbers: tuple[Mach, ...] = key(
        (0.02, 0.05, 0.1, 0.2, 0.3),
        "Mach numbers of full models to learn from; [] is none",
        unit="-",
    )
    smoothing_length_ratios: tuple[SmoothingRatio, ...] = key(
        (1.3, 1.5, 2.0, 3.0, 4.0),
        "h/dx of full models to learn from; [] is none",
        unit="-",
    )
    full_runs: Flag = key(
        True,
        "whether full runs are made where the case has none, at half the resolution: to compare "
        "with, and for other Mach numbers and h/dx; never for a case with a spin-up",
    )


class TradeSection(Section):
    """The models with operators that are weighed: every combination of the lists."""

    projections: Annotated[tuple[Literal["galerkin", "apg"], ...], Field(min_length=1)] | None = (
        key(
            None,
            "their projections; null is both, apg up to 20 modes and for the viscosity alone",
        )
    )
    n_modes: Annotated[tuple[Modes, ...], Field(min_length=1)] | None = key(
        None, "their modes; null is 2, 5, 10, 20, 50, as far as the basis goes, and all it has"
    )
    step_factors: Annotated[tuple[Factor, ...], Field(min_length=1)] = key(
        (1.0, 2.0), "their time steps over the automatic one", unit="-"
    )
    courant_numbers: tuple[Courant, ...] = key(
        (0.75, 1.5), "c0 dt / h of further full runs (Eq. 2.19)", unit="-"
    )
    resolutions: Annotated[tuple[Resolution, ...], Field(min_length=1)] | None = key(
        None, "resolutions of further full runs; null is the case's, and half of it where it fits"
    )
    probes: Literal["line", "field"] = key(
        "field", "place of the relative L2 error over points and time by which models are judged"
    )
    measure: SafeName | None = key(
        None,
        "a name of scene.measure: models are judged by the relative L2 error of this force, flow "
        "rate, or velocity and pressure, instead of the fields'",
    )
    repeats: Whole = key(5, "how often a run is timed; the least time counts", ge=1, le=1000)
    extremes: ExtremeSection = key(
        ExtremeSection(), "ranges of the map of stability, with --extremes"
    )
