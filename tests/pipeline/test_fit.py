"""Parameters from measurements: found again, with intervals, or said not to be determined."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pandas import DataFrame

import sphrom
from sphrom.artifacts.labelled import open_labelled
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import ArtifactError, CaseError
from sphrom.fit.fit import Fit
from sphrom.fit.forward_model import Box, FittedEquations
from sphrom.fit.measurements import read_measurements
from sphrom.models.points.fast_model import FastModel
from sphrom.store.workspace import Workspace

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "there": {"probe": [0.5, 0.8]},
            "drag": {"force_on": "top"},
            "flux": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1.0]}},
        },
    },
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3, "integrated_modes": 3}],
    "compare": {"plots": False},
    "fit": {"starts": 2},
}
TRUE = {"reynolds": 120.0, "lid": 0.7}
U, V = "there_velocity_x", "there_velocity_y"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    """A lid-driven cavity of two parameters, up to its operators."""
    found = sphrom.Study(CASE, out=tmp_path_factory.mktemp("lid"), quiet=True, threads=1)
    found.run(until="operators")
    return found


def again(study: sphrom.Study, **values: Any) -> sphrom.Study:
    """Return the study with other values by key."""
    return sphrom.Study(CASE, out=study.folder, set=values, quiet=True, threads=1)


@pytest.fixture(scope="module")
def columns(study: sphrom.Study) -> dict[str, np.ndarray]:
    """What the model has at some parameters, at its snapshots, without noise."""
    measured = study.model("fast", **TRUE).run().measures
    there, time = measured.there_velocity.values, measured.time.values
    names = ["time", U, V, "there_pressure", "drag_force_x", "flux_flow_rate"]
    values = [time, there[:, 0], there[:, 1], measured.there_pressure.values]
    values += [measured.drag_force.values[:, 0], measured.flux_flow_rate.values]
    return {name: each[1:] for name, each in zip(names, values, strict=True)}


def refit(found: Fit) -> dict[str, Any]:
    """Return what a fitted model has, as measurements."""
    return {"time": found.time} | {each.name: each.curve for each in found.histories}


def test_what_the_model_has_gives_its_parameters(study, columns, tmp_path):
    model = study.model("fast", reynolds=60, lid=1.0)
    found = model.fit(columns, noise="1%")
    assert (found.free, found.model) == (("reynolds", "lid"), "fast")
    assert found.point == pytest.approx(TRUE, rel=2e-3)  # runs have other steps
    exact = model.fit(refit(found), noise="1%")
    assert exact.point == pytest.approx(found.point, rel=1e-6)
    assert exact.chi_square < 1e-6
    reynolds, viscosity, lid = exact.estimates
    assert viscosity.value == pytest.approx(1.0 / reynolds.value)
    assert viscosity.low == pytest.approx(1.0 / reynolds.high)
    share = reynolds.standard_deviation / reynolds.value
    assert viscosity.standard_deviation / viscosity.value == pytest.approx(share)
    assert lid.standard_deviation == pytest.approx(np.hypot(lid.by_noise, lid.by_model))
    assert lid.low < lid.value < lid.high
    assert exact.covariance[1, 1] == pytest.approx(lid.standard_deviation**2)
    assert exact["lid"] == lid
    assert "noise is smaller than stated" in exact.problems[-1]
    exact.draw(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 10_000


def test_gradients_are_differences(study, columns):
    workspace = Workspace(study._context)
    fast = FastModel(workspace, study.case.rom[0])
    instants = np.linspace(0.01, 0.49, 7)  # between snapshots
    table = {"time": instants, "x": np.full(7, 0.3), "y": np.full(7, 0.6), "velocity_x": instants}
    table |= {name: instants for name in columns if name != "time"}

    data = read_measurements(table, study.case, study.case.plan.steps, 1.0)
    box = Box({"reynolds": (50.0, 200.0), "lid": (0.5, 1.0)}, {})
    model, place = FittedEquations(fast, box, data.histories), np.array([0.6, 0.4])
    model.prepare([place])
    found = model(place)
    assert found is not None
    for k, width in ((0, 1e-4), (1, 1e-4)):
        step = width * np.eye(2)[k]
        ends = [model(place + sign * step) for sign in (1.0, -1.0)]
        slope = (ends[0][0] - ends[1][0]) / (2.0 * width)
        for part in np.split(np.arange(len(slope)), len(data.histories)):
            scale = np.abs(slope[part]).max()
            # The pressure is a small difference, which amplifies errors of the slopes.
            assert np.abs(found[1][part, k] - slope[part]).max() < 2e-4 * scale


def test_a_place_is_what_its_probe_is(study, columns):
    model, time = study.model("fast", **TRUE), columns["time"]
    named = {"time": time, U: columns[U], V: columns[V]}
    place = {"time": time, "x": np.full(len(time), 0.5), "y": np.full(len(time), 0.8)}
    place |= {"velocity_x": columns[U], "velocity_y": columns[V]}
    one, other = (model.fit(each, noise=1.0) for each in (DataFrame(named), place))
    assert one.point == pytest.approx(other.point, rel=1e-6)
    assert other["lid"].by_model == pytest.approx(one["lid"].by_model, rel=1e-4)
    assert other.histories[0].name == "velocity_x at (0.5, 0.8)"


def test_known_parameters_keep_their_values(study, columns):
    drag = {"time": columns["time"], "drag_force_x": columns["drag_force_x"]}
    found = study.model("fast", reynolds=80, lid=0.7).fit(drag, "reynolds", noise=1.0)
    assert (found.free, found.point["lid"]) == (("reynolds",), 0.7)
    assert found.point["reynolds"] == pytest.approx(120.0, rel=1e-2)
    known = again(study, **{"fit.parameters": {"lid": 0.7, "reynolds": [90, 150]}})
    case = known.model("fast", reynolds=80, lid=1.0).fit(drag, noise=1.0)
    assert case.point == pytest.approx(found.point, rel=1e-5)


@pytest.mark.parametrize("change", [0.0, 1e-9, -1e-9, 1e-7])
def test_what_the_data_do_not_determine_is_said(study, columns, change):
    """All points of a curve fit three equal values exactly; rounding doesn't choose among them."""
    model, last = study.model("fast", **TRUE), {n: v[[-1, -1, -1]] for n, v in columns.items()}
    one = {"time": last["time"], U: last[U], f"{U}_noise": [1e-4] * 3}
    one[U][1] += change
    found = model.fit(one)
    only, other, good = found.problems
    assert only.startswith("the data determine only a combination of reynolds and lid")
    assert other.startswith("other fits are nearly as good: reynolds=102, lid=0.696")
    assert "the noise is smaller than stated" in good
    assert {each.remark for each in found.estimates} == {"not determined"}
    if not change:
        nothing = model.fit({**one, f"{U}_noise": [10.0] * 3}).problems
        assert nothing[:2] == tuple(
            f"the data do not determine {name} within its range" for name in ("reynolds", "lid")
        )


def test_an_estimate_at_a_bound_says_so(study, columns):
    table = {name: columns[name] for name in ("time", U, "drag_force_x")}
    narrow = again(study, **{"fit.parameters": {"lid": [0.5, 0.6]}})
    found = narrow.model("fast", **TRUE).fit(table, noise="2%")
    assert found["lid"].remark == "at its bound"
    assert found["lid"].value == pytest.approx(0.6, rel=1e-3)
    assert any(p.startswith("lid is at the bound of its range, 0.6:") for p in found.problems)
    wide = again(study, **{"fit.parameters": {"lid": [0.5, 1.5]}})
    found = wide.model("fast", **TRUE).fit(table, noise="2%")
    assert any("goes beyond the trained range, 0.5 to 1" in p for p in found.problems)


def test_a_bad_fit_says_so(study, columns):
    table = {name: columns[name] for name in ("time", U, V)}
    mixed = 0.5 * (columns[U] + columns[V])
    alike = {**table, U: mixed, V: mixed}
    found = study.model("fast", **TRUE).fit(alike, noise=1.0)
    assert any(p.startswith("the fit is bad: chi^2 per degree") for p in found.problems)
    noise = 1.1 * float(found.warnings.partition("the noise is ")[2].split()[0])
    assert "bad" not in study.model("fast", **TRUE).fit(alike, noise=noise).warnings
    for factor in (1.0, 1.3, 1.5, 2.0, 4.0):
        other = {**table, U: factor * table[U]}
        found = study.model("fast", **TRUE).fit(other, noise=1.0)
        *_, last = ("", *found.problems)
        assert (found.chi_square > found.expected_chi_square) == ("above the" in last), factor
        assert ("above the" in last) <= all(each.remark for each in found.estimates)


def test_without_full_runs_intervals_are_of_the_noise_alone(study, columns):
    table = {name: columns[name] for name in ("time", U, V)}
    unnamed = {name.removeprefix("there_"): values for name, values in table.items()}
    unnamed |= {axis: np.full(len(table["time"]), 0.4) for axis in ("x", "y")}
    full = study.folder / "fom-reynolds50-lid0.5.h5"
    aside = full.rename(full.with_suffix(".aside"))
    try:
        model = study.model("fast", **TRUE)
        named, found = model.fit(table, noise=1.0), model.fit(unnamed, noise=1.0)
    finally:
        aside.rename(full)
    assert named["lid"].by_model > found["lid"].by_model == 0.0
    assert any(p.startswith("intervals include the noise only") for p in found.problems)


@pytest.mark.parametrize(
    ("known", "names", "given", "noise", "said"),
    [
        ({}, ("length",), None, 1.0, "'length': does not vary in the case"),
        ({}, (), None, "little", "noise: must be a percentage"),
        ({}, (), {"time": [0.1, 0.2], U: [0.1, 0.3]}, 1.0, "2 values can't determine 2"),
        ({"lid": 0.7, "reynolds": 100.0}, (), None, 1.0, "fixes all parameters"),
    ],
)
def test_what_a_fit_refuses(study, columns, known, names, given, noise, said):
    model = again(study, **{"fit.parameters": known}).model("fast", **TRUE)
    with pytest.raises(CaseError, match=said):
        model.fit(given or columns, *names, noise=noise)


def test_the_command_writes_what_it_found(study, columns, tmp_path, sphrom):
    case, table = tmp_path / "lid.yaml", tmp_path / "lab.csv"
    case.write_text(dump_yaml(CASE))
    names = ("time", U, "drag_force_x")
    rows = [",".join(names), *(",".join(map(str, r)) for r in zip(*(columns[n] for n in names)))]  # noqa: B905
    table.write_text("\n".join(rows) + "\n")
    command = ("fit", case, table, "--out", study.folder)
    assert f"{U} has no noise" in sphrom(*command, code=2).output
    result = sphrom(*command, "--noise", "1%", code=0)
    assert "kinematic_viscosity [m2/s]" in result.output
    assert {p.suffix for p in study.folder.glob("fit-lab.*")} == {".h5", ".csv", ".png"}
    with open_labelled(study.folder / "fit-lab.h5") as stored:
        assert stored.attrs["parameter_names"] == "reynolds,lid"
        assert stored["value"].values[0] == pytest.approx(120.0, rel=1e-2)
    rows = (study.folder / "fit-lab.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["reynolds", "kinematic_viscosity", "lid"]
    before = (study.folder / "fit-lab.h5").read_bytes()
    for options, code, said in (
        (("--noise", "1%"), 0, "kept"),
        (("--noise", "2%"), 3, "--force"),
        (("--noise", "1%", "--name", "../there"), 2, "--name"),
        (("--noise", "2%", "--name", "other"), 0, "fit-other"),
    ):
        assert said in sphrom(*command, *options, code=code).output
    assert (study.folder / "fit-lab.h5").read_bytes() == before
    assert (study.folder / "fit-other.png").stat().st_size > 10_000


def test_a_fit_needs_operators(tmp_path):
    study = sphrom.Study(CASE, out=tmp_path, quiet=True)
    table = tmp_path / "lab.csv"
    table.write_text(f"time,{U},{U}_noise\n0.1,1,1\n0.2,1,1\n0.3,1,1\n")
    with pytest.raises(CaseError, match="measurements: are missing"):
        study.run_stage("fit")
    with pytest.raises(ArtifactError, match=r"operators.h5 is missing"):
        study.run_stage("fit", measurements=table)
    plain = sphrom.Study({**CASE, "rom": [{"name": "slow", "n_modes": 3}]}, out=tmp_path)
    with pytest.raises(CaseError, match=r"fit.model: no reduced model has evaluation: operators"):
        plain.run_stage("fit", measurements=table)


def test_after_a_spin_up_the_start_counts_as_fixed(tmp_path, capsys):
    case = {**CASE, "time": {"spin_up": 0.25, "final_time": 0.5}}
    case |= {"parameters": {"train": {"reynolds": [50, 100]}}}
    case["scene"] = {**CASE["scene"], "measure": {"there": {"probe": [0.5, 0.8]}}}
    study = sphrom.Study(case, out=tmp_path, quiet=True, threads=1)
    study.run(until="operators")
    model = study.model("fast", reynolds=60)
    found = model.sensitivities("reynolds")
    assert "fast: derivatives do not include changes of the spin-up" in capsys.readouterr().err
    assert np.abs(found.coordinates[:, 0]).max() < 1e-12  # rounding
    measured = model.run().measures
    data = {"time": measured.time, U: measured.there_velocity.sel(component="x")}
    fit = model.fit(data, noise=1.0)
    assert any(p.startswith("runs start from the spin-up of the nearest") for p in fit.problems)
    assert fit.point["reynolds"] == pytest.approx(60.0, rel=2e-2)
