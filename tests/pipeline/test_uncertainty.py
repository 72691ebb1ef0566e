"""Draws of random parameters: statistics of a sweep's outputs, and what can go wrong."""

from __future__ import annotations

import csv
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
from sphrom.metrics.draws import spread
from sphrom.models.points.error_estimates import measured_errors
from sphrom.models.points.fast_model import FastModel
from sphrom.plots.panels import save
from sphrom.store.trajectory import measured_of
from sphrom.store.workspace import Workspace
from sphrom.sweep import sweep as stage
from sphrom.sweep.batches import ERROR, MISSED, UNSTABLE, RunRecord, SweptModel
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
    "sweep": {"sample": SAMPLE, "quantiles": [0.25, 0.5, 0.75]},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The artifacts that sweeps of the cavity need."""
    out = tmp_path_factory.mktemp("uncertain")
    sphrom.Study(CASE, out=out, quiet=True, threads=1).run(until="operators")
    return out


@pytest.fixture
def told() -> list[str]:
    """The lines that sweeps tell."""
    return []


@pytest.fixture
def swept(folder, monkeypatch, told):
    """Sweep in this process, and return the artifact's path."""
    monkeypatch.setattr(stage, "SMALLEST_BATCH", 40)

    def run(name: str, options: dict[str, Any] | None = None, **changes: Any) -> Path:
        case = {**CASE, "sweep": {**CASE["sweep"], "name": name, **changes}}
        study = sphrom.Study(case, out=folder, report=told.append, threads=1)
        study.run_stage("sweep", workers=1, **(options or {}))
        return folder / f"sweep-{name}.h5"

    return run


def read(path: Path) -> tuple[Statistics, np.ndarray, np.ndarray]:
    """Return statistics, the energies (n_runs, n_snapshots), and the estimated errors."""
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        artifact.verify_content()
        statistics = read_record(artifact, Statistics, "statistics")
        energies = artifact.read("kinetic_energy_over_time")
        return statistics, energies, artifact.read("error_estimate/velocity_over_time")


def test_statistics_are_those_of_the_runs(swept):
    path = swept("whole")
    found, energies, _ = read(path)
    assert energies.shape[0] == 256
    assert (found.n_runs, found.method) == (128, "saltelli")
    energy = found.outputs["kinetic_energy"]
    expected = np.quantile(energies[:128], [0.25, 0.5, 0.75], axis=0)
    np.testing.assert_allclose(energy.quantiles, expected, rtol=1e-12)
    np.testing.assert_allclose(energy.mean, energies[:128].mean(axis=0), rtol=1e-12)
    assert np.all(energy.interval[0] <= energy.sampling_interval[0])
    assert np.all(energy.interval[1] >= energy.sampling_interval[1])
    assert np.all(np.ptp(energy.interval, axis=0)[:, -1] > 0.0)
    assert (energy.unit, energy.along, energy.model_error) == ("J/m", "time", "estimated")
    assert all(output.model_error == "estimated" for output in found.outputs.values())
    mean = found.outputs["kinetic_energy_mean"]
    assert (mean.along, mean.mean.shape) == ("mean", (1,))
    np.testing.assert_allclose(mean.mean, energies[:128].mean(), rtol=1e-12)
    line = found.outputs["middle_final_velocity_x"]
    assert (line.along, line.mean.shape) == ("line", (5,))


def test_the_lids_speed_causes_what_it_drives(swept):
    """The energy grows with the lid's speed squared, and in so short a time with viscosity."""
    path = swept("whole")
    found, _, _ = read(path)
    energy = found.indices["kinetic_energy"]
    assert 0.5 < energy.total[1, -1] < 0.85
    assert 0.2 < energy.total[0, -1] < 0.6
    assert energy.first[:, -1].sum() == pytest.approx(1.0, abs=0.2)
    assert energy.first_interval[0, 1, -1] <= energy.first[1, -1] <= energy.first_interval[1, 1, -1]
    assert np.all(energy.total[:, 0] == 0.0)  # all start at rest


def test_drawn_runs_are_those_of_the_model_alone_to_the_last_bit(swept, folder):
    """Though models are built together, and what is the same for all points is kept."""
    path = swept("whole")
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        points, coordinates = artifact.read("parameters"), artifact.read("generalized_coordinates")
        shares = artifact.read("error_estimate/velocity_over_time")
    for k in (0, 70, 200, 255):
        study = sphrom.Study(CASE, out=folder, quiet=True, threads=1)
        run = study.model("fast", reynolds=points[k, 0], lid=points[k, 1]).run()
        assert run.coordinates.tobytes() == coordinates[k].tobytes()
        assert np.array_equal(np.asarray(run.error_estimate.velocity), shares[k])


def test_training_runs_tell_the_errors_of_what_is_measured(folder):
    study = sphrom.Study(CASE, out=folder, quiet=True, threads=1)
    fast = FastModel(Workspace(study._context), study.case.rom[0])
    (basis,) = (fast.on_basis(name) for name in study.case.plan.bases)
    for row, (k, reduced, run) in enumerate(basis.held_out()):
        with fast.workspace.open(fast.workspace.full_run(basis.points[k])) as full:
            recorded = measured_of(study.case, full)
        states = reduced.with_pressure(reduced.output_times.time, run)
        given = reduced.measured(states, reduced.mean_density_fluctuation)
        for name, quantities in given.items():
            for quantity, values in quantities.items():
                expected = recorded[name][quantity] - values
                found = basis.differences[name][quantity][row]
                np.testing.assert_array_equal(found, expected)
    run = fast.run(study.case.plan.point({"reynolds": 120.0, "lid": 0.7}))
    errors = measured_errors(run)
    assert errors["there"]["velocity"].shape == (len(run.time), 1, 2)
    assert np.all(errors["load"]["torque"][1:] > 0.0)


def test_tables_are_beside_the_artifact(swept, folder):
    swept("whole")
    rows = {}
    for kind in ("quantiles", "indices"):
        with (folder / f"sweep-whole-{kind}.csv").open(newline="") as file:
            rows[kind] = list(csv.DictReader(file))
    assert {row["parameter"] for row in rows["indices"]} == {"reynolds", "lid"}
    statistics = {"mean", "deviation", "quantile 0.25", "quantile 0.5", "quantile 0.75"}
    assert {row["statistic"] for row in rows["quantiles"]} == statistics


def test_figures_are_drawn_of_all_outputs(swept, tmp_path):
    found = read(swept("whole"))[0]
    names = ("kinetic_energy", "middle_final_velocity_x")
    outputs, indices = ({n: part[n] for n in names} for part in (found.outputs, found.indices))
    few = replace(found, outputs=outputs, indices=indices)
    time = np.linspace(0.0, 0.3, len(outputs["kinetic_energy"].mean))
    for figure in (draw_quantiles(few, time), draw_indices(few, ["reynolds", "lid"], time)):
        along = [axes.get_xlabel() for axes in figure.axes]
        assert along == ["time [s]", "place along the line [–]"]
        save(figure, tmp_path / "figure.png")


def test_the_runs_are_kept_where_other_quantiles_are_asked_for(swept, told, counted):
    swept("whole")
    counted.clear()
    path = swept("whole", quantiles=[0.1, 0.9])
    assert read(path)[0].levels.tolist() == [0.1, 0.9]
    assert not counted
    assert any("statistics of 128 runs" in text for text in told)


def test_draws_go_on_where_they_were(swept, counted):
    few = {"count": 40, "method": "random", "reynolds": REYNOLDS, "lid": LID}
    swept("some", sample=few)
    more = swept("some", sample={**few, "count": 60})
    assert len(counted) == 60
    one, other = read(more), read(swept("anew", sample={**few, "count": 60}))
    assert one[1].tobytes() == other[1].tobytes()
    ends = [found[0].outputs["there_velocity_x"].interval.tobytes() for found in (one, other)]
    assert ends[0] == ends[1]


def test_ranges_have_statistics_where_runs_are_enough(swept, told):
    assert read(swept("box", sample={"count": 13, "reynolds": [50, 200]}))[0].n_runs == 13
    swept("few", sample={"count": 12, "reynolds": [50, 200]})
    assert any("they need sample.count: 13 or more" in text for text in told)


def test_shards_make_the_same_statistics(swept):
    whole = swept("whole")
    swept("shards", {"shard": (1, 2)})
    one, other = read(whole)[0], read(swept("shards", {"shard": (2, 2)}))[0]
    for name in one.outputs:
        assert one.outputs[name].interval.tobytes() == other.outputs[name].interval.tobytes()
        assert one.indices[name].total.tobytes() == other.indices[name].total.tobytes()


def test_draws_outside_of_training_are_counted_and_told(swept, told):
    wide = {"distribution": "uniform", "loc": 20, "scale": 180}
    path = swept("wide", sample={"count": 40, "reynolds": wide, "lid": [0.5, 1.0]})
    found = read(path)[0]
    assert 3 <= found.n_extrapolated <= 12
    said = f"{found.n_extrapolated} of 40 draws are outside of the training points"
    assert any(said in text for text in told)
    (named,) = (text for text in told if "full runs may give other quantiles" in text)
    assert "middle_final_pressure (" in named
    assert "load_force_x (" not in named
    assert not found.indices


@pytest.mark.parametrize("lost", [1, 256])
def test_unstable_runs_leave_no_indices(swept, folder, monkeypatch, told, counted, lost):
    run = SweptModel.run

    def broken(self: SweptModel, point: Any) -> Any:
        found = run(self, point)
        return RunRecord(point, UNSTABLE, reason="a test") if len(counted) <= lost else found

    monkeypatch.setattr(SweptModel, "run", broken)
    with pytest.raises(UnstableError, match=f"{lost} of 256 runs became unstable"):
        swept(f"broken-{lost}")
    if lost == 1:
        found = read(folder / "sweep-broken-1.h5")[0]
        assert (found.n_runs, found.indices) == (127, {})
    said = "no Sobol indices" if lost == 1 else "too few runs have a result"
    assert any(said in text for text in told)


def test_noise_has_its_share_of_the_variance_and_means_are_free_of_it():
    """At a probe full runs have noise half as large as the spread: a fifth of the variance."""
    case = load_case(CASE)
    random = np.random.default_rng(1)

    def run(velocity: np.ndarray) -> dict[str, Any]:
        errors = {f"{ERROR}{q}_over_time": np.full(200, 0.1) for q in ("velocity", "pressure")}
        return {
            f"{ERROR}velocity": 0.1,
            **errors,
            "time": np.arange(200.0),
            "kinetic_energy_over_time": np.ones(200),
            "measure/there/velocity": velocity,
            "measure/there/pressure": velocity[:, 0],
            f"{MISSED}measure/there/velocity": np.zeros((1, 2)),
            f"{MISSED}measure/there/pressure": np.zeros(1),
        }

    noise = np.tile(np.array([0.5, -0.5])[:, None], (100, 2))
    trained = [run(noise)] * 4
    runs = [run(np.full((200, 2), drawn)) for drawn in random.standard_normal(500)]
    found = {each.name: each for each in outputs_of(case, runs, trained)}
    for name, share in (("there_velocity_y", 0.2), ("there_velocity_y_mean", 0.0)):
        output = found[name]
        shares = spread(output.values, output.errors, (0.5,)).error_share
        assert shares[len(shares) // 2] == pytest.approx(share, abs=0.05)


def test_the_error_of_an_energy_is_that_of_its_velocity():
    """A velocity that is off by as much as it says, everywhere: the bound is reached."""
    case = load_case({**CASE, "scene": {"kind": "lid-driven-cavity"}, "sweep": {}})
    mass, speeds, error = 1.0, np.array([0.5, 0.7, 0.9]), 0.1
    values = {"time": np.arange(3.0), "kinetic_energy_over_time": 0.5 * mass * speeds**2}
    values |= {f"{ERROR}{name}_over_time": np.full(3, error) for name in ("velocity", "pressure")}
    values[f"{ERROR}velocity"] = np.array(1.0)
    output, _ = outputs_of(case, [values, values])
    assert output.errors is not None
    np.testing.assert_allclose(
        output.values + output.errors, [0.5 * mass * (speeds + error) ** 2] * 2, rtol=1e-12
    )
