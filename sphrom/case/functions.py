"""Functions of Python in a scene, which `sphrom.Flow` puts there.

A case identifies a function by a digest of its code and of the values that it uses. So artifacts of
an earlier function are out of date, and a process that does not have the function, such as a
command of the terminal, can't use the case.
"""

from __future__ import annotations

import hashlib
import inspect
import pickle
import sysconfig
from collections.abc import Callable, Iterator
from functools import cached_property
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from pydantic import model_validator

from sphrom.arrays import Array
from sphrom.case.fields import Section, key
from sphrom.sph.terms import Term

_FUNCTIONS: dict[str, Callable[..., Any]] = {}
"""The functions of this process by their digests."""
_INSTALLED = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib"))
"""Folders of libraries, whose functions are identified by their names."""
SHA256 = "digest of a function of Python, which only sphrom.Flow gives"


def remember(function: Callable[..., Any]) -> str:
    """Keep a function, and return its SHA-256. Raises ValueError if it can't be identified."""
    try:
        parts = b"\0".join(_identity(function, []))
    except Exception as error:  # pickling raises errors of any kind
        reason = "uses a value that can't be pickled, so its results can't be identified"
        raise ValueError(f"the function {reason}: {error}") from error
    digest = hashlib.sha256(parts).hexdigest()
    _FUNCTIONS[digest] = function
    return digest


def _identity(value: Any, seen: list[Any]) -> Iterator[bytes]:
    """Yield what identifies a value: code, constants, closures, and the globals that it names."""
    if isinstance(value, FunctionType) and value.__code__.co_filename.startswith(_INSTALLED):
        yield f"{value.__module__}.{value.__qualname__}".encode()
    elif isinstance(value, FunctionType):
        if any(value is one for one in seen):
            return  # it calls itself
        seen.append(value)
        used = [value.__globals__[n] for n in _names(value.__code__) if n in value.__globals__]
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        usual = (value.__defaults__, [*(value.__kwdefaults__ or {}).items()])
        yield from _identity((value.__code__, *usual, *cells, *used), seen)
    elif isinstance(value, CodeType):
        yield from (value.co_code, repr(value.co_names).encode())
        yield from _identity(value.co_consts, seen)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _identity(one, seen)
    else:
        yield value.__name__.encode() if isinstance(value, ModuleType) else pickle.dumps(value)


def _names(code: CodeType) -> Iterator[str]:
    """Yield the global names of a function and of those within it."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)


def _function(sha256: str | None) -> Callable[..., Any] | None:
    """Return a function by its digest. Raises ValueError if this process does not have it."""
    if sha256 is not None and sha256 not in _FUNCTIONS:
        raise ValueError(
            "is a function of Python that this process does not have; commands and other "
            "processes can't use this case: make its sphrom.Flow in Python, and run it there"
        )
    return None if sha256 is None else _FUNCTIONS[sha256]


class FunctionSection(Section):
    """A function that expressions call."""

    sha256: str = key(..., SHA256)
    arguments: tuple[str, ...] = key(..., "names of its arguments", min_length=1)

    @classmethod
    def keys_of(cls, function: Callable[..., Any]) -> dict[str, Any]:
        """Return the keys of a function; arguments with a default keep it."""
        given = inspect.signature(function).parameters.values()
        names = [one.name for one in given if one.default is one.empty]
        return {"sha256": remember(function), "arguments": names}

    @model_validator(mode="after")
    def _known(self) -> FunctionSection:
        _ = _function(self.sha256)
        return self

    def __call__(self, *values: Array) -> Array:
        """Return the function's values. Raises ValueError if they have another shape."""
        shape = np.broadcast_shapes(*(value.shape for value in values))
        found = np.asarray(_FUNCTIONS[self.sha256](*values), dtype=np.float64)
        try:
            return np.broadcast_to(found, shape)
        except ValueError as error:
            names = ", ".join(self.arguments)
            reason = f"must return values of the shape {shape}; got {found.shape}"
            raise ValueError(f"the function of ({names}) {reason}") from error


class TermSection(Section):
    """A term of the acceleration."""

    linear: str | None = key(None, SHA256)
    quadratic: str | None = key(None, SHA256)
    acceleration: str | None = key(None, SHA256)

    @classmethod
    def keys_of(cls, term: Term) -> dict[str, Any]:
        """Return the keys of a term."""
        return {n: None if part is None else remember(part) for n, part in vars(term).items()}

    @model_validator(mode="after")
    def _known(self) -> TermSection:
        _ = self.term
        return self

    @cached_property
    def term(self) -> Term:
        """The term with its functions."""
        return Term(**{name: _function(getattr(self, name)) for name in type(self).model_fields})
