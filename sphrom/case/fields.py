"""The types of values in a case file, and the base class of its sections.

By default, pydantic accepts `true` or a text as a number, and infinity as a float; the types below
do not. Their bounds keep all derived quantities finite.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

SMALLEST, LARGEST = 1e-12, 1e12
"""Bounds of positive quantities in SI units, so that squares and quotients stay finite."""
NAME_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$"

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(ge=SMALLEST, le=LARGEST)]
Coordinate = Annotated[Number, Field(ge=-LARGEST, le=LARGEST)]
Place = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]
"""The coordinates x and y."""
Duration = Annotated[Number, Field(ge=0.0, le=LARGEST)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
SafeName = Annotated[str, Field(strict=True, pattern=NAME_PATTERN)]
"""A name that is a safe file name on all systems."""


def key(default: Any, description: str, *, unit: str = "", **bounds: Any) -> Any:
    """Declare a key: its default (`...` if it is required), meaning, unit and bounds."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)


class Section(BaseModel):
    """The base class of all sections: it refuses unknown keys, and values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def only_one(section: Section, names: Iterable[str]) -> str:
    """Return the only key of some names that a section has. Raises ValueError unless it is one."""
    present = [name for name in names if getattr(section, name) is not None]
    if len(present) != 1:
        got = " and ".join(present) or "none"
        raise ValueError(f"must be exactly one of {', '.join(names)}; got {got}")
    return present[0]
