"""sphrom: reduced models of smoothed-particle hydrodynamics.

The names are those of `sphrom.api`, which is loaded when one of them is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sphrom import errors
from sphrom.version import __version__

if TYPE_CHECKING:
    from sphrom.api import *  # noqa: F403

FROM_API = (
    "ErrorEstimate",
    "Estimate",
    "Fit",
    "FittedHistory",
    "Model",
    "Result",
    "Sensitivities",
    "Study",
    "load",
    "open",
)
__all__ = ["__version__", "errors", *FROM_API]


def __getattr__(name: str) -> Any:
    if name not in FROM_API:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("sphrom.api"), name)


def __dir__() -> list[str]:
    return [*globals(), *FROM_API]
