"""Shell completion of kinds of scenes, keys of a case, and parameter values.

Errors are silent here, because a message would disturb the line that the user types.
"""

from __future__ import annotations

import typer


def kinds(incomplete: str) -> list[str]:
    """Return the kinds of scene that begin with a text."""
    from sphrom.case.scenes import DEFAULTS

    return [kind for kind in DEFAULTS if kind.startswith(incomplete)]


def keys(incomplete: str) -> list[str]:
    """Return the keys of a case with fixed names that begin with a text."""
    from sphrom.case.schema import is_section, key_paths, node_at

    paths = (path for path in key_paths() if not is_section(node_at(path) or {}))
    names = (".".join(map(str, path)) + "=" for path in paths)
    return [name for name in names if name.startswith(incomplete)]


def values(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the parameter values and models of the case on the command line, for --only."""
    from sphrom.case.loader import load_case
    from sphrom.errors import SphromError

    # typer has not parsed the arguments yet if the line ends within an option.
    named = ctx.params.get("case") or next(iter(ctx.args), None)
    try:
        case = load_case(named or "")
    except SphromError:
        return []
    labels = [point.label.replace(", ", ",") for point in case.plan.points]
    labels += [model.name for model in case.rom]
    return [label for label in labels if label.startswith(incomplete)]
