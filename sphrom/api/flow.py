"""A flow whose keys may be Python functions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial, wraps
from typing import Any

from sphrom.arguments import checked
from sphrom.case.functions import remember
from sphrom.errors import CaseError
from sphrom.scenes.expressions import Function
from sphrom.signals import guarded
from sphrom.sph.terms import Term

VECTORS = ("body_force", "velocity")
"""Keys of vectors, all components of which a single function may return."""


class Flow(dict[str, Any]):
    """The scene of a case, with Python functions in place of expressions.

    Parameters
    ----------
    keys : the keys of a scene of kind `custom`, such as `box`, `solids`, `walls` and `body_force`.

    A function can stand wherever an expression can. It takes arrays, and returns an array of the
    same shape; its arguments are named like the variables of the expression, such as x, y [m] and
    t [s], or like constants of the scene. For a vector, one function may return all components.
    As in an expression, a force is a field times an amplitude; `functions` names functions that
    expressions call: `functions={"gust": gust}, body_force=["gust(x, y)*sin(t)", 0]`.

    `terms` has terms of the acceleration by name, each a `sphrom.Term`.

    A case stores a digest of a function's code and of the values that it uses when the flow is
    made. Artifacts of another function are out of date. Only this process has the functions:
    commands of the terminal and parallel workers refuse such a case.

    Raises CaseError for a function that can't be identified.
    """

    @guarded(computes=False)
    @checked
    def __init__(self, **keys: Any) -> None:
        self._functions: dict[str, str] = {}
        box = keys.get("box")
        lower = box.get("lower") if isinstance(box, Mapping) else None
        self._n_dim = 3 if isinstance(lower, Sequence) and len(lower) == 3 else 2
        scene = {name: self._plain(value, (name,)) for name, value in keys.items()}
        functions = {**scene.pop("functions", {}), **self._functions}
        super().__init__({"kind": "custom", **scene, "functions": functions})

    def _plain(self, value: Any, path: tuple[str, ...]) -> Any:
        """Return a value in which calls by name replace functions, and digests replace terms."""
        if isinstance(value, Mapping):
            return {name: self._plain(one, (*path, str(name))) for name, one in value.items()}
        if isinstance(value, tuple | list):
            return [self._plain(one, (*path, str(n))) for n, one in enumerate(value)]
        try:
            if isinstance(value, Term):
                return {kind: remember(one) for kind, one in vars(value).items() if one}
            if not callable(value):
                return value
            if path[-1] in VECTORS:
                axes = enumerate("xyz"[: self._n_dim])
                of = partial(_component, value, self._n_dim)
                return [self._plain(of(n), (*path, axis)) for n, axis in axes]
            name = path[-1] if path[0] == "functions" else re.sub(r"\W", "_", "_".join(path))
            self._functions[name] = remember(value)
            return f"{name}({', '.join(Function(name, value).arguments)})"
        except ValueError as error:
            raise CaseError(f"{'.'.join(path)}: {error}") from error


def _component(function: Callable[..., Any], n_dim: int, number: int) -> Callable[..., Any]:
    """Return a function for one of some components."""

    @wraps(function)
    def component(*values: Any) -> Any:
        found = tuple(function(*values))
        if len(found) != n_dim:
            raise ValueError(f"returns {len(found)} components; there are {n_dim}")
        return found[number]

    return component
