"""What keys are where nobody gives them, and how small and large they may be.

A default that changes, changes everyone's results.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sphrom.case.models import Case

MODEL = {"n_modes": 5, "basis": "all", "parameters": "all"}
PROJECTED = {**MODEL, "projection": "galerkin", "memory_length": "auto", "time_step": "auto"}
ON_PARTICLES = {**PROJECTED, "evaluation": "particles", "advection": "consistent"}
ON_POINTS = {
    **PROJECTED, "evaluation": "operators", "calibrated": "auto", "corrected": "auto",
    "integrated_modes": "auto", "output": "none", "until": None, "steady": False,
}  # fmt: skip
FIT = {"model": None, "parameters": {}, "noise": None, "starts": 8}


def test_defaults_of_models_and_fits() -> None:
    """Those of other sections are in `defaults.json`."""
    given = {"name": "x", "scene": {"kind": "taylor-green"}, "rom": [{"name": "x"}]}
    case = Case.model_validate(given).model_dump(mode="json")
    assert case["rom"] == [{"name": "x", **ON_PARTICLES}]
    usual = Case.model_validate({"name": "x", "scene": given["scene"]}).model_dump(mode="json")
    assert usual["rom"] == [{"name": "fast", **ON_POINTS}]
    assert case["fit"] == FIT


ANYWHERE = {
    "low", "high", "from", "to",
    "lower", "upper", "centre", "polygon", "line", "translate", "distance", "velocity", "rotation",
    "constants", "body_force", "u", "v", "w", "p", "box", "train", "test", "points", "sample",
    "parameters", "training", "level",
}  # fmt: skip
"""Keys whose numbers may have either sign."""


def numbers(node: Any, known: Any, name: str = "", within: tuple[str, ...] = ()) -> Iterator[Any]:
    """Yield the key, the least and the greatest value of every number of a JSON schema."""
    if "$ref" in node:
        reference = node["$ref"].rpartition("/")[2]
        if reference not in within:
            yield from numbers(known[reference], known, name, (*within, reference))
    several = [node.get(kind, ()) for kind in ("anyOf", "oneOf", "allOf")]
    for part in (*several[0], *several[1], *several[2]):
        yield from numbers(part, known, name, within)
    for key, part in node.get("properties", {}).items():
        yield from numbers(part, known, key, within)
    for kind in ("items", "additionalProperties"):
        if isinstance(node.get(kind), dict):
            yield from numbers(node[kind], known, name, within)
    if node.get("type") in ("number", "integer"):
        yield name, node.get("minimum"), node.get("maximum")


def test_every_section_is_described() -> None:
    sections = Case.model_json_schema()["$defs"]
    assert [name for name, section in sections.items() if "description" not in section] == []


def test_every_number_has_its_limits() -> None:
    schema = Case.model_json_schema()
    found = set(numbers(schema, schema["$defs"]))
    assert len(found) > 40
    for name, low, high in found:
        if name in ANYWHERE and low != 1e-12:
            assert (low, high) == (-1e12, 1e12), name
        else:
            assert low is not None, name
            assert high is not None, name
            assert low >= 0 or name == "rotate", name
            assert high <= 1e12, name
