"""What keys are where nobody gives them, and how small and large they may be.

A default that changes, changes everyone's results.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sphrom.case.models import Case

MODEL = {
    "evaluation": "particles", "projection": "galerkin", "n_modes": 5, "basis": "all",
    "advection": "consistent", "memory_length": "auto", "jacobian_step": 1e-5, "time_step": "auto",
    "calibrated": "auto", "corrected": "auto", "integrated_modes": "auto", "output": "none",
    "until": None, "steady": False, "tracers": False, "parameters": "all",
}  # fmt: skip
FIT = {"model": None, "parameters": {}, "noise": None, "starts": 8}


def test_defaults_of_models_and_fits() -> None:
    """Those of other sections are in `defaults.json`."""
    given = {"name": "x", "scene": {"kind": "taylor-green"}, "rom": [{"name": "x"}]}
    case = Case.model_validate(given).model_dump(mode="json")
    assert case["rom"] == [{"name": "x", **MODEL}]
    assert case["fit"] == FIT


ANYWHERE = {
    "lower", "upper", "centre", "polygon", "line", "translate", "distance", "velocity", "rotation",
    "constants", "body_force", "u", "v", "p", "box", "train", "test", "points", "sample",
    "parameters", "training",
}  # fmt: skip
"""Keys whose numbers may have either sign."""
LIMITS = {
    (0.0, 1.0): "diffusion_coefficient sustained_share",
    (0.0, 10.0): "amplitude acoustic_damping",
    (0, 4294967295): "seed",
    (0, 3): "polynomial_degree",
    (-360.0, 360.0): "rotate",
    (1e-12, 1.0): "tolerance jacobian_step",
    (1e-6, 1.5): "courant_number",
    (1e-6, 1e3): "noise",
    (1e-4, 1.0 - 1e-4): "quantiles",
    (0.001, 0.3): "mach_number mach_numbers",
    (0.001, 1.5): "courant_numbers",
    (0.01, 100.0): "reynolds_factors step_factors",
    (1.2, 8.0): "smoothing_length_ratio smoothing_length_ratios",
    (1.0, 1e4): "oversampling integrated_modes n_modes modes",
    (1, 7): "order",
    (1, 32): "layers",
    (1, 1000): "repeats starts",
    (1, 100_000): "candidates count",
    (1, 1_000_000_000): "every",
    (2, 2000): "grid",
    (2, 10_000): "budget",
    (2, 100_000): "line_points",
    (8, 100_000): "resolution resolutions",
}
"""Of numbers by the names of their keys; all others are from 1e-12, or 0, to 1e12."""


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


def test_every_number_has_its_limits() -> None:
    schema = Case.model_json_schema()
    of_names = {name: limits for limits, names in LIMITS.items() for name in names.split()}
    found = set(numbers(schema, schema["$defs"]))
    assert len(found) > 40
    # Places are anywhere, and Reynolds numbers stand beside other parameters.
    elsewhere = {("probes", None, None), ("parameters", 1e-12, 1e12)}
    for name, low, high in found - elsewhere:
        if name in ANYWHERE:
            assert (low, high) == (-1e12, 1e12), name
        elif name in of_names:
            assert (low, high) == of_names[name], name
        else:
            assert (low in (0.0, 1e-12), high) == (True, 1e12), name
