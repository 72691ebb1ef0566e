"""The kinds of value that a case file holds, what each accepts, and what sections share.

pydantic takes `true` for a number, text for a number, and infinities for floats unless told
otherwise; the kinds below don't. Their bounds keep every quantity that is derived from them finite.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

SMALLEST, LARGEST = 1e-12, 1e12
"""Bounds of positive quantities in SI units: their squares and quotients stay finite."""
NAME_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$"

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(ge=SMALLEST, le=LARGEST)]
Coordinate = Annotated[Number, Field(ge=-LARGEST, le=LARGEST)]
Place = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]
"""x and y."""
Duration = Annotated[Number, Field(ge=0.0, le=LARGEST)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
SafeName = Annotated[str, Field(strict=True, pattern=NAME_PATTERN)]
"""A name that is a safe file name on every system."""


def key(default: Any, description: str, *, unit: str = "", **bounds: Any) -> Any:
    """Describe one key: its default (`...` where there is none), meaning, unit and bounds."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)


class Section(BaseModel):
    """What all sections share: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def only_one(section: Section, names: Iterable[str]) -> str:
    """Return the one of some keys that is given. Raises ValueError for none, and for several."""
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) != 1:
        found = " and ".join(given) or "none"
        raise ValueError(f"must be exactly one of {', '.join(names)}; got {found}")
    return given[0]
