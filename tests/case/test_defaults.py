"""What keys are where nobody gives them, and how small and large they may be.

A default that changes, changes everyone's results.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest
import yaml

from sphrom.case.models import Case

COMMON = """
fluid: {mach_number: 0.1}
discretization:
  diffusion_coefficient: 0.1
  acoustic_damping: 1.0
  viscosity: laplacian
  initial_particles: auto
  packing: {seed: 0, perturbation: 0.5, tolerance: 0.001, max_iterations: 2000}
  fixed_volume: true
  shifting: {enabled: true, amplitude: 1.0, form: sun, transport: advective}
  walls: {no_slip: linear, continuity: adjoint, layers: null}
time: {step: auto}
snapshots: {every: 10}
reference: {points: initial, method: mls, smoothing_length_ratio: null}
basis:
  {n_modes: null, inner_product: acoustic, centred: false, fields: joint, mean_density: auto,
   lagrangian: false, subsets: {}}
psi: {kind: auto, order: 3, cell_width_ratio: null}
operators: {advection: spline, density_order: 1, error_estimate: auto}
rom:
- evaluation: particles
  projection: galerkin
  n_modes: 5
  basis: all
  advection: consistent
  memory_length: auto
  jacobian_step: 1.0e-05
  time_step: auto
  calibrated: auto
  corrected: auto
  output: none
  until: null
  steady: false
  tracers: false
  parameters: all
compare: {line: null, line_points: 101, grid: 50, plots: true, from_time: 0.0}
trade:
  evaluations: [operators]
  projections: null
  n_modes: null
  bases: null
  inner_products: null
  calibrated: [true]
  step_factors: [1.0, 2.0]
  courant_numbers: [0.75, 1.5]
  resolutions: null
  parameters: auto
  probes: field
  statistic: overall
  repeats: 5
  extremes:
    reynolds_factors: [0.1, 0.3, 1.0, 3.0, 10.0]
    mach_numbers: [0.02, 0.05, 0.1, 0.2, 0.3]
    smoothing_length_ratios: [1.3, 1.5, 2.0, 3.0, 4.0]
    full_runs: true
sweep: {name: null, model: null, coordinates: true, error_estimate: true, probes: []}
fit: {model: null, parameters: {}, noise: null, starts: 8}
"""
SCENES = {
    "taylor-green": """
scene: {length: 1.0, pressure_sign: exact}
fluid: {reference_density: 1000.0, reference_speed: 1.0}
discretization: {resolution: 100, smoothing_length_ratio: 4.0}
time: {spin_up: 0.0, final_time: 1.0, courant_number: 1.2}
parameters: {train: {reynolds: [100.0]}, test: {reynolds: []}}
psi: {polynomial_degree: 1}
compare: {exact: true}
""",
    "lid-driven-cavity": """
scene: {length: 1.0, lid: regularised, lid_ramp: 0.0}
fluid: {reference_density: 1.0, reference_speed: 1.0}
discretization: {resolution: 100, smoothing_length_ratio: 2.0}
time: {spin_up: 0.0, final_time: 10.0, courant_number: 1.2}
parameters: {train: {reynolds: [100.0]}, test: {reynolds: []}}
psi: {polynomial_degree: 3}
compare: {exact: false}
""",
    "open-cavity": """
scene:
  channel_length: 0.4
  channel_height: 0.1
  cavity_length: 0.2
  cavity_height: 0.1
  body_force:
    {magnitude: 100.0, rate: 400.0, switch_time: 0.03, sustained_share: 0.0058, form: kick}
fluid: {reference_density: 1.0, reference_speed: 2.0}
discretization: {resolution: 200, smoothing_length_ratio: 2.0}
time: {spin_up: 5.0, final_time: 6.0, courant_number: 0.75}
parameters: {train: {reynolds: [2400.0]}, test: {reynolds: []}}
psi: {polynomial_degree: 3}
compare: {exact: false}
""",
}


def of_keys(values: Any, named: Any) -> Any:
    """Return what values have at the keys that are named."""
    if isinstance(named, Mapping) and isinstance(values, Mapping):
        return {key: of_keys(values[key], named[key]) for key in named}
    if isinstance(named, list) and isinstance(values, list) and len(named) == len(values):
        return [of_keys(*pair) for pair in zip(values, named, strict=True)]
    return values


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("which", ["common", "of the scene"])
def test_defaults(kind: str, which: str) -> None:
    given = {"scene": {"kind": kind}, "rom": [{"name": "x"}], "trade": {}}
    case = Case.model_validate({"name": "x", **given, "sweep": {"reynolds": [100.0]}})
    expected = yaml.safe_load(COMMON if which == "common" else SCENES[kind])
    assert of_keys(case.model_dump(mode="json"), expected) == expected


ANYWHERE = {
    "lower", "upper", "centre", "polygon", "line", "translate", "distance", "velocity", "rotation",
    "constants", "body_force", "u", "v", "p", "box", "train", "test", "points", "sample",
    "parameters", "training",
}  # fmt: skip
"""Keys whose numbers may have either sign."""
LIMITS = {
    (0.0, 1.0): "diffusion_coefficient perturbation sustained_share density_order",
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
    (1.0, 16.0): "cell_width_ratio",
    (1.0, 1e4): "oversampling integrated_modes n_modes modes",
    (1, 7): "order",
    (1, 32): "layers",
    (1, 1000): "repeats starts",
    (1, 100_000): "candidates count",
    (1, 1_000_000): "max_iterations",
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
