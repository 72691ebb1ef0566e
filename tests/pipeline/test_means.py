"""Means after a gradual start, coefficients of forces, and errors by component."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import sphrom as package
from sphrom.artifacts import open_artifact
from tests.pipeline.conftest import rows

RAMP = 0.5
CASE: dict[str, Any] = {
    "name": "ramped",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1, 1], "periodic": ["x"]},
        "body_force": [f"1 - where(t < {RAMP}, 1 - t/{RAMP}, 0)", 0],
        "reference_length": 1.0,
        "measure": {
            "drag": {"force_on": "bottom", "coefficient": {"speed": 0.5, "length": 0.2}},
            "whole": {"force_on": "bottom", "from_time": 0.0},
            "wake": {"probe": [0.5, 0.5]},
            "beat": {"frequency": {"of": "drag_coefficient_x"}},
        },
    },
    "discretization": {"resolution": 8},
    "fluid": {"reference_density": 2.0},
    "time": {"final_time": 2.0},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [10, 20]}, "test": {"reynolds": [14]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
    "sweep": {"sample": {"count": 8, "reynolds": [10, 20]}, "quantiles": [0.5]},
    "trade": {"measure": "drag", "full_runs": False},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case's file, and its artifacts in `runs`."""
    folder = tmp_path_factory.mktemp("ramped")
    (folder / "case.yaml").write_text(yaml.safe_dump(CASE))
    result = sphrom("run", folder / "case.yaml", "--out", folder / "runs", "--threads", 1, code=0)
    (folder / "answer.txt").write_text(" ".join(result.output.split()))
    return folder


@pytest.fixture
def study(made: Path) -> package.Study:
    return package.Study(made / "case.yaml", out=made / "runs", quiet=True)


def test_a_comparison_counts_after_the_start_and_by_component(made: Path) -> None:
    table = rows(made / "runs/tables/measures.csv")
    table = [row for row in table if row["parameters"].endswith("14")]
    found = {(r["measured"], r["quantity"], r["compared"]): r for r in table}
    path = made / "runs/fom-reynolds14.h5"
    with open_artifact(path, "sphrom/trajectory", made_by="") as run:
        time = run.read("time")
        force = run.read("force/drag/pressure") + run.read("force/drag/viscous")
    late = time >= RAMP
    drag = found["drag", "force_x", "full"]
    assert float(drag["from_time [s]"]) == pytest.approx(RAMP, abs=2e-3)
    assert float(drag["mean"]) == pytest.approx(force[late, 0].mean())
    assert float(found["whole", "force_x", "full"]["mean"]) == pytest.approx(force[:, 0].mean())
    assert found["wake", "pressure", "full"]["from_time [s]"] == drag["from_time [s]"]
    coefficient = found["drag", "coefficient_x", "full"]
    expected = force[late, 0].mean() / (0.5 * 2.0 * 0.5**2 * 0.2)
    assert float(coefficient["mean"]) == pytest.approx(expected)
    assert coefficient["unit"] == "1"
    fast = found["drag", "force_x", "fast"]
    same = float(found["drag", "coefficient_x", "fast"]["estimated [%]"])
    assert same == pytest.approx(float(fast["estimated [%]"]))
    size = np.sqrt(np.mean(force[late, 0] ** 2))
    off = float(fast["rms_error"])
    assert float(fast["relative_l2 [%]"]) == pytest.approx(100.0 * off / size)
    answer = (made / "answer.txt").read_text()
    assert "Means and errors of measurements are computed from 0.5005 s on (drag, wake)." in answer
    assert "The measured force (drag) differs over time, as a vector by" in answer
    assert "The oscillation (beat) can't be compared: fewer than three periods of an" in answer


def test_a_sweep_counts_after_the_start(made: Path, study: package.Study, sphrom) -> None:
    said = sphrom("sweep", made / "case.yaml", "--out", made / "runs", "--workers", 1, code=0)
    text = " ".join(said.output.split())
    assert "means and errors of measurements are computed from 0.5005 s on (drag, wake)" in text
    assert "beat: 8 of 8 runs have no frequency and no amplitude" in text
    row, *_ = rows(made / "runs/sweep-fast.csv")
    run = study.model("fast", reynolds=float(row["reynolds"])).run()
    force = run.measures.drag_force
    late = run.time >= RAMP
    expected = float(force.values[late, 0].mean())
    assert float(row["drag_force_x_mean [N/m]"]) == pytest.approx(expected)
    assert float(row["drag_coefficient_x_mean [1]"]) == pytest.approx(20.0 * expected)
    assert float(row["whole_force_x_mean [N/m]"]) == pytest.approx(float(force.values[:, 0].mean()))
    assert float(row["error_estimate_drag_force_x [%]"]) > 0.0
    assert row["beat_amplitude [1]"] == ""
    table, quantiles = (rows(made / f"runs/sweep-fast{end}.csv") for end in ("", "-quantiles"))
    means = [float(each["drag_force_x_mean [N/m]"]) for each in table]
    outputs = {each["output"]: each for each in quantiles if each["statistic"] == "mean"}
    assert float(outputs["drag_force_x_mean"]["value"]) == pytest.approx(np.mean(means))
    assert "beat_amplitude" not in outputs


def test_python_tells_means_and_the_time_from_which_they_count(study: package.Study) -> None:
    run = study.model("fast", reynolds=14.0).run()
    measures, means = run.measures, run.means
    assert measures.drag_force.from_time == pytest.approx(RAMP, abs=2e-3)
    assert measures.whole_force.from_time == 0.0
    np.testing.assert_allclose(measures.drag_coefficient, 20.0 * measures.drag_force)
    late = run.time >= RAMP
    np.testing.assert_allclose(means.drag_force, measures.drag_force.values[late].mean(axis=0))
    assert (means.wake_pressure.dims, means.wake_velocity.dims) == ((), ("component",))
    steps = run.time[1] - run.time[0]
    short = study.model("fast", reynolds=14.0).run(final_time=float(5 * steps))
    assert np.isnan(short.means.drag_force).all()  # it ends before


def test_a_trade_tells_components(made: Path, sphrom) -> None:
    sphrom("trade", made / "case.yaml", "--out", made / "runs", code=0)
    *_, model = rows(made / "runs/trade/models.csv")
    whole, along = (f"measured_force{part}_relative_l2 [%]" for part in ("", "_x"))
    assert float(model[whole]) > 0.0
    assert float(model[along]) > 0.0


@pytest.mark.parametrize(("ramp", "begin"), [(0.6, 0.6), (0.0, 0.0)])
def test_a_lid_and_an_inflow_count_after_their_ramps(ramp: float, begin: float) -> None:
    lid = {"kind": "lid-driven-cavity", "lid_ramp": ramp, "measure": {"drag": {"force_on": "top"}}}
    case = package.Study({"name": "x", "scene": lid, "time": {"final_time": 2.0}}).case
    assert case.plan.means_from == {"drag": begin}
    inflow = {"strip": {"from": 0, "to": 1}, "velocity": [1.0, 0], "ramp": ramp}
    box = {"lower": [0, 0], "upper": [4, 1], "periodic": ["x"]}
    scene = {"kind": "custom", "box": box, "inflow": inflow, "reference_length": 1.0,
             "measure": {"wake": {"probe": [2, 0.5]}}}  # fmt: skip
    case = package.Study({"name": "x", "scene": scene, "time": {"final_time": 2.0}}).case
    assert case.plan.means_from == {"wake": begin}
