"""Draws of random parameters: statistics of a sweep's outputs, and what can go wrong."""

from __future__ import annotations

import csv
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sphrom
from sphrom.artifacts import open_artifact, read_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.loader import load_case
from sphrom.errors import UnstableError
from sphrom.plots.canvas import save
from sphrom.sweep import sweep as stage
from sphrom.sweep.records import ERROR, UNSTABLE, RunRecord
from sphrom.sweep.runs import SweptModel
from sphrom.sweep.statistics import draw_indices, draw_quantiles, outputs_of

LID = {"distribution": "uniform", "loc": 0.5, "scale": 0.5}
REYNOLDS = {"distribution": "truncnorm", "a": -3, "b": 3, "loc": 120, "scale": 25}
SAMPLE = {"count": 64, "method": "saltelli", "seed": 1, "reynolds": REYNOLDS, "lid": LID}
CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "there": {"probe": [0.5, 0.8]},
            "flux": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1.0]}},
            "middle": {"line": {"from": [0.5, 0.2], "to": [0.5, 0.8], "points": 5}},
            "load": {"force_on": "top"},
        },
    },
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.3},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}, "test": {"reynolds": []}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False},
    "sweep": {"sample": SAMPLE, "quantiles": [0.25, 0.5, 0.75], "probes": [[0.3, 0.7]]},
}


class Notes:
    """A reporter that keeps what it is told."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.tables: list[str] = []

    def info(self, text: str) -> None:
        pass

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def table(self, title: str, headings: Any, rows: Any) -> None:
        self.tables.append(title)

    def progress(self, *_: Any) -> Any:
        return nullcontext(lambda done: None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The artifacts that sweeps of the cavity need."""
    out = tmp_path_factory.mktemp("uncertain")
    sphrom.Study(CASE, out=out, quiet=True, threads=1).run(until="operators")
    return out


@pytest.fixture
def swept(folder, monkeypatch):
    """Sweep in this process, and return what was told and the artifact's path."""
    monkeypatch.setattr(stage, "SMALLEST_BATCH", 40)

    def run(name: str, options: dict[str, Any] | None = None, **changes: Any) -> tuple[Notes, Path]:
        case = {**CASE, "sweep": {**CASE["sweep"], "name": name, **changes}}
        notes = Notes()
        study = sphrom.Study(case, out=folder, report=notes, threads=1)
        study.run_stage("sweep", workers=1, **(options or {}))
        return notes, folder / f"sweep-{name}.h5"

    return run


def read(path: Path) -> tuple[Statistics, np.ndarray, np.ndarray]:
    """Return statistics, the energies (n_runs, n_snapshots), and the estimated errors."""
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        artifact.verify_content()
        statistics = read_record(artifact, Statistics, "statistics")
        energies = artifact.read("kinetic_energy_over_time")
        return statistics, energies, artifact.read("error_estimate/velocity_over_time")


def test_statistics_are_those_of_the_runs(swept):
    _, path = swept("whole")
    found, energies, errors = read(path)
    assert energies.shape[0] == 256
    assert (found.n_runs, found.method) == (128, "saltelli")
    assert set(found.outputs) == {
        "kinetic_energy", "probe1_u", "probe1_v", "probe1_pressure", "there_u", "there_v",
        "there_pressure", "flux_flow_rate", "middle_final_u", "middle_final_v",
        "middle_final_pressure", "load_x", "load_y", "load_torque",
    }  # fmt: skip
    energy = found.outputs["kinetic_energy"]
    expected = np.quantile(energies[:128], [0.25, 0.5, 0.75], axis=0)
    np.testing.assert_allclose(energy.quantiles, expected, rtol=1e-12)
    np.testing.assert_allclose(energy.mean, energies[:128].mean(axis=0), rtol=1e-12)
    assert np.all(energy.interval[0] <= energy.sampling_interval[0])
    assert np.all(energy.interval[1] >= energy.sampling_interval[1])
    assert np.all(np.ptp(energy.interval, axis=0)[:, -1] > 0.0)
    assert errors.shape == energies.shape
    assert (energy.unit, energy.along, energy.model_error) == ("J/m", "time", "estimated")
    assert found.outputs["load_x"].model_error == "unknown"
    assert found.outputs["middle_final_u"].along == "line"
    assert found.outputs["middle_final_u"].mean.shape == (5,)


def test_the_lids_speed_causes_what_it_drives(swept):
    """The energy grows with the lid's speed squared, and in so short a time with viscosity."""
    _, path = swept("whole")
    found, _, _ = read(path)
    energy = found.indices["kinetic_energy"]
    assert 0.5 < energy.total[1, -1] < 0.85
    assert 0.2 < energy.total[0, -1] < 0.6
    assert energy.first[:, -1].sum() == pytest.approx(1.0, abs=0.2)
    assert energy.first_interval[0, 1, -1] <= energy.first[1, -1] <= energy.first_interval[1, 1, -1]
    assert np.all(energy.total[:, 0] == 0.0)  # all start at rest


def test_drawn_runs_are_those_of_the_model_alone_to_the_last_bit(swept, folder):
    """Though models are built together, and what is the same for all points is kept."""
    _, path = swept("whole")
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        points, coordinates = artifact.read("parameters"), artifact.read("generalized_coordinates")
        shares = artifact.read("error_estimate/velocity_over_time")
    for k in (0, 70, 200, 255):
        study = sphrom.Study(CASE, out=folder, quiet=True, threads=1)
        run = study.model("fast", reynolds=points[k, 0], lid=points[k, 1]).run()
        assert run.coordinates.tobytes() == coordinates[k].tobytes()
        assert np.array_equal(np.asarray(run.error_estimate.velocity), shares[k])


def test_tables_are_beside_the_artifact(swept, folder):
    swept("whole")
    statistics = {"mean", "deviation", "quantile 0.25", "quantile 0.5", "quantile 0.75"}
    for kind, column, values in (
        ("quantiles", "statistic", statistics), ("indices", "parameter", {"reynolds", "lid"}),
    ):  # fmt: skip
        assert not (folder / f"sweep-whole-{kind}.png").exists()  # compare.plots is off
        with (folder / f"sweep-whole-{kind}.csv").open(newline="") as file:
            assert {row[column] for row in csv.DictReader(file)} == values
    tree = sphrom.open_tree(folder / "sweep-whole.h5")
    assert tree["statistics/outputs/kinetic_energy"]["quantiles"].shape[0] == 3


def test_figures_are_drawn_of_all_outputs(swept, tmp_path):
    _, path = swept("whole")
    found = read(path)[0]
    names, energy = ("kinetic_energy", "middle_final_u"), found.outputs["kinetic_energy"].mean
    few = replace(
        found,
        outputs={name: found.outputs[name] for name in names},
        indices={name: found.indices[name] for name in names},
    )
    figure = draw_quantiles(few, np.linspace(0.0, 0.3, len(energy)))
    assert [axes.get_xlabel() for axes in figure.axes] == ["time [s]", "place along the line [–]"]
    assert len(figure.axes[0].collections) == 1  # a band for each pair of quantiles
    save(figure, tmp_path / "quantiles.png")
    figure = draw_indices(few, ["reynolds", "lid"])
    assert [tick.get_text() for tick in figure.axes[0].get_xticklabels()] == ["reynolds", "lid"]
    assert len(figure.axes[0].patches) == 4
    save(figure, tmp_path / "indices.png")
    assert all(file.stat().st_size > 5000 for file in tmp_path.iterdir())


def test_the_runs_are_kept_where_other_quantiles_are_asked_for(swept, monkeypatch):
    swept("whole")
    monkeypatch.setattr(SweptModel, "run", None)
    notes, path = swept("whole", quantiles=[0.1, 0.9])
    assert notes.tables[-1].startswith("statistics of 128 runs")
    assert read(path)[0].levels.tolist() == [0.1, 0.9]
    before = path.read_bytes()
    swept("whole", quantiles=[0.1, 0.9])
    assert path.read_bytes() == before


def test_draws_go_on_where_they_were(swept, monkeypatch):
    few = {"count": 40, "method": "random", "reynolds": REYNOLDS, "lid": LID}
    swept("some", sample=few)
    points: list[Any] = []
    run = SweptModel.run

    def note(self: SweptModel, point: Any) -> Any:
        points.append(point)
        return run(self, point)

    monkeypatch.setattr(SweptModel, "run", note)
    _, more = swept("some", sample={**few, "count": 60})
    assert len(points) == 20
    _, whole = swept("anew", sample={**few, "count": 60})
    one, other = read(more), read(whole)
    assert one[1].tobytes() == other[1].tobytes()
    ends = [found[0].outputs["there_u"].interval.tobytes() for found in (one, other)]
    assert ends[0] == ends[1]


def test_shards_make_the_same_statistics(swept):
    _, whole = swept("whole")
    swept("shards", {"shard": (1, 2)})
    _, path = swept("shards", {"shard": (2, 2)})
    one, other = read(whole)[0], read(path)[0]
    for name in one.outputs:
        assert one.outputs[name].interval.tobytes() == other.outputs[name].interval.tobytes()
        assert one.indices[name].total.tobytes() == other.indices[name].total.tobytes()


def test_draws_outside_of_training_are_counted_and_told(swept):
    wide = {"distribution": "uniform", "loc": 20, "scale": 180}
    notes, path = swept("wide", sample={"count": 40, "reynolds": wide, "lid": [0.5, 1.0]})
    found = read(path)[0]
    assert 3 <= found.n_extrapolated <= 12
    said = f"{found.n_extrapolated} of 40 draws are outside of the trained range"
    assert any(said in warning for warning in notes.warnings)
    assert any("intervals of load_x, load_y, load_torque are of sampling alone" in warning
               for warning in notes.warnings)  # fmt: skip
    assert not found.indices


@pytest.mark.parametrize(
    ("broken", "sample", "n_runs", "words"),
    [
        (range(2, 3), SAMPLE, 127, "no Sobol indices, as a run of their design has no result"),
        (range(20), {"count": 20, "method": "random", "reynolds": REYNOLDS}, None, "too few"),
    ],
)
def test_unstable_runs_leave_no_indices(swept, folder, monkeypatch, broken, sample, n_runs, words):
    run, points, told = SweptModel.run, [], []

    def break_some(self: SweptModel, point: Any) -> Any:
        points.append(point)
        if len(points) - 1 in broken:
            return RunRecord(point, UNSTABLE, reason="a test")
        return run(self, point)

    monkeypatch.setattr(SweptModel, "run", break_some)
    monkeypatch.setattr(Notes, "warn", lambda self, text: told.append(text))
    with pytest.raises(UnstableError, match="became unstable"):
        swept(f"broken{len(broken)}", sample=sample)
    if n_runs is not None:
        found = read(folder / "sweep-broken1.h5")[0]
        assert (found.n_runs, dict(found.indices)) == (n_runs, {})
    assert any(words in text for text in told)


def test_the_error_of_an_energy_is_that_of_its_velocity():
    """A velocity that is off by as much as it says, everywhere: the bound is reached."""
    case = load_case({**CASE, "scene": {"kind": "lid-driven-cavity"}, "sweep": {}})
    mass, speeds, error = 1.0, np.array([0.5, 0.7, 0.9]), 0.1
    values = {"kinetic_energy_over_time": 0.5 * mass * speeds**2}
    values |= {f"{ERROR}{name}_over_time": np.full(3, error) for name in ("velocity", "pressure")}
    values[f"{ERROR}velocity"] = np.array(1.0)
    (output,) = outputs_of(case, [values, values])
    assert output.errors is not None
    np.testing.assert_allclose(
        output.values + output.errors, [0.5 * mass * (speeds + error) ** 2] * 2, rtol=1e-12
    )
