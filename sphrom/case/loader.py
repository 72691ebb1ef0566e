"""Load a case file: read it, apply overrides, check it, and report all problems at once."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sphrom.case import schema
from sphrom.case.checks import case_problems
from sphrom.case.fields import Coordinate, Positive
from sphrom.case.model_sections import ALL
from sphrom.case.models import Case, moved
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.scenes import kind_of
from sphrom.case.schema import MAX_PROBLEMS, problems_of
from sphrom.case.studies import Region, trained_at
from sphrom.case.yaml_reader import (
    MAX_DEPTH,
    Document,
    Path,
    Problem,
    StoredLoader,
    read_yaml,
    show_path,
)
from sphrom.errors import CaseError
from sphrom.text import nearest, quoted
from sphrom.whole_files import read_whole

MAX_BYTES = 256 * 1024
"""Largest size of a case file [bytes]."""
OVERRIDE = "--set"
CONTENT = "case"
"""The name of a case without a file, in messages."""
_REYNOLDS = TypeAdapter[float](Positive)
_OTHER = TypeAdapter[float](Coordinate)


def load_case(
    source: str | os.PathLike[str] | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
    force: bool = False,
) -> Case:
    """Load and check a case file, or the content of one.

    Parameters
    ----------
    overrides : changed keys, as texts `path.to.key=value` or as a mapping from names (`key_named`)
        to values; they are checked like the keys of the file.
    force : accept a time step above its limits.

    Raises CaseError with one line per problem: file, line, key, and the allowed values.
    """
    name, document, changed = _content(source, overrides)
    try:
        case = Case.model_validate(document.value, context={"folder": FilePath(name).parent})
        parameters = document.value.get("parameters") or {}
        starts = bool(case.training.ranges) and "train" not in parameters
        problems = case_problems(case, force=force, replaces_training=starts)
        if not problems and starts:
            case = trained_at(case, Region(case).starts(()))
            problems = case_problems(case, force=force)
    except ValidationError as error:
        problems = problems_of(error, document.value)
    if problems:
        cause = ""
        if changed:
            with suppress(CaseError):  # problems of the unchanged case are not due to the changes
                load_case(source, (), force)
                cause = f"because of {OVERRIDE} {', '.join(map(show_path, changed))}: "
        raise _error(name, document, problems, changed, cause)
    if "rom" in case.model_fields_set:
        return case
    # The default model has at most as many modes as there are snapshots.
    (model,) = case.rom
    most = min(model.size, case.basis.n_modes or model.size, case.plan.n_basis_snapshots(ALL))
    return case.model_copy(update={"rom": (model.model_copy(update={"n_modes": most}),)})


def given_keys(source: FilePath, overrides: Sequence[str], folder: FilePath) -> dict[str, Any]:
    """Return the unchecked keys of a case file, with overrides, for a case file in `folder`.

    Raises CaseError when the file can't be read.
    """
    return dict(moved(_content(source, overrides)[1].value, source.parent, folder))


def case_of_text(text: str, folder: str | os.PathLike[str] | None = None) -> Case:
    """Return the case of a resolved text that this program has written.

    Files that the case names are read from `folder`. Without a folder, the case can't start runs.

    Raises CaseError when such a file is missing or has changed.
    """
    data = read_yaml(text, StoredLoader).value
    try:
        return Case.model_validate(data, context=None if folder is None else {"folder": folder})
    except ValidationError as error:
        raise _error(CONTENT, Document(data), problems_of(error, data)) from error


def _content(
    source: str | os.PathLike[str] | Mapping[str, Any], overrides: Sequence[str] | Mapping[str, Any]
) -> tuple[str, Document, list[Path]]:
    """Return a case's name for messages, its content with overrides, and the changed paths."""
    if isinstance(source, Mapping):
        name = CONTENT
        document = Document(plain_values(source, CONTENT))
    else:
        name = str(source)
        document = _read(FilePath(source))
    data = document.value
    if isinstance(overrides, Mapping):
        changed = [_assign(data, key_named(data, key), value) for key, value in overrides.items()]
    else:
        changed = [_override(data, override) for override in overrides]
    return name, document, changed


def _read(path: FilePath) -> Document:
    """Return the content of a case file. Raises CaseError unless it is a mapping."""
    if path.is_dir():
        raise CaseError(f"{path}: is a directory, not a case file")
    try:
        content = read_whole(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise CaseError(f"{path}: there is no such case file") from error
    except (OSError, ValueError) as error:  # ValueError: too large, or a null character in the name
        raise CaseError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    try:
        document = read_yaml(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CaseError(f"{path}:{line}: is not UTF-8 text") from error
    if document.problems:
        raise _error(str(path), document, document.problems)
    if not isinstance(document.value, dict):
        holds = "is empty" if document.value is None else "must be a mapping of keys"
        raise CaseError(f"{path}: {holds}; `sphrom case new taylor-green` writes a case to edit")
    return document


def _override(data: dict[str, Any], override: str) -> Path:
    """Apply an override `path.to.key=value` to the data, and return the path of the key."""
    name, equals, text = override.partition("=")
    if not equals:
        raise CaseError(f"{OVERRIDE}: must be path.to.key=value; got {quoted(override)}")
    document = read_yaml(text)
    if document.problems:
        raise CaseError(f"{OVERRIDE}: {name}: {document.problems[0].reason}")
    return _assign(data, name.strip(), document.value)


def _assign(data: dict[str, Any], name: str, value: Any) -> Path:
    segments = name.split(".")
    if len(segments) > MAX_DEPTH or not all(segments):
        raise CaseError(f"{OVERRIDE}: must be a key such as time.step; got {quoted(name)}")
    path: Path = ()
    container: Any = data
    for segment in segments[:-1]:
        key = _key_in(container, segment, path)
        if isinstance(container, dict) and container.get(segment) is None:
            container[segment] = {}
        path, container = (*path, key), container[key]
    key = _key_in(container, segments[-1], path)
    container[key] = plain_values(value, f"{OVERRIDE}: {name}")
    return (*path, key)


def _key_in(container: Any, segment: str, path: Path) -> str | int:
    """Return the key or list index that a segment names in the container at a path."""
    if isinstance(container, dict) and (container or not schema.is_list(path)):
        return segment
    if isinstance(container, list) and segment in map(str, range(len(container))):
        return int(segment)
    where = f"{OVERRIDE}: {show_path((*path, segment))}: {show_path(path)}"
    if isinstance(container, list):
        raise CaseError(f"{where} is a list of {len(container)}, counted from 0")
    raise CaseError(f"{where} has no keys; got {quoted(container)}")


def _error(
    name: str,
    document: Document,
    problems: Sequence[Problem],
    changed: Sequence[Path] = (),
    cause: str = "",
) -> CaseError:
    lines = [_line(cause + name, document, problem, changed) for problem in problems[:MAX_PROBLEMS]]
    if len(problems) > MAX_PROBLEMS:
        lines.append(f"{name}: and {len(problems) - MAX_PROBLEMS} more problems")
    return CaseError("\n".join(lines))


def _line(name: str, document: Document, problem: Problem, changed: Sequence[Path]) -> str:
    if any(problem.path[: len(key)] == key for key in changed):
        return f"{OVERRIDE}: {problem}"
    known = [problem.path[:depth] for depth in range(len(problem.path), -1, -1)]
    line = problem.line or next((document.lines[key] for key in known if key in document.lines), 0)
    return f"{name}:{line}: {problem}" if line else f"{name}: {problem}"


def plain_values(value: Any, where: str) -> Any:
    """Return a copy of a value in the types of YAML: dicts, lists, texts, numbers.

    Tuples, ranges, and numpy's arrays and numbers become lists and numbers.

    Raises CaseError, with the place `where`, for other types.
    """
    try:
        return json.loads(json.dumps(value, default=_plain))
    except (TypeError, ValueError, RecursionError) as error:
        raise CaseError(f"{where}: must be numbers, texts, lists or mappings; {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return list(value)
    raise TypeError(f"got {type(value).__name__}")


def key_named(data: Mapping[str, Any], name: str) -> str:
    """Return the dotted key that a name means in a case with some data.

    Dotted keys and keys at the top level, such as `rom`, mean themselves. Any other name is the
    last segment of a dotted key, and must be unique.

    Raises CaseError, with the candidates, if several keys or none have this name.
    """
    if "." in name or name in schema.known_keys(()):
        return name
    paths = list(schema.key_paths(kind=kind_of(data)))
    keys = [show_path(path) for path in paths if path[-1] == name]
    if not keys:
        hint = nearest(name, dict.fromkeys(str(path[-1]) for path in paths))
        raise CaseError(f"{quoted(name)}: the case has no such key; {hint}")
    if len(keys) > 1 or ".0." in keys[0]:
        remedy = f"name one, such as set={{'{keys[0]}': ...}}"
        raise CaseError(f"{quoted(name)}: may be {' or '.join(keys)}; {remedy}")
    return keys[0]


def parameter_point(case: Case, values: Mapping[str, Any]) -> ParameterPoint:
    """Return the parameter point with values by name; missing ones are `Plan.usual_values`.

    Raises CaseError for unknown names, values out of range, and a missing Reynolds number.
    """
    names = case.plan.parameter_names
    for name in values:
        if name not in names:
            reason = "varies in neither parameters.train nor parameters.test"
            raise CaseError(f"{quoted(name)}: {reason}; {nearest(name, names)}")
    return case.plan.point({name: _checked(name, value) for name, value in values.items()})


def _checked(name: str, value: Any) -> float:
    adapter = _REYNOLDS if name == REYNOLDS else _OTHER
    try:
        return adapter.validate_python(plain_values(value, name))
    except ValidationError as error:
        allowed = schema.allowed(adapter.json_schema())
        raise CaseError(f"{name}: must be {allowed}; got {quoted(value)}") from error
