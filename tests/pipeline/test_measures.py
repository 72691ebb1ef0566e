"""What a case measures, through the command line: forces, flow rates, probes and lines."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.api.study import Study
from sphrom.artifacts import Artifact, open_artifact
from sphrom.artifacts.labelled import open_labelled
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.models.stored_run import StoredRun
from sphrom.plots.tables import read_csv
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.particles import MeasuredFields
from sphrom.store.trajectory import read_forces, read_quantities
from sphrom.store.workspace import Workspace

CASE: dict[str, Any] = {
    "name": "body",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1.6, 1.6], "periodic": ["x"]},
        "solids": {"cylinder": {"circle": {"centre": [0.8, 0.8], "radius": 0.25}}},
        "walls": {"cylinder": {"rotation": 0.5}},
        "body_force": ["1.5*(1 + 0.2*sin(3*t))", 0],
        "reference_length": 0.5,
        "measure": {
            "drag": {"force_on": "cylinder"},
            "roof": {"force_on": "top"},
            "flux": {"flow_rate": {"from": [0.1, 0], "to": [0.1, 1.6]}},
            "gap": {"flow_rate": {"from": [0.8, 1.05], "to": [0.8, 1.6]}},
            "under": {"flow_rate": {"from": [0.8, 0], "to": [0.8, 0.55]}},
            "wake": {"probe": [1.3, 0.8]},
            "profile": {"line": {"from": [1.3, 0], "to": [1.3, 1.6], "points": 9}},
        },
    },
    "discretization": {"resolution": 8},
    "time": {"final_time": 0.3},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [10, 20]}},
    "rom": [
        {
            "name": "fast",
            "evaluation": "operators",
            "n_modes": 4,
            "calibrated": False,
            "corrected": False,
            "output": "snapshots",
        },
        {"name": "faithful", "n_modes": 4, "parameters": [20]},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
    "sweep": {"reynolds": [12, 15]},
}
FULL, RATE = ParameterPoint(20.0), "reynolds20"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case's file, and its artifacts in `runs`."""
    folder = tmp_path_factory.mktemp("forces")
    (folder / "body.yaml").write_text(yaml.safe_dump(CASE))
    sphrom("run", folder / "body.yaml", "--out", folder / "runs", "--threads", 1, code=0)
    return folder


@pytest.fixture
def opened(made: Path) -> Callable[[str], Artifact]:
    """Open an artifact by its name."""
    return lambda name: open_artifact(made / "runs" / name, None, made_by="")


@pytest.mark.parametrize("name", ["fom", "rom-faithful"])
def test_what_is_stored_is_that_of_the_snapshots(made: Path, opened, name: str) -> None:
    case = load_case(made / "body.yaml")
    forces = particles.wall_forces(case, FULL, particles.functional(case, FULL))
    fields = MeasuredFields.of(case)
    assert fields is not None
    with opened(f"{name}-{RATE}.h5") as run:
        time, density, velocity = map(run.read, ("time", "density_fluctuation", "velocity"))
        for i in (0, len(time) - 1):
            place = run.read("position")[i]
            for measured, quantities in fields(place, density[i], velocity[i]).items():
                for quantity, values in quantities.items():
                    stored = run.read(f"measure/{measured}/{quantity}")[i]
                    tolerance = 1e-9 * np.abs(values).max() + 1e-12
                    np.testing.assert_allclose(stored, values, atol=tolerance)
            found = forces(np.vstack((place.T, density[i], velocity[i].T)), float(time[i]))
            for measured in ("drag", "roof"):
                stored = read_forces(run, measured)[i]
                np.testing.assert_allclose(stored, found[measured], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", [None, "fast", "faithful"])
def test_all_ways_to_a_place_give_one_field(made: Path, sphrom, name: str | None) -> None:
    """Comparison, export, probes, rebuilt points and Python: none interpolates again."""
    case, place = load_case(made / "body.yaml"), ("--out", made / "runs", "--only", "reynolds=20")
    model = next((model for model in case.rom if model.name == name), None)
    workspace = Workspace(StageContext(case, made / "runs", False, 1, None))
    with StoredComparison.of(workspace) as comparison:
        line, compared = comparison.samples(name, FULL)
    wanted = np.dstack((compared.velocity, compared.pressure))
    asked = ("--to", "csv", "--into", made / "tables", "--force")
    sphrom("export", made / "body.yaml", *place, *asked, code=0)
    _, rows = read_csv(made / "tables" / f"{f'rom-{name}' if name else 'fom'}-{RATE}.csv", "")
    table = np.array(rows, dtype=float)[:, 3:].reshape(wanted.shape)
    np.testing.assert_array_equal(table, wanted)
    with StoredRun.opened(workspace, FULL, model) as run:
        wake, probe = run.sampled(np.array([[1.3, 0.8]])), run.measured("wake")
        if name == "fast":
            there = run.sampled(run.position(3), [3])
            np.testing.assert_allclose(run.fields(3)[0], there.velocity[0], atol=1e-9)
    np.testing.assert_allclose(probe["velocity"], wake.velocity, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(probe["pressure"], wake.pressure, rtol=1e-9, atol=1e-9)
    if name:
        study = Study(made / "body.yaml", out=made / "runs", quiet=True)
        fields = study.model(name, reynolds=20).run().fields(line)
        found = np.dstack((fields.velocity, fields.pressure))
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


def test_a_stopped_run_goes_on_to_the_same_forces(
    made: Path, tmp_path: Path, sphrom, digests, stop_at
) -> None:
    (tmp_path / "runs").mkdir()
    shutil.copy(made / "runs" / "packing.h5", tmp_path / "runs")
    command = ("fom", made / "body.yaml", "--out", tmp_path / "runs", "--only", "reynolds=20")
    stop_at(9)
    sphrom(*command, "--threads", 1, code=130)
    again = sphrom(*command, "--threads", 1, "--resume")
    assert "goes on from its checkpoint" in again.output
    name = f"fom-{RATE}.h5"
    assert digests(tmp_path / "runs")[name] == digests(made / "runs")[name]


def over_time(opened, run: str, name: str) -> Any:
    """Return what a run has of a measurement, by quantity."""
    with opened(f"{run}-{RATE}.h5") as artifact:
        return read_quantities(artifact, name)


@pytest.mark.parametrize("run", ["fom", "rom-fast", "rom-faithful"])
def test_what_flows_in_flows_around_the_cylinder(opened, run: str) -> None:
    """At eight particles per diameter sections beside it have 0.4 to 0.7 % less."""
    flux, gap, under = (over_time(opened, run, n)["flow_rate"] for n in ("flux", "gap", "under"))
    assert flux[-1] > 0.5
    assert gap[-1] + under[-1] == pytest.approx(flux[-1], rel=0.012)


def test_reduced_measurements_follow_the_full_run_s(opened) -> None:
    """Measured: 0.8 % of the flow rate, 1.4 % of velocities."""
    for name, quantity, most in (
        ("flux", "flow_rate", 0.03),
        ("wake", "velocity", 0.03),
        ("profile", "velocity", 0.03),
        ("drag", "force", 0.04),
    ):
        full, fast = (over_time(opened, run, name)[quantity][1:] for run in ("fom", "rom-fast"))
        assert np.linalg.norm(fast - full) < most * np.linalg.norm(full)


def test_tables_show_what_is_measured(made: Path) -> None:
    headings, rows = read_csv(made / "runs" / "tables" / "measures.csv", "")
    found = [dict(zip(headings, row, strict=True)) for row in rows]
    assert {row["measured"] for row in found} == set(CASE["scene"]["measure"])
    runs = {row["compared"] for row in found if row["parameters"] == "reynolds=20"}
    assert runs == {"full", "map", "best possible, all M=4", "fast", "faithful"}
    error = {
        row["compared"]: row["relative_l2 [%]"]
        for row in found
        if (row["measured"], row["parameters"]) == ("flux", "reynolds=20")
    }
    assert error["full"] == ""
    assert 0.0 < float(error["map"]) < float(error["fast"]) < 2.0


@pytest.mark.slow
def test_figures_and_a_report_show_what_is_measured(made: Path, sphrom) -> None:
    place = (made / "body.yaml", "--out", made / "runs", "--set", "compare.plots=true")
    for command in (("compare", "--force"), ("report",)):
        sphrom(*command[:1], *place, *command[1:], "--threads", 1, code=0)
    assert "Measurements over time" in (made / "runs" / "report.html").read_text()
    plots = {path.name for path in (made / "runs" / "plots").iterdir()}
    for name in ("force-drag", "measure-flux", "measure-wake", "measure-profile"):
        assert f"{name}-{RATE}.png" in plots


def test_sweeps_have_columns_for_what_is_measured(made: Path, sphrom) -> None:
    result = sphrom("sweep", made / "body.yaml", "--out", made / "runs", "--workers", 1, code=0)
    assert "flux flow rate mean [m2/s]" in result.output
    headings, rows = read_csv(made / "runs" / "sweep-fast.csv", "")
    last = dict(zip(headings, rows[-1], strict=True))
    study = Study(made / "body.yaml", out=made / "runs", quiet=True)
    measures = study.model("fast", reynolds=15).run().measures
    assert float(last["drag_force_x_mean [N/m]"]) == float(measures.drag_force[:, 0].mean())
    assert float(last["flux_flow_rate_last [m2/s]"]) == float(measures.flux_flow_rate[-1])
    assert float(last["wake_velocity_x_greatest [m/s]"]) == float(
        measures.wake_velocity.sel(component="x").max()
    )
    assert not any(heading.startswith("profile") for heading in headings)
    with open_artifact(made / "runs" / "sweep-fast.h5", "sphrom/sweep", made_by="") as sweep:
        final = sweep.read("measure/profile/final_velocity")
        np.testing.assert_array_equal(final[1], measures.profile_velocity[-1])


def test_measures_in_python_have_axes_and_units(made: Path) -> None:
    study = Study(made / "body.yaml", out=made / "runs", quiet=True)
    model = study.model("fast", reynolds=20)
    result = model.run()
    found = result.measures
    many, slopes = model.run_many({"reynolds": [20, 12]}), model.sensitivities().measures
    with open_labelled(made / "runs" / f"rom-fast-{RATE}.h5") as stored:
        for name, values in found.items():
            assert stored[name].dims == values.dims
            np.testing.assert_allclose(stored[name], values, rtol=1e-12)
            np.testing.assert_array_equal(many[name].isel(run=0), values)
            assert slopes[name].dims == ("parameter", *values.dims)
            assert (many[f"error_estimate_{name}"].isel(run=1, snapshot=-1) > 0.0).all()
        stored_as = stored.error_estimate_wake_velocity.long_name
    assert stored_as == "error estimate: velocity at the places"
    assert many.error_estimate_wake_velocity.long_name == "velocity of wake, estimated error"
    assert found.drag_force.dims == found.wake_velocity.dims == ("snapshot", "component")
    assert found.flux_flow_rate.attrs["units"] == "m2/s"
    assert found.profile_pressure.dims == ("snapshot", "profile_place")
    once, late = model.measures(result.coordinates[-1]), found.sel(time=0.3)
    for name in ("drag_force", "flux_flow_rate", "profile_velocity"):
        np.testing.assert_allclose(once[name][0], late[name], rtol=1e-12)
    on_particles = study.model("faithful", reynolds=20).run().measures
    assert set(on_particles.data_vars) == set(found.data_vars)


LISTS = ("trade.n_modes=[2,4]", "trade.full_runs=false", "trade.repeats=1")


@pytest.mark.parametrize(
    ("measured", "judged"), [("drag", ["force"]), ("wake", ["velocity", "pressure"])]
)
def test_a_trade_can_judge_by_what_is_measured(
    made: Path, sphrom, measured: str, judged: list[str]
) -> None:
    sets = [part for key in (*LISTS, f"trade.measure={measured}") for part in ("--set", key)]
    sphrom("trade", made / "body.yaml", "--out", made / "runs", "--tolerance", "50%", *sets, code=0)
    document = json.loads((made / "runs" / "trade" / "trade.json").read_text())
    assert document["about"]["judged_by"] == f"relative L2 error of {measured} over time"
    own, *models = document["models"]
    small, large = (next(m for m in models if m["n_modes"] == n) for n in (2, 4))
    for name in (f"measured_{quantity}_relative_l2" for quantity in judged):
        assert 0.0 == own[name] < large[name] < small[name]
