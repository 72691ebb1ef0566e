"""The figures that a case asks for by name (`sphrom figures`), each of one kind."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sphrom.case.fields import Duration, Positive, SafeName, Section, Whole, key

FULL = "full"
"""What the full model is called among the runs of a figure."""
Quantity = Literal["speed", "pressure"]
Values = Annotated[tuple[Positive, ...], Field(min_length=1)]
Runs = Annotated[tuple[Annotated[tuple[SafeName, ...], Field(min_length=1)], ...],
                 Field(min_length=1)]  # fmt: skip
Modes = Annotated[tuple[Annotated[Whole, Field(ge=1, le=10_000)], ...], Field(min_length=1)]
_RUNS = "rows of panels, each a list of reduced models by name"
_VALUES = "Reynolds numbers; null is all at which the row's runs are made"


class _Figure(Section):
    """What all figures have."""

    name: SafeName = key(..., "name of its file")
    caption: str = key("", "what a page says below it")


class _OfRuns(_Figure):
    """A figure of runs."""

    runs: Runs = key(..., _RUNS)
    reynolds: Values | None = key(None, _VALUES, unit="-")
    quantities: Annotated[tuple[Quantity, ...], Field(min_length=1)] = key(
        ("speed", "pressure"), "a column of panels each"
    )


class FieldFigure(_OfRuns):
    """Fields at one instant: particles, or reference points, as they are."""

    kind: Literal["fields"] = key(..., "fields at an instant")
    runs: Runs = key(((FULL,),), f"{_RUNS}, or full")
    time: Duration = key(..., "the instant; the nearest snapshot is drawn", unit="s")


class LineFigure(_OfRuns):
    """Profiles along the line of comparison at one instant."""

    kind: Literal["lines"] = key(..., "profiles at an instant: full, exact and reduced together")
    time: Duration = key(..., "the instant; the nearest snapshot is drawn", unit="s")


class ErrorFigure(_OfRuns):
    """Errors over time by Eq. 4.1, on the line of comparison."""

    kind: Literal["errors"] = key(..., "Eq. 4.1 on the line, over time")
    range: Literal["line", "field"] = key(
        "line", "whether errors are over the range on the line or of the whole field"
    )


class SpectrumFigure(_Figure):
    """Singular values of one basis, and their shares."""

    kind: Literal["singular-values"] = key(..., "singular values and shares in both spaces")
    basis: SafeName = key("all", "which basis")
    modes: Modes = key(..., "numbers of modes whose shares are told")


class ModeFigure(_Figure):
    """One field of some modes, a row for each space."""

    kind: Literal["modes"] = key(..., "modes in both spaces")
    basis: SafeName = key("all", "which basis")
    modes: Modes = key(..., "which modes, from 1")
    field: Literal["density", "x-velocity", "y-velocity"] = key("density", "which part of them")


OfRuns = FieldFigure | LineFigure | ErrorFigure
OfModes = SpectrumFigure | ModeFigure
FigureSection = Annotated[
    OfRuns | OfModes,
    Field(discriminator="kind"),
]
