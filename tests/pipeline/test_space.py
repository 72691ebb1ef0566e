"""Three-dimensional runs: all stages, stopped runs, measurements."""

from __future__ import annotations

import copy
import re
from typing import Any

import numpy as np
import pytest
from pandas import read_csv

from sphrom.artifacts import open_artifact
from sphrom.store.trajectory import read_quantities

VORTEX: dict[str, Any] = {
    "name": "vortex",
    "scene": {"kind": "taylor-green-3d"},
    "discretization": {"resolution": 9, "initial_particles": "lattice"},
    "time": {"final_time": 1.0},
    "snapshots": {"every": 1},
    "parameters": {"train": {"reynolds": [20, 50]}, "test": {"reynolds": [30]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False, "grid": 12, "line_points": 11},
}
DUCT: dict[str, Any] = {
    "name": "duct",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0, 0], "upper": [1, 1, 1.25], "periodic": ["x"]},
        "walls": {"front": {"velocity": ["-0.5", 0, 0]}},
        "body_force": [1.0, 0, 0],
        "measure": {
            **{f"on_{name}": {"force_on": name} for name in ("bottom", "top", "back", "front")},
            "first": {"flow_rate": {"from": [0.25, 0, 0], "to": [0.25, 1, 1.25]}},
            "second": {"flow_rate": {"from": [0.75, 0, 0], "to": [0.75, 1, 1.25]}},
            "middle": {"probe": [0.5, 0.5, 0.625]},
        },
    },
    "discretization": {"resolution": 8},
    "time": {"final_time": 0.2, "spin_up": 0.1},
    "snapshots": {"every": 1},
    "parameters": {"train": {"reynolds": [20]}},
    "rom": [],
    "compare": {"plots": False, "grid": 12, "line_points": 11},
}
RUN = "fom-reynolds20.h5"


def test_all_stages_lead_to_the_fast_model(made, peaks) -> None:
    folder = made(VORTEX)
    velocity, pressure = peaks(folder, "fast")
    assert 0.0 < velocity < 2.0
    assert 0.0 < pressure < 30.0
    with open_artifact(folder / "fom-reynolds30.h5", "sphrom/trajectory", made_by="") as run:
        assert run.read("position").shape[1:] == (9**3, 3)
        energy = 0.5 * np.mean(np.sum(run.read("velocity") ** 2, axis=2), axis=1)
        # At first the vortex decays as its modes do, by 2 nu (1 + 1 + 1) of its energy.
        rate = np.polyfit(run.read("time")[:3], np.log(energy[:3]), 1)[0]
    assert rate == pytest.approx(-6.0 / 30.0, rel=0.1)


def test_forces_flow_rates_and_probes_have_all_components(made) -> None:
    folder = made(DUCT)
    with open_artifact(folder / RUN, "sphrom/trajectory", made_by="") as run:
        first, second = (read_quantities(run, name)["flow_rate"] for name in ("first", "second"))
        np.testing.assert_allclose(first, second, rtol=1e-3)
        walls = ("on_bottom", "on_top", "on_back", "on_front")
        forces = np.sum([read_quantities(run, name)["force"] for name in walls], axis=0)
        time = run.read("time")
        mass = 1.25 * run.number("reference_density")
        momentum = mass * run.read("velocity").mean(axis=1)
        energy = 0.5 * mass * np.mean(np.sum(run.read("velocity") ** 2, axis=2), axis=1)
        probe = read_quantities(run, "middle")["velocity"]
    assert forces.shape == momentum.shape == (len(time), 3)
    flow = read_csv(folder / "tables" / "flow.csv").iloc[0]
    counted = time >= flow["from_time [s]"] - 1e-9
    assert flow["kinetic_energy [J]"] == pytest.approx(energy[counted].mean(), rel=1e-6)
    assert time[0] == pytest.approx(0.1)
    gained = np.trapezoid(np.array([mass, 0.0, 0.0]) - forces, time, axis=0)
    np.testing.assert_allclose(momentum[-1] - momentum[0], gained, rtol=0.02, atol=1e-3 * mass)
    assert probe.shape[1:] == (1, 3)
    assert np.all(np.diff(probe[:, 0, 0]) > 0.0)


@pytest.mark.parametrize("step", [1, 4])
def test_a_stopped_run_goes_on_to_the_same_bits(copied, sphrom, content, stop_at, step) -> None:
    folder = copied(DUCT)
    before = content(folder / RUN)
    (folder / RUN).unlink()
    stop_at(step)
    sphrom("fom", "duct.yaml", "--threads", 1, code=130)
    sphrom("fom", "duct.yaml", "--threads", 1, "--resume", code=0)
    assert content(folder / RUN) == before


def test_an_unstable_run_says_where_with_three_coordinates(written, refused) -> None:
    case = copy.deepcopy(VORTEX)
    case["time"] |= {"step": 1.0, "final_time": 20.0}
    written(case)
    error = refused("fom", "vortex.yaml", "--force", "--threads", 1, code=4)
    number = r"-?[\d.e+-]+"
    place = rf"particle \d+ at \({number}, {number}, {number}\) m"
    assert re.search(rf"unstable .*{place}", error)
    assert "the time step is beyond its limit" in error


def test_training_and_fits_work_in_three_dimensions(written, sphrom) -> None:
    case = copy.deepcopy(VORTEX)
    case["discretization"]["smoothing_length_ratio"] = 1.5
    case["time"]["final_time"] = 0.7
    case["parameters"] = {"test": {"reynolds": [30]}}
    case["training"] = {"reynolds": [20, 50], "tolerance": "5%", "budget": 3}
    folder = written(case)
    sphrom("train", "vortex.yaml", "--threads", 1, "--workers", 1, code=0)
    trained = folder / "training" / "case.yaml"
    only = ("--only", "reynolds=30")
    sphrom("fom", trained, "--threads", 1, *only, code=0)
    places = ("--at", "1.5,0.7,2.0", "--at", "3.0,1.0,1.0")
    sphrom("export", trained, "--to", "csv", *places, *only, code=0)
    table = folder / "export" / "fom-reynolds30.csv"
    sphrom("fit", trained, table, "--noise", "1%", "--name", "places", code=0)
    found = read_csv(folder / "fit-places.csv").iloc[0]
    assert found["value"] == pytest.approx(30.0, rel=0.1)
