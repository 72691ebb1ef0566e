"""Every option of a case leads to a run whose errors are finite and sane."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact

MODEL = {"name": "galerkin", "n_modes": 3}
OPTIONS = {
    "order 2": {"psi": {"order": 2}},
    "raw product, order 5": {
        "basis": {"inner_product": "raw"},
        "psi": {"order": 5, "polynomial_degree": 2},
    },
    "relaxed points, printed shifting": {
        "reference": {"points": "relaxed"},
        "discretization": {"shifting": {"form": "paper"}},
    },
    "B-splines, no shifting": {
        "reference": {"points": "lattice"},
        "psi": {"kind": "b-spline"},
        "discretization": {"shifting": {"enabled": False}},
    },
    "Shepard, wide map": {"reference": {"method": "shepard", "smoothing_length_ratio": 3.0}},
    "order 1, pair viscosity, no diffusion": {
        "psi": {"order": 1, "polynomial_degree": 0},
        "discretization": {"viscosity": "paper", "diffusion_coefficient": 0.0},
    },
    "lattice start, given step, no exact solution, late": {
        "discretization": {"initial_particles": "lattice"},
        "time": {"step": 0.01},
        "compare": {"exact": False, "from_time": 0.03},
    },
    "every step, in millimetres": {
        "scene": {"length": 1e-3},
        "fluid": {"reference_speed": 1e-3},
        "snapshots": {"every": 1},
    },
}
MODELS = {
    "galerkin": {},
    "advection-paper": {"advection": "paper"},
    "apg-given": {"projection": "apg", "memory_length": 1e-3},
    "apg-paper": {"projection": "apg", "advection": "paper"},
    "long-step": {"time_step": 0.016},
    "short-step": {"time_step": 0.004},
    "test": {"parameters": "test"},
    "listed": {"parameters": [150]},
}


@pytest.fixture
def run(empty, sphrom, case_text):
    """Run the case with one model at one value, and with some options."""

    def run_with(sections):
        case = yaml.safe_load(case_text(rom=[MODEL]))
        case["parameters"] = {"train": {"reynolds": [100]}}
        for section, values in sections.items():
            case[section] = case.get(section, {}) | values if isinstance(values, dict) else values
        (empty.parent.parent / "tiny.yaml").write_text(yaml.safe_dump(case))
        sphrom("run", "tiny.yaml", "--threads", 1, code=0)
        return empty

    return run_with


@pytest.mark.parametrize("option", OPTIONS)
def test_option(run, peaks, option):
    out = run(OPTIONS[option])
    velocity, pressure = peaks(out, "galerkin")
    from_map = peaks(out, "map")
    assert 0.0 < velocity < from_map[0] + 2.0
    assert 0.0 < pressure < from_map[1] + 30.0
    assert 0.0 < peaks(out, "best possible, all M=3")[1] < from_map[1] + 30.0


def test_models(run, peaks, errors_of):
    out = run(
        {
            "parameters": {"train": {"reynolds": [100]}, "test": {"reynolds": [150]}},
            "rom": [MODEL | {"name": name} | options for name, options in MODELS.items()],
        }
    )
    for name in MODELS:
        velocity, pressure = peaks(out, name)
        assert 0.0 < velocity < 2.0
        assert 0.0 < pressure < (40.0 if MODELS[name].get("advection") else 15.0)
    for step in ("long-step", "short-step"):
        np.testing.assert_allclose(peaks(out, step), peaks(out, "galerkin"), rtol=0.4)
    runs = {(row["compared"], row["parameters"]) for row in errors_of(out)}
    for name in ("test", "listed"):
        assert {parameters for model, parameters in runs if model == name} == {"reynolds=150"}


def test_lagrangian_singular_values_are_kept_beside_the_others(run):
    out = run({"basis": {"lagrangian": True}})
    with open_artifact(out / "pod.h5", "sphrom/basis", made_by="") as basis:
        assert basis.read("lagrangian/all/modes/density").shape == (3, 256)


def test_full_runs_alone(run, errors_of):
    """And a lattice is not packed."""
    out = run({"rom": [], "discretization": {"initial_particles": "lattice"}})
    assert {path.name for path in out.glob("*.h5")} == {"fom-reynolds100.h5", "compare.h5"}
    assert {(row["compared"], row["against"]) for row in errors_of(out)} == {("full", "exact")}


@pytest.mark.slow
def test_b_splines_serve_both_roads_as_polyharmonic_ones_do(run, sphrom, peaks, empty):
    """The same models from the same lattice, and a file that says what it holds."""
    fast = MODEL | {"name": "fast", "evaluation": "operators"}
    apg = MODEL | {"name": "apg", "projection": "apg"}
    polyharmonic = {"kind": "polyharmonic"}
    run({"reference": {"points": "lattice"}, "psi": polyharmonic, "rom": [MODEL, apg, fast]})
    names = ("galerkin", "apg", "fast")
    before = [peaks(empty, name) for name in names]
    kind = ("--set", "psi.kind=auto")
    result = sphrom("rom", "tiny.yaml", "--threads", 1, *kind, code=3)
    assert "psi.h5 holds 'sphrom/spline', not 'sphrom/b-spline'" in result.stderr
    sphrom("run", "tiny.yaml", "--force", "--threads", 1, *kind, code=0)
    after = [peaks(empty, name) for name in names]
    assert before != after
    np.testing.assert_allclose(after, before, rtol=0.1)
    with open_artifact(empty / "psi.h5", "sphrom/b-spline", made_by="") as artifact:
        shape = artifact.read("bases/all/lattice_shape")
        coefficients = artifact.read("bases/all/coefficients")
    assert coefficients.shape == (shape[1] + 3, shape[0] + 3, 9)
