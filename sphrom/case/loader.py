"""Load a case file: read it, apply overrides, check it, and report all problems at once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sphrom.case import schema
from sphrom.case.checks import case_problems, with_fitting_model
from sphrom.case.fields import Coordinate, Positive
from sphrom.case.messages import MAX_PROBLEMS, Path, Problem, is_unicode, nearest, show, show_path
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.scenes import kind_of
from sphrom.case.schema import problems_of
from sphrom.case.yaml_reader import MAX_DEPTH, Document, InvalidText, read_yaml
from sphrom.errors import CaseError
from sphrom.whole_files import Unreadable, read_whole

MAX_BYTES = 256 * 1024
"""The largest case file that is read."""
OVERRIDE = "--set"
CONTENT = "case"
"""The name of a case without a file in messages."""


def load_case(
    source: str | os.PathLike[str] | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
    force: bool = False,
) -> Case:
    """Load and check a case file, or a case's content.

    Parameters
    ----------
    overrides : keys to change, each `path.to.key=value`, or values by key as `key_named` knows
        them; checked like those of the file.
    force : insist on a time step beyond its limits.

    Raises CaseError with one line for each problem: file, line, key, and what is allowed.
    """
    name, document, changed = _given(source, overrides)
    return _validate(name, document, changed, force)


def _given(
    source: str | os.PathLike[str] | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any],
) -> tuple[str, Document, list[Path]]:
    """Return a case's name in messages, its content with keys changed, and the paths of these."""
    if isinstance(source, Mapping):
        name, document = CONTENT, Document(plain_values(source, CONTENT))
    else:
        name, document = str(source), _read(FilePath(source))
    data = document.value
    if isinstance(overrides, Mapping):
        changed = [_change(data, key, value) for key, value in overrides.items()]
    else:
        changed = [_override(data, override) for override in overrides]
    return name, document, changed


def given_keys(source: str | os.PathLike[str], overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the keys that a case file gives, some changed, unchecked. Raises CaseError."""
    data: dict[str, Any] = _given(source, overrides)[1].value
    return data


def _read(path: FilePath) -> Document:
    """Return what a case file holds, which is a mapping. Raises CaseError."""
    text = _read_text(path)
    try:
        document = read_yaml(text)
    except InvalidText as error:
        raise CaseError(_at(str(path), error.line, error.reason)) from error
    if document.problems:
        raise _error(str(path), document, document.problems)
    if not isinstance(document.value, dict):
        reason = (
            "is empty"
            if document.value is None
            else f"must be a mapping of keys; got {show(document.value)}"
        )
        raise CaseError(f"{path}: {reason}; `sphrom case new taylor-green` writes a case to edit")
    return document


def case_of_text(text: str, folder: str | os.PathLike[str] | None = None) -> Case:
    """Return the case whose resolved text was written by this program.

    Files that it names are read from a folder; without one it starts no run.

    Raises CaseError when such a file is gone, or is another one by now.
    """
    data = read_yaml(text).value
    try:
        return Case.model_validate(data, context=None if folder is None else {"folder": folder})
    except ValidationError as error:
        raise _error(CONTENT, Document(data), problems_of(error, data)) from error


def _read_text(path: FilePath) -> str:
    try:
        if path.is_dir():
            raise CaseError(f"{path}: is a directory, not a case file")
        content = read_whole(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise CaseError(f"{path}: there is no such case file") from error
    except Unreadable as error:
        raise CaseError(f"{path}: {error}") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise CaseError(f"{path}: can't be read: {reason}") from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CaseError(_at(str(path), line, "is not UTF-8 text")) from error


def _override(data: dict[str, Any], override: str) -> Path:
    """Change one key of the data, and return its path."""
    name, equals, text = override.partition("=")
    segments = _segments(name) if equals else []
    if not segments:
        raise CaseError(f"{OVERRIDE}: must be path.to.key=value; got {show(override)}")
    try:
        document = read_yaml(text)
    except InvalidText as error:
        raise CaseError(f"{OVERRIDE}: {name}: {error.reason}") from error
    if document.problems:
        problems = document.problems[:MAX_PROBLEMS]
        raise CaseError("\n".join(f"{OVERRIDE}: {name}: {p.reason}" for p in problems))
    return _assign(data, segments, document.value)


def _change(data: dict[str, Any], name: str, value: Any) -> Path:
    """Change one key of the data to a Python value, and return its path."""
    key = key_named(data, name)
    segments = _segments(key)
    if not segments:
        raise CaseError(f"{OVERRIDE}: must be a key such as time.step; got {show(name)}")
    return _assign(data, segments, plain_values(value, f"{OVERRIDE}: {key}"))


def _segments(name: str) -> list[str]:
    """Return the segments of a dotted key, none where it isn't one."""
    segments = name.strip().split(".")
    known = len(segments) <= MAX_DEPTH and all(segments) and all(map(is_unicode, segments))
    return segments if known else []


def _assign(data: dict[str, Any], segments: Sequence[str], value: Any) -> Path:
    path: list[str | int] = []
    container: Any = data
    for segment in segments[:-1]:
        key = _key_in(container, segment, path)
        path.append(key)
        if isinstance(container, dict) and container.get(segment) is None:
            container[segment] = {}
        container = container[key]
    key = _key_in(container, segments[-1], path)
    container[key] = value
    return (*path, key)


def _key_in(container: Any, segment: str, path: Sequence[str | int]) -> str | int:
    where = f"{OVERRIDE}: {show_path((*path, segment))}"
    if isinstance(container, dict):
        at = tuple(path)
        if not container and schema.is_list(at) and not schema.known_keys(at):
            raise CaseError(f"{where}: {show_path(tuple(path))} is not in the file")
        return segment
    if not isinstance(container, list):
        raise CaseError(f"{where}: {show_path(tuple(path))} holds no keys; got {show(container)}")
    most_digits = len(str(len(container)))
    if not segment.isdecimal() or len(segment) > most_digits or int(segment) >= len(container):
        raise CaseError(
            f"{where}: {show_path(tuple(path))} is a list of {len(container)}, counted from 0"
        )
    return int(segment)


def _validate(path: str, document: Document, changed: Sequence[Path], force: bool) -> Case:
    data = _with_empty_sections(document.value)
    try:
        case = Case.model_validate(data, context={"folder": FilePath(path).parent})
    except ValidationError as error:
        raise _error(path, document, problems_of(error, data), changed) from error
    if problems := case_problems(case, force=force):
        raise _error(path, document, problems, changed)
    return with_fitting_model(case)


def _with_empty_sections(data: dict[str, Any]) -> dict[str, Any]:
    """Return the data with {} for sections whose keys are all commented out: they keep defaults."""

    def is_section(key: str) -> bool:
        node = schema.node_at((key,))
        return node is not None and schema.is_section(node)

    return {key: {} if value is None and is_section(key) else value for key, value in data.items()}


def _error(
    path: str, document: Document, problems: Sequence[Problem], changed: Sequence[Path] = ()
) -> CaseError:
    lines = [_line(path, document, problem, changed) for problem in problems[:MAX_PROBLEMS]]
    if len(problems) > MAX_PROBLEMS:
        lines.append(f"{path}: and {len(problems) - MAX_PROBLEMS} more problems")
    return CaseError("\n".join(lines))


def _line(path: str, document: Document, problem: Problem, changed: Sequence[Path]) -> str:
    text = f"{show_path(problem.path)}: {problem.reason}" if problem.path else problem.reason
    if any(problem.path[: len(key)] == key for key in changed):
        return f"{OVERRIDE}: {text}"
    known = [problem.path[:depth] for depth in range(len(problem.path), -1, -1)]
    nearest = next((document.lines[key] for key in known if key in document.lines), None)
    return _at(path, problem.line or nearest, text)


def _at(path: str, line: int | None, text: str) -> str:
    return f"{path}:{line}: {text}" if line else f"{path}: {text}"


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
