"""Python functions in a scene, which `sphrom.Flow` puts there.

A case identifies a function by a digest of its code and of the values that it uses. So artifacts of
an earlier function are out of date, and a process that does not have the function, such as a
command of the terminal, can't use the case.
"""

from __future__ import annotations

import hashlib
import pickle
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Annotated, Any

from pydantic import AfterValidator

_FUNCTIONS: dict[str, Callable[..., Any]] = {}
"""The functions of this process by their digests."""
_INSTALLED = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib"))
"""Folders of libraries."""


def remember(function: Callable[..., Any]) -> str:
    """Keep a function, and return its SHA-256. Raises ValueError if it can't be identified."""
    try:
        parts = b"\0".join(_identity(function, {}, []))
    except Exception as error:  # pickling raises errors of any kind
        reason = "uses a value that can't be pickled, so its results can't be identified"
        raise ValueError(f"the function {reason}: {error}") from error
    digest = hashlib.sha256(parts).hexdigest()
    _FUNCTIONS[digest] = function
    return digest


def function_of(sha256: str) -> Callable[..., Any]:
    """Return a function by its digest. Raises ValueError if this process does not have it."""
    if sha256 not in _FUNCTIONS:
        raise ValueError(
            "is a Python function that this process does not have; commands and other "
            "processes can't use this case: make its sphrom.Flow in Python, and run it there"
        )
    return _FUNCTIONS[sha256]


def _known(sha256: str) -> str:
    _ = function_of(sha256)
    return sha256


Digest = Annotated[str, AfterValidator(_known)]
"""The digest of a function of this process."""


def _identity(value: Any, scope: Mapping[str, Any], seen: list[Any]) -> Iterator[bytes]:
    """Yield the parts that identify a value: code, constants, closures, the globals it names.

    Code finds its globals in `scope`. Functions of libraries are identified by their names.
    """
    if isinstance(value, FunctionType) and not value.__code__.co_filename.startswith(_INSTALLED):
        if any(value is one for one in seen):
            return  # it calls itself
        seen.append(value)
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        usual = [value.__defaults__, [*(value.__kwdefaults__ or {}).items()]]
        yield from _identity([value.__code__, *usual, *cells], value.__globals__, seen)
    elif isinstance(value, CodeType):
        yield from (value.co_code, repr(value.co_names).encode())
        used = [scope[name] for name in value.co_names if name in scope]
        yield from _identity([*value.co_consts, *used], scope, seen)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _identity(one, scope, seen)
    else:
        yield value.__name__.encode() if isinstance(value, ModuleType) else pickle.dumps(value)
