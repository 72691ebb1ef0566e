"""Write a case file to start from: a short one, or every key, out of its own description."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

from sphrom.case import schema
from sphrom.case.model_kinds import PROJECTIONS
from sphrom.case.models import Case
from sphrom.case.scenes import AnyScene, kind_of_section
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import CaseError

WIDTH = 100
INDENT = "  "
COMMENTS = 36
"""Column of the comments that follow values in a short case."""
SCHEMA_FILE = "sphrom.schema.json"
"""What a new case calls the schema, beside it, that an editor reads."""


def scene_kinds() -> tuple[str, ...]:
    """Return the kinds of scene that a case can have."""
    return tuple(schema.words(schema.node_at(("scene", "kind")) or {}))


_OWN_FLOW = """
  box: {lower: [0, 0], upper: [6, 4], periodic: [x]}  # m; the other sides are walls
  solids:  # circle, rectangle, polygon, file, union, ...
    cylinder: {circle: {centre: [2, 2], radius: 0.5}}
  body_force: ["0.2*(1 - exp(-t*t))", 0]  # m/s2, of x, y, t: smooth, so that no sound is sent out
  reference_length: 1.0  # L of the Reynolds number [m]; resolution is along it
  measure: {drag: {force_on: cylinder}, wake: {probe: [4, 2]}}"""


@dataclass(frozen=True)
class _Start:
    """What a short case of a kind has, such that it runs in a minute or so."""

    scene: str = ""
    resolution: int = 40
    time: str = "{final_time: 2.0}"
    every: int = 4
    reynolds: tuple[float, float] = (100, 200)
    n_modes: int = 10
    compare: str = ""


_STARTS = {
    "taylor-green": _Start(resolution=50, time="{final_time: 0.5}", every=2, n_modes=5),
    # The start from rest is mostly sound.
    "lid-driven-cavity": _Start(compare="compare: {from_time: 1.0}  # s; sound comes before"),
    "open-cavity": _Start(
        resolution=60, time="{spin_up: 1.0, final_time: 1.5}", every=10, reynolds=(1200, 2400)
    ),
    "custom": _Start(
        scene=_OWN_FLOW,
        resolution=10,
        time="{final_time: 5.0}",
        every=10,
        reynolds=(40, 80),
        compare="compare: {line: 3.0}  # x of the vertical line to compare along [m]",
    ),
}
_SHORT = """\
# yaml-language-server: $schema={schema}
# {title}. Every other key has a default:
# `sphrom case new {kind} --full` shows them all, with their units.
name: my-{kind}
scene:
  kind: {kind}{start.scene}
discretization:
  resolution: {start.resolution}  # particles along the reference length
time: {start.time}  # s
snapshots:
  every: {start.every}  # time steps from one that is kept to the next
parameters:
  train: {{reynolds: [{low:g}, {high:g}]}}  # full runs to learn from
  test: {{reynolds: [{middle:g}]}}  # a full run that checks the prediction
rom:
  # On fixed points: microseconds a run, whatever the number of particles.
  - {{name: fast, evaluation: operators, n_modes: {start.n_modes}}}
  # On moving particles, as in the paper, as slow as a full run:
  # - {{name: galerkin, n_modes: {start.n_modes}}}
{compare}# What `sphrom sweep` runs, by the fast model.
sweep:
  reynolds: {{low: {low:g}, high: {high:g}, count: 1000}}
"""


def require_kind(kind: str | None) -> str:
    """Return a known kind of scene. Raises CaseError, with the kinds, for another one or none."""
    known = scene_kinds()
    if kind in known:
        return str(kind)
    kinds = "\n".join(f"  {name:18} {_title(name)}" for name in known)
    close = get_close_matches(kind, known, n=1, cutoff=0.3) if kind else []
    hint = f"did you mean {close[0]}? " if close else ""
    wrong = "KIND: is missing" if kind is None else f"no scene is of kind {kind!r}"
    raise CaseError(f"{wrong}; {hint}the kinds are\n{kinds}")


def _title(kind: str) -> str:
    """Return what a kind of scene is called."""
    return next(section.title for section in get_args(AnyScene) if kind_of_section(section) == kind)


def new_case(kind: str, *, full: bool = False) -> str:
    """Return a commented case file for a kind of scene: a short one, or with every key.

    Raises CaseError for a kind that isn't known.
    """
    return _full_case(require_kind(kind)) if full else _short_case(require_kind(kind))


def _short_case(kind: str) -> str:
    start = _STARTS[kind]
    low, high = start.reynolds
    text = _SHORT.format(
        schema=SCHEMA_FILE,
        title=_title(kind),
        kind=kind,
        start=start,
        low=low,
        high=high,
        middle=0.5 * (low + high),
        compare=f"{start.compare}\n" if start.compare else "",
    )
    return "".join(f"{_aligned(line)}\n" for line in text.splitlines())


def _aligned(line: str) -> str:
    """Return a line whose comment, if one follows a value, begins in the column of comments."""
    value, mark, comment = line.partition("  # ")
    return f"{value.rstrip():{COMMENTS}}  # {comment}" if mark and value.strip() else line


def _full_case(kind: str) -> str:
    head = (
        f"# yaml-language-server: $schema={SCHEMA_FILE}",
        f"# A case of sphrom: {kind}.",
        "# Every key but name and scene.kind may be left out: it then has the value below, except",
        "# for parameters, rom and sweep, which hold an example. Units are in brackets.",
    )
    values = _example(kind).model_dump(mode="json")
    return "\n".join([*head, *_section(values, (), "", kind)]) + "\n"


def _example(kind: str) -> Case:
    least = {"name": f"my-{kind}", "scene": {"kind": kind}}
    (reynolds,) = Case.model_validate(least).parameters.train.reynolds
    values = {"train": (reynolds, 2.0 * reynolds), "test": (1.5 * reynolds,)}
    return Case.model_validate(
        {
            **least,
            "parameters": {group: {"reynolds": given} for group, given in values.items()},
            "rom": [
                {"name": "fast-m5", "evaluation": "operators", "n_modes": 5},
                *(
                    {"name": f"{projection}-m5", "projection": projection, "n_modes": 5}
                    for projection in PROJECTIONS
                ),
            ],
            "sweep": {"reynolds": {"low": reynolds, "high": 2.0 * reynolds, "count": 11}},
        }
    )


def _section(values: dict[str, Any], path: Path, indent: str, kind: str) -> Iterator[str]:
    for key, value in values.items():
        at = (*path, key)
        if not path:
            yield ""
        yield from _comment(at, indent, kind)
        if isinstance(value, dict) and value:
            yield f"{indent}{key}:"
            yield from _section(value, at, indent + INDENT, kind)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            yield f"{indent}{key}:"
            yield from _list(value, at, indent + INDENT, kind)
        else:
            yield f"{indent}{key}: {_inline(value)}"


def _list(entries: list[dict[str, Any]], path: Path, indent: str, kind: str) -> Iterator[str]:
    """Explain the keys of the first entry, and list the others."""
    for i, entry in enumerate(entries):
        lines = list(_section(entry, (*path, i), indent + INDENT, kind))
        first = next(n for n, line in enumerate(lines) if not line.lstrip().startswith("#"))
        yield from lines[:first] if i == 0 else ()
        yield f"{indent}- {lines[first].lstrip()}"
        for line in lines[first + 1 :]:
            if i == 0 or not line.lstrip().startswith("#"):
                yield line


def _comment(path: Path, indent: str, kind: str) -> Iterator[str]:
    node = schema.node_at(path, kind) or {}
    text = str(node.get("description", ""))
    if unit := node.get("unit"):
        text += f" [{unit}]"
    if not schema.is_section(node):
        text += f"; {schema.allowed(node)}"
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=indent + "# ", subsequent_indent=indent + "# "
    )


def _inline(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    return "{}" if value == {} else dump_yaml(value).removesuffix("...\n").strip()
