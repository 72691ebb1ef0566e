"""The types of values in a case file, and the base class of its sections.

By default, pydantic accepts `true` or a text as a number, and infinity as a float; the types below
do not. Their bounds keep all derived quantities finite.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
)
from pydantic_core import CoreSchema, core_schema

SMALLEST, LARGEST = 1e-12, 1e12
"""Bounds of positive quantities in SI units, so that squares and quotients stay finite."""
NAME_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$"

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(ge=SMALLEST, le=LARGEST)]
Coordinate = Annotated[Number, Field(ge=-LARGEST, le=LARGEST)]
Place = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]
"""The coordinates x and y."""
Point = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=3)]
"""The coordinates x and y, and z in three dimensions."""
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


S = TypeVar("S", bound=Section)


class OneOf(Generic[S]):
    """The annotation of a section of several kinds, each a class with its own keys.

    A union of pydantic's would report the errors of all kinds. Here the keys choose one kind, which
    validates them, so that errors are about its keys. The JSON schema lists all kinds.

    Parameters
    ----------
    kinds : the classes by the key that only sections of this kind have.
    """

    def __init__(self, **kinds: type[S]) -> None:
        self.kinds = kinds
        self._described = set[type[S]]()

    def choose(self, given: Mapping[str, Any], earlier: Mapping[str, Any]) -> type[S]:
        """Return the kind of given keys; `earlier` are the sections before it in the case.

        Raises ValueError if the keys are those of no kind, or of several.
        """
        present = [name for name in self.kinds if given.get(name) is not None]
        # A shape from a file has the keys `file` and `wkt`.
        inner = {key for name in present for key in self.kinds[name].model_fields if key != name}
        chosen = [name for name in present if name not in inner]
        if len(chosen) != 1:
            got = " and ".join(chosen or map(str, given)) or "none"
            raise ValueError(f"must be exactly one of {', '.join(self.kinds)}; got {got}")
        return self.kinds[chosen[0]]

    def refusal(self, name: str, kind: type[S]) -> str:
        """Return why a kind does not have a key of other kinds."""
        own = self.kind_of(kind)
        if name in getattr(kind.model_fields[own].annotation, "model_fields", ()):
            return f"is {own}.{name} here"
        having = (one for one, other in self.kinds.items() if name in other.model_fields)
        return f"is only for {', '.join(having)}, not for {own}"

    def kind_of(self, section: Section | type[S]) -> str:
        """Return the key that only sections of the kind of a section have."""
        kind = section if isinstance(section, type) else type(section)
        return next(name for name, other in self.kinds.items() if other is kind)

    def validated(self, value: Any, info: ValidationInfo) -> S:
        """Return the section of some keys.

        Keys of other kinds are left out if they are switched off or have their defaults, because
        earlier versions resolved cases with them. Raises ValueError if they have other values.
        """
        if isinstance(value, Section):
            return value  # type: ignore[return-value]
        if not isinstance(value, Mapping):
            return next(iter(self.kinds.values())).model_validate(value)
        return self.section(value, info.data or {}, info.context)

    def section(
        self, value: Mapping[str, Any], earlier: Mapping[str, Any], context: Any = None
    ) -> S:
        """Return the section of some keys; `earlier` are the sections before it in the case."""
        kind = self.choose(value, earlier)
        fields = {
            name: f for other in self.kinds.values() for name, f in other.model_fields.items()
        }
        given = {}
        for name, one in value.items():
            if name in kind.model_fields or name not in fields:
                given[name] = one
            elif one is not None and one is not False and one != fields[name].default:
                raise ValueError(f"{name}: {self.refusal(name, kind)}")
        return kind.model_validate(given, context=context)

    def __get_pydantic_core_schema__(self, _: Any, __: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self.validated)

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> Any:
        nodes: list[CoreSchema] = []
        for kind in self.kinds.values():
            kind.model_rebuild()
            node: Any = kind.__pydantic_core_schema__
            if kind in self._described:  # a shape of shapes refers to its kind
                inner = node["schema"] if node["type"] == "definitions" else node
                node = core_schema.definition_reference_schema(inner["ref"])
            nodes.append(node)
        added = set(self.kinds.values()) - self._described
        self._described |= added
        try:
            return handler(core_schema.union_schema([*nodes]))
        finally:
            self._described -= added
