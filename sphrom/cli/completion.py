"""What the shell completes, beside commands, options and files: kinds, keys and values.

Nothing is said where there is nothing to complete: a shell that asks wants no errors.
"""

from __future__ import annotations

import typer


def kinds(incomplete: str) -> list[str]:
    """Return the kinds of scene that begin so."""
    from sphrom.case.scenes import DEFAULTS

    return [kind for kind in DEFAULTS if kind.startswith(incomplete)]


def keys(incomplete: str) -> list[str]:
    """Return the keys of a case that begin so, as far as their names are fixed."""
    from sphrom.case.schema import is_section, key_paths, node_at

    found = (path for path in key_paths() if not is_section(node_at(path) or {}))
    names = (".".join(map(str, path)) + "=" for path in found)
    return [name for name in names if name.startswith(incomplete)]


def values(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the parameter values and models of the case that is named before, for --only."""
    from sphrom.case.loader import load_case
    from sphrom.errors import SphromError

    # A line that ends within an option is not parsed as far as its arguments.
    named = ctx.params.get("case") or next(iter(ctx.args), None)
    try:
        case = load_case(named or "")
    except SphromError:
        return []
    labels = [point.label.replace(", ", ",") for point in case.plan.points]
    labels += [model.name for model in case.rom]
    return [label for label in labels if label.startswith(incomplete)]
