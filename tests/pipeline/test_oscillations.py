"""Frequency, amplitude and mean of measured histories: from all commands, and in fits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import sphrom as package
from sphrom.fit.forward_model import Box, FittedEquations
from sphrom.fit.measurements import read_measurements
from sphrom.models.points.fast_model import FastModel
from sphrom.store.workspace import Workspace
from sphrom.sweep import batches, statistics
from tests.pipeline.conftest import rows

CASE: dict[str, Any] = {
    "name": "swing",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1, 1], "periodic": ["x"]},
        "constants": {"swing": 1.0},
        "walls": {"top": {"velocity": [0.5, 0]}},
        "body_force": ["2*swing*sin(2*pi*2.5*t)", 0],
        "reference_length": 1.0,
        "measure": {
            "floor": {"force_on": "bottom"},
            "flux": {"flow_rate": {"from": [0.5, 0], "to": [0.5, 1]}},
            "beat": {"frequency": {"of": "flux_flow_rate", "from_time": 0.3}},
            "shake": {"frequency": {"of": "floor_force_x"}},
        },
    },
    "discretization": {"resolution": 8},
    "time": {"final_time": 2.0},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [10, 20], "swing": [0.5, 1.0]},
                   "test": {"reynolds": [14], "swing": [0.7]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 4, "calibrated": False,
             "corrected": False}],  # such a model has a steady flow without force
    "compare": {"plots": False, "grid": 12, "line_points": 21},
    "sweep": {"reynolds": [14], "parameters": {"swing": [0.0, 0.5, 1.0]}},
    "trade": {"measure": "beat", "full_runs": False},
    "fit": {"parameters": {"reynolds": 14.0}, "starts": 2},
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case's file, and its artifacts in `runs`."""
    folder = tmp_path_factory.mktemp("swing")
    (folder / "case.yaml").write_text(yaml.safe_dump(CASE))
    result = sphrom("run", folder / "case.yaml", "--out", folder / "runs", "--threads", 1, code=0)
    (folder / "answer.txt").write_text(" ".join(result.output.split()))
    return folder


def test_comparison_tells_frequency_amplitude_and_phase(made: Path) -> None:
    table = rows(made / "runs/tables/oscillations.csv")
    found = {(r["measured"], r["compared"]): r for r in table if "swing=0.7" in r["parameters"]}
    full, fast = found["beat", "full"], found["beat", "fast"]
    assert float(full["frequency [Hz]"]) == pytest.approx(2.5, rel=2e-3)
    assert full["frequency_error [%]"] == full["phase_error [deg]"] == ""
    ratio = float(fast["amplitude"]) / float(full["amplitude"])
    assert float(fast["amplitude_error [%]"]) == pytest.approx(100.0 * abs(ratio - 1.0))
    assert abs(float(fast["phase_error [deg]"])) < 2.0
    assert ("beat", "map") in found
    assert ("shake", "map") not in found  # the map tells no forces
    answer = (made / "answer.txt").read_text()
    assert "The oscillation (beat) differs by" in answer
    assert "degrees in phase; all errors over time include this phase." in answer
    later = {"scene.measure.beat.frequency.from_time": 0.5}
    study = package.Study(made / "case.yaml", out=made / "runs", set=later, quiet=True)
    workspace = Workspace(study._context)
    assert workspace.reason_to_make(workspace.operators()) is None
    assert "from_time is 0.3 there, 0.5 here" in workspace.reason_to_make(workspace.comparison())


def test_a_sweep_and_python_tell_where_nothing_oscillates(made: Path, sphrom) -> None:
    said = sphrom("sweep", made / "case.yaml", "--out", made / "runs", "--workers", 1, code=0)
    still, half, whole = rows(made / "runs/sweep-fast.csv")
    assert (still["beat_frequency [Hz]"], still["beat_amplitude [m2/s]"]) == ("", "")
    assert still["beat_reason"] == "fewer than three periods of an oscillation"
    assert half["beat_reason"] == ""
    words = "beat: 1 of 3 runs have no frequency and no amplitude, and statistics leave them out"
    assert words in " ".join(said.output.split())
    sizes = [float(row["beat_amplitude [m2/s]"]) for row in (half, whole)]
    assert sizes[1] == pytest.approx(2.0 * sizes[0], rel=0.02)
    study = package.Study(made / "case.yaml", out=made / "runs", quiet=True)
    model = study.model("fast", reynolds=14.0, swing=1.0)
    several = model.run_many({"reynolds": 14.0, "swing": [0.0, 1.0]})
    assert several.beat_amplitude.dims == ("run",)
    expected = [pytest.approx(np.nan, nan_ok=True), pytest.approx(sizes[1])]
    assert several.beat_amplitude.values.tolist() == expected
    assert several.beat_amplitude.missing == still["beat_reason"]
    assert np.isnan(several.beat_frequency.values).tolist() == [True, False]
    one = model.run().measures
    assert (one.beat_frequency.dims, one.shake_mean.units) == ((), "N/m")
    early = 4.0 * study.case.plan.steps.snapshot_interval  # before from_time
    assert np.isnan(model.run(final_time=early).measures.beat_mean)
    swept = batches.SweptModel(Workspace(study._context))
    points = [study.case.plan.point({"reynolds": 14.0, "swing": swing}) for swing in (0.0, 0.9)]
    records = [swept.run(point).values for point in points]
    outputs = {each.name: each for each in statistics.outputs_of(study.case, records)}
    assert np.isnan(outputs["beat_frequency"].values).tolist() == [[True], [False]]
    kept = statistics.existing(outputs["beat_amplitude"])
    assert kept.values.tolist() == [[pytest.approx(0.9 * sizes[1], rel=0.02)]]


def test_a_trade_judges_by_frequency_and_amplitude(made: Path, sphrom) -> None:
    said = sphrom("trade", made / "case.yaml", "--out", made / "runs", "--tolerance", "5%", code=0)
    assert "errors are missing where a run is unstable or has fewer than" in " ".join(
        said.output.split()
    )
    assert "within 5 % of frequency and 5 % of amplitude" in " ".join(said.output.split())
    still = rows(made / "runs/trade/doing_nothing.csv")[-1]
    heads = "measured_frequency_relative_l2 [%]", "measured_amplitude_relative_l2 [%]"
    assert [still[head] for head in heads] == ["", ""]


def test_an_amplitude_is_fitted_with_exact_derivatives(made: Path) -> None:
    study = package.Study(made / "case.yaml", out=made / "runs", quiet=True)
    measured = study.model("fast", reynolds=14.0, swing=0.8).run().measures
    columns = {"time": [1.0]}
    for name in ("beat_frequency", "beat_amplitude", "shake_mean"):
        columns |= {name: [measured[name].item()], f"{name}_noise": [1e-3]}
    found = study.model("fast", reynolds=14.0, swing=0.6).fit(columns)
    assert found.point["swing"] == pytest.approx(0.8, rel=1e-3)
    assert [history.units for history in found.histories] == ["Hz", "m2/s", "N/m"]
    data = read_measurements(columns, study.case, study.case.plan.steps, None)
    fast = FastModel(Workspace(study._context), study.case.rom[0])
    box = Box({"reynolds": (10.0, 20.0), "swing": (0.5, 1.0)}, {})
    model, place = FittedEquations(fast, box, data.histories), np.array([0.4, 0.6])
    model.prepare([place])
    slopes = model(place)[1]
    for k, way in enumerate(1e-4 * np.eye(2)):
        expected = (model(place + way)[0] - model(place - way)[0]) / 2e-4
        np.testing.assert_allclose(slopes[:, k], expected, rtol=1e-3, atol=1e-6)
    assert model(np.array([0.4, -1.0])) is None  # at rest there is no frequency
