"""sphrom: reduced models of smoothed-particle hydrodynamics.

Each name is loaded when it is first used; `sphrom.api` has an example.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sphrom import errors
from sphrom.version import __version__

if TYPE_CHECKING:
    from sphrom.api.flow import Flow as Flow
    from sphrom.api.function import Function as Function
    from sphrom.api.model import Model as Model
    from sphrom.api.result import Result as Result
    from sphrom.api.result import Sensitivities as Sensitivities
    from sphrom.api.study import Study as Study
    from sphrom.api.study import load as load
    from sphrom.api.study import open as open
    from sphrom.artifacts.records.fit import FittedHistory as FittedHistory
    from sphrom.fit.fit import Estimate as Estimate
    from sphrom.fit.fit import Fit as Fit
    from sphrom.models.estimates import ErrorEstimate as ErrorEstimate
    from sphrom.sph.terms import Term as Term

FROM_API = {
    "ErrorEstimate": "models.estimates",
    "Estimate": "fit.fit",
    "Fit": "fit.fit",
    "FittedHistory": "artifacts.records.fit",
    "Flow": "api.flow",
    "Function": "api.function",
    "Model": "api.model",
    "Result": "api.result",
    "Sensitivities": "api.result",
    "Study": "api.study",
    "Term": "sph.terms",
    "load": "api.study",
    "open": "api.study",
}
"""The modules of the names, each of which is loaded when it is first used."""
__all__ = ["__version__", "errors", *FROM_API]


def __getattr__(name: str) -> Any:
    if name not in FROM_API:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"sphrom.{FROM_API[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *FROM_API]
