"""Checks of the arguments of calls from Python. An argument has one meaning in all functions."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arrays import Array
from sphrom.errors import CaseError
from sphrom.text import quoted

P = ParamSpec("P")
R = TypeVar("R")


def finite_array(data: ArrayLike, name: str) -> Array:
    """Return a copy as an array of finite numbers. Raises CaseError for other data."""
    try:
        given = np.asarray(data)
        # Numbers of a table may be objects; those of other kinds would lose a part, or their unit.
        if given.dtype.kind not in "iufO" or isinstance(data, bytes | bytearray | memoryview):
            raise TypeError(f"got {given.dtype.name}")
        values = np.array(data, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise CaseError(f"{name}: must be numbers; {error}") from error
    if np.ma.is_masked(data) or not np.isfinite(values).all():
        raise CaseError(f"{name}: must be finite")
    return values


def _is_number(value: Any) -> bool:
    return finite_array(value, "").ndim == 0


def _is_count(value: Any) -> bool:
    return isinstance(value, int | np.integer) and value is not True and bool(value >= 1)


def _is_shard(value: Any) -> bool:
    number, count = value
    return _is_count(number) and _is_count(count) and number <= count


def _is_path(value: Any) -> bool:
    text = os.fspath(value)
    return isinstance(text, str) and text != "" and b"\0" not in os.fsencode(text)


def _are_texts(values: Any) -> bool:
    return not isinstance(values, str) and all(isinstance(text, str) for text in values)


def _path_unless_table(value: Any) -> Any:
    return value if hasattr(value, "items") else Path(value)


_KINDS: tuple[tuple[str, Callable[[Any], bool], Callable[[Any], Any], str], ...] = (
    ("a finite number", _is_number, float, "final_time time step_factor checkpoint_every"),
    ("a text", lambda v: isinstance(v, str), str, "until stage name group to scheduler tolerance"),
    ("true or false", lambda v: isinstance(v, bool | np.bool_), bool, "force quiet resume collect"),
    ("a whole number", lambda v: isinstance(v, int | np.integer), int, "place"),
    ("a whole number from 1 on", _is_count, int, "threads workers budget"),
    ("(i, n) with i from 1 to n", _is_shard, tuple, "shard"),
    ("a path", _is_path, Path, "path out into write_case"),
    ("a list of texts", _are_texts, tuple, "only names at inputs outputs"),
    ("a mapping with names as keys", lambda v: hasattr(v, "items") and _are_texts(v), dict, "set"),
    (
        "a path, or a mapping by name",
        lambda v: hasattr(v, "items") or _is_path(v),
        _path_unless_table,
        "case measurements",
    ),
    ("a function", callable, lambda v: v, "report"),
)
_CHECKS = {name: kind for kind in _KINDS for name in kind[-1].split()}
"""The allowed values of an argument, a function that tests them, and one that converts them."""


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that raises CaseError for arguments of wrong kinds."""
    known = signature(function)
    defaults = {name: parameter.default for name, parameter in known.parameters.items()}

    def valid(name: str, value: Any) -> Any:
        if name not in _CHECKS or value is defaults.get(name):
            return value
        words, allowed, converted, _ = _CHECKS[name]
        with suppress(CaseError, TypeError, ValueError, OverflowError):
            if allowed(value):
                return converted(value)
        got = quoted(value) if isinstance(value, str | float) else type(value).__name__
        raise CaseError(f"{name}: must be {words}; got {got}")

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            bound = known.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{function.__qualname__}: {error}") from None
        for name, value in bound.arguments.items():
            if name == "options":
                value = {option: valid(option, given) for option, given in value.items()}
            bound.arguments[name] = valid(name, value)
        return function(*bound.args, **bound.kwargs)

    return call
