"""Cases, changes of their keys, and parameter points, given as Python values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sphrom.case import schema
from sphrom.case.fields import Coordinate, Positive
from sphrom.case.messages import nearest, show, show_path
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.scenes import kind_of
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import MAX_DEPTH, is_unicode
from sphrom.errors import CaseError


def plain_values(value: Any, where: str, depth: int = 0) -> Any:
    """Return a copy of a value as YAML would give it: dicts, lists, texts, numbers.

    Tuples, ranges, numpy's arrays and its numbers become lists and numbers.

    Raises CaseError, naming the place, for anything else.
    """
    if depth > MAX_DEPTH:
        raise CaseError(f"{where}: nests deeper than {MAX_DEPTH} levels")
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise CaseError(f"{where}: a key must be text")
        return {k: plain_values(v, f"{where}: {k}", depth + 1) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray):
        return [plain_values(v, f"{where}: {i}", depth + 1) for i, v in enumerate(value)]
    if isinstance(value, str) and not is_unicode(value):
        raise CaseError(f"{where}: is not Unicode text")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    unordered = "; put it in order, in a list" if isinstance(value, Set) else ""
    raise CaseError(
        f"{where}: must be a number, text, list or mapping; got {type(value).__name__}{unordered}"
    )


def key_named(data: Mapping[str, Any], name: str) -> str:
    """Return the dotted key that a name stands for in a case with some data.

    A dotted key stands for itself, and so does a key at the top, such as `name` or `rom`. Any other
    name is the last segment of a key, and has to be that of one alone.

    Raises CaseError, naming the candidates, where there are several keys or none.
    """
    if "." in name or name in schema.known_keys(()):
        return name
    every = [*_keys(data, (), kind_of(data))]
    found = [show_path(path) for path in every if path[-1] == name]
    if not found:
        known = dict.fromkeys(str(path[-1]) for path in every)
        raise CaseError(f"{show(name)}: the case has no such key; {nearest(name, known)}")
    if len(found) > 1:
        raise CaseError(
            f"{show(name)}: may be {', '.join(found[:-1])} or {found[-1]}; name one, such as "
            f"set={{'{found[0]}': ...}}"
        )
    return found[0]


def _keys(value: Any, path: Path, kind: str) -> Iterator[Path]:
    """Yield the path of every key that a value at a path may hold, entries of lists included."""
    known = schema.known_keys(path, kind)
    yield from ((*path, key) for key in known)
    inside: dict[str | int, Any] = dict.fromkeys(known)
    if isinstance(value, Mapping):
        inside |= value
    elif isinstance(value, list):
        inside |= dict(enumerate(value))
    for key, entry in inside.items():
        yield from _keys(entry, (*path, key), kind)


def parameter_point(case: Case, values: Mapping[str, Any]) -> ParameterPoint:
    """Return the parameter point of values by name; others are the scene's own.

    Raises CaseError where one is unknown or out of range, or there is no Reynolds number.
    """
    names = case.plan.parameter_names
    for name in values:
        if name in case.plan.own_values and name not in names:
            raise CaseError(
                f"{name}: varies in neither parameters.train nor parameters.test, so that models "
                f"know one value of it only; {', '.join(names)} can be given"
            )
        if name not in names:
            raise CaseError(f"{show(name)}: the case has no such parameter; {nearest(name, names)}")
    if REYNOLDS not in values and (len(names) == 1 or len(case.parameters.train.reynolds) > 1):
        raise CaseError(f"{REYNOLDS}: is missing; give its value, such as {REYNOLDS}=100")
    kinds = {name: Positive if name == REYNOLDS else Coordinate for name in values}
    return case.plan.point({name: _checked(name, values[name], kinds[name]) for name in values})


def _checked(name: str, value: Any, kind: Any) -> float:
    adapter = TypeAdapter[float](kind)
    try:
        return adapter.validate_python(plain_values(value, name))
    except ValidationError as error:
        allowed = schema.allowed(adapter.json_schema())
        raise CaseError(f"{name}: must be {allowed}; got {show(value)}") from error
