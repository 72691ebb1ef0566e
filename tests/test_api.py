"""sphrom from Python: what it gives is what the command line gives, and what it refuses as well."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_info
from typer.testing import CliRunner

import sphrom
from sphrom.artifacts import open_artifact
from sphrom.cli.app import app
from sphrom.signals import guarded

FAST: dict[str, Any] = {"evaluation": "operators", "n_modes": 3}


CASE: dict[str, Any] = {
    "name": "vortex",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.2},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150]}},
    "basis": {
        "subsets": {
            "low": {"reynolds": [100], "interval": [50, 120]},
            "high": {"reynolds": [200], "interval": [180, 300]},
        }
    },
    "rom": [
        {**FAST, "name": "fast", "calibrated": True},
        {**FAST, "name": "plain", "calibrated": False, "corrected": False, "parameters": [150]},
        {"name": "faithful", "n_modes": 3, "parameters": [150]},
        {**FAST, "name": "local", "n_modes": 2, "basis": "local", "parameters": [100]},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
    "sweep": {"model": "fast", "reynolds": [120, 140]},
}


LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 12},
    "time": {"final_time": 0.3},
    "snapshots": {"every": 2},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 2}],
}


TOLD: list[str] = []
"""The lines that the study tells."""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    """A study with its operators."""
    out = tmp_path_factory.mktemp("api") / "vortex"
    made = sphrom.Study(CASE, out=out, threads=1, report=TOLD.append)
    made.run(until="operators")
    return made


@pytest.fixture(scope="module")
def model(study: sphrom.Study) -> sphrom.Model:
    """The fast model at a value that is not trained."""
    return study.model("fast", reynolds=150)


def test_names_are_those_that_are_listed():
    assert all(hasattr(sphrom, name) for name in sphrom.__all__)
    assert {*sphrom.__all__} <= {*dir(sphrom)}
    with pytest.raises(AttributeError, match="no attribute 'studies'"):
        _ = sphrom.studies  # type: ignore[attr-defined]


def test_stages_run_as_far_as_asked(study):
    names = {path.name for path in study.folder.glob("*.h5")}
    assert {"fom-reynolds150.h5", "pod.h5", "psi.h5", "operators.h5"} <= names
    assert not [name for name in names if name.startswith(("rom-fast", "compare"))]
    assert study.models == ("fast", "plain", "faithful", "local")
    assert repr(study).startswith("Study('vortex', out=")


def test_what_the_command_line_makes_is_the_same(study, model, tmp_path):
    case = tmp_path / "vortex.yaml"
    case.write_text(study.case.model_dump_json())  # JSON is YAML
    before = {path: path.stat().st_mtime_ns for path in study.folder.glob("*.h5")}
    command = ["rom", case, "--out", study.folder, "--threads", "1", "--only", "reynolds=150"]
    done = CliRunner().invoke(app, [str(word) for word in command])
    assert done.exit_code == 0, done.output
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())
    result = model.run()
    estimate = result.error_estimate
    with sphrom.open(study.folder / "rom-fast-reynolds150.h5") as stored:
        np.testing.assert_array_equal(result.time, stored.time)
        np.testing.assert_array_equal(result.coordinates, stored.generalized_coordinates)
        np.testing.assert_array_equal(estimate.velocity, stored.error_estimate_velocity)
        np.testing.assert_array_equal(estimate.pressure, stored.error_estimate_pressure)
        assert result.time_step == stored.attrs["time_step"]
    assert 0.0 < estimate.velocity_percent < 10.0
    assert not estimate.extrapolated
    assert repr(result) == f"Result('fast', reynolds=150, {len(result.time)} snapshots)"


def test_rates_are_those_that_a_run_integrates(study, model):
    result = model.run()
    found = solve_ivp(
        lambda time, a: model.rates(a, time),
        (0.0, result.time[-1]),
        model.start,
        t_eval=result.time,
        rtol=1e-9,
        atol=1e-12,
    )
    integrated = result.coordinates - result.correction
    assert np.linalg.norm(found.y.T - integrated) < 1e-4 * np.linalg.norm(integrated)
    assert study.model("plain", reynolds=150).run().correction is None


def test_jacobian_is_the_derivative_of_rates(model):
    a, step = model.start, 1e-4
    columns = [
        (model.rates(a + step * unit) - model.rates(a - step * unit)) / (2.0 * step)
        for unit in np.eye(len(a))
    ]
    np.testing.assert_allclose(model.jacobian(a), np.array(columns).T, rtol=1e-8, atol=1e-8)


def test_a_steady_state_has_no_rates(model):
    found = model.steady(model.start)
    assert found.converged
    assert np.linalg.norm(model.rates(found.coordinates)) == pytest.approx(found.residual)
    assert found.residual < 1e-8


def test_fields_are_sums_of_modes(study, model):
    result = model.run()
    with sphrom.open(study.folder / "pod.h5", "bases/all") as basis:
        fields = result.fields(basis.reference_position)
        modes = basis.modes_velocity.isel(mode=slice(3)).values
    assert fields.velocity.dims == ("snapshot", "point", "component")
    assert fields.pressure.dims == ("snapshot", "point")
    assert (fields.velocity.units, fields.pressure.units) == ("m/s", "Pa")
    summed = np.einsum("sm,mpc->spc", result.coordinates, modes)
    np.testing.assert_allclose(fields.velocity, summed, atol=1e-8)
    at_end = fields.sel(time=0.2, method="nearest")
    np.testing.assert_array_equal(at_end.pressure, fields.pressure[-1])


def test_points_along_periodic_axes_may_be_anywhere(model):
    result = model.run()
    inside, outside = (result.fields([[0.2, 0.3 + shift]]) for shift in (0.0, -2.0))
    np.testing.assert_allclose(inside.velocity, outside.velocity, atol=1e-12)
    assert outside.position.values.tolist() == [[0.2, -1.7]]


def test_a_model_moves_to_other_values_without_reading_again(study, model, monkeypatch):
    there = study.model("fast", reynolds=120).run()
    monkeypatch.setattr("sphrom.store.artifact_folder.open_artifact", None)
    again = model.at(reynolds=120)
    assert again.parameters == {"reynolds": 120.0}
    np.testing.assert_array_equal(again.run().coordinates, there.coordinates)
    assert model.parameters == {"reynolds": 150.0}


def test_a_model_keeps_the_values_that_are_not_named(tmp_path):
    """Each way to other values starts from those of the model, here a slower lid."""
    sections = {
        **LID,
        "scene": {"kind": "lid-driven-cavity", "measure": {"drag": {"force_on": "top"}}},
        "parameters": {"train": {"reynolds": [100, 200], "lid": [0.5, 1.0]}},
        "operators": {"error_estimate": False},
    }
    study = sphrom.Study(sections, out=tmp_path, threads=1, report=TOLD.append)
    study.run(until="operators")
    model = study.model("fast", reynolds=150, lid=0.6)
    there = study.model("fast", reynolds=151, lid=0.6).run()
    assert model.at(reynolds=151).at().parameters == {"reynolds": 151.0, "lid": 0.6}
    np.testing.assert_array_equal(model.at(reynolds=151).run().coordinates, there.coordinates)
    many = model.run_many({"reynolds": [120, 151]})
    np.testing.assert_array_equal(many.lid, [0.6, 0.6])
    np.testing.assert_array_equal(many.drag_force[1], there.measures.drag_force)
    # What the study's model does not name is the scene's own value, also after another model.
    assert study.model("fast", reynolds=151).parameters["lid"] == 1.0
    measured = {"time": there.time[1:], "drag_force_x": there.measures.drag_force[1:, 0]}
    assert model.fit(measured, "reynolds", noise="1%")["reynolds"].value == pytest.approx(151, 1e-3)


def test_many_runs_are_those_at_each_point(study, model):
    found = model.run_many(xarray.Dataset({"reynolds": ("run", [120, 300])}))
    assert "fast: reynolds=300 is outside of the trained range" in TOLD[-1]
    assert found.status.values.tolist() == ["complete", "complete"]
    for k, reynolds in enumerate(found.reynolds.values):
        errors = study.model("fast", reynolds=reynolds).run().error_estimate
        assert found.error_estimate_velocity[k] == errors.velocity_percent
        assert found.error_estimate_extrapolated[k] == errors.extrapolated == (reynolds == 300)


def test_runs_beyond_the_trained_times_and_values_are_told_apart(study):
    model = study.model("fast", reynolds=150)
    own = model.run()
    longer = model.run(final_time=2.0 * own.time[-1])
    assert longer.time[-1] == pytest.approx(2.0 * own.time[-1])
    assert longer.error_estimate.extrapolated
    assert "beyond the trained time" in TOLD[-1]
    study.model("fast", reynolds=300)
    assert "fast: reynolds=300 is outside of the trained range" in TOLD[-1]
    n = len(own.time)
    np.testing.assert_allclose(
        longer.coordinates[:n] - longer.correction[:n], own.coordinates - own.correction, atol=1e-4
    )
    assert not longer.correction[n:].any()
    assert np.array_equal(longer.correction[: n // 2], own.correction[: n // 2])
    assert len(model.run(final_time=own.time[3]).time) == 4
    interval = own.time[1] - own.time[0]
    n_told = len(TOLD)
    short = model.run(final_time=own.time[3] + 0.4 * interval)
    assert short.time[-1] == pytest.approx(own.time[3])
    assert len(TOLD) == n_told + 1
    assert f"final_time: runs end at {own.time[3]:.6g} s, not" in TOLD[-1]


def test_a_model_on_particles_keeps_its_trajectory(study):
    model = study.model("faithful", reynolds=150)
    result = model.run()
    path = study.folder / "rom-faithful-reynolds150.h5"
    made = path.stat().st_mtime_ns
    np.testing.assert_array_equal(model.run().coordinates, result.coordinates)
    assert path.stat().st_mtime_ns == made
    assert result.error_estimate is None
    fields = result.fields([[0.25, 0.5], [0.5, 0.25]])
    with sphrom.open(study.folder / "fom-reynolds150.h5") as full:
        speed = float(np.abs(full.velocity).max())
    fast = study.model("fast", reynolds=150).run().fields(fields.position)
    assert np.abs(fields.velocity - fast.velocity).max() < 0.05 * speed


def test_an_interrupted_run_is_resumed(tmp_path, monkeypatch):
    interrupts = True

    def interrupt(text: str) -> None:
        if interrupts and "%" in text and not text.startswith("packing"):
            raise KeyboardInterrupt

    monkeypatch.setattr("sphrom.console.LINE_INTERVAL", 0.0)  # every step is told
    changes = {"rom": [], "sweep": {}}
    study = sphrom.Study(CASE, out=tmp_path, threads=1, report=interrupt, set=changes)
    with pytest.raises(KeyboardInterrupt):
        study.run(until="fom", checkpoint_every=0.0)
    interrupts = False
    with pytest.raises(sphrom.errors.ArtifactError, match="--resume"):
        study.run(until="fom")
    study.run(until="fom", resume=True)
    assert (tmp_path / "fom-reynolds150.h5").exists()


def test_other_stages_run_as_their_commands(study):
    study.run_stage("sweep", workers=1)
    with sphrom.open(study.folder / "sweep-fast.h5") as swept:
        np.testing.assert_array_equal(swept.parameters.values.ravel(), [120.0, 140.0])
        assert swept.kinetic_energy.reynolds.values.tolist() == [120.0, 140.0]
        at_120 = study.model("fast", reynolds=120).run()
        np.testing.assert_array_equal(swept.generalized_coordinates[0], at_120.coordinates)


def test_tasks_of_a_sweep_are_as_short_as_their_points(study, monkeypatch):
    """A list of points is longer than what a process reads."""
    tasks: list[Any] = []
    monkeypatch.setattr("sphrom.sweep.sweep.make_runs", lambda task: tasks.append(task) or ())
    sweep = {"model": "fast", "name": "long", "points": [{"reynolds": 100 + k} for k in range(99)]}
    long = sphrom.Study({**CASE, "sweep": sweep}, out=study.folder, threads=1, quiet=True)
    with pytest.raises(sphrom.errors.ArtifactError, match="none of its 99 runs has been made"):
        long.run_stage("sweep", workers=1)
    assert not any(task.context().case.sweep.points for task in tasks)
    assert sum(len(task.points) for task in tasks) == 99


def fast(study: sphrom.Study) -> sphrom.Model:
    return study.model("fast", reynolds=150)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda s: s.model("fats", reynolds=1), "'fats'; did you mean fast"),
        (lambda s: s.model("fast"), "reynolds: is missing"),
        (lambda s: s.model("fast", reynolds=np.nan), "reynolds: must be a number above zero"),
        (lambda s: s.model("fast", reynolds=1, lid=2), "'lid': varies in neither"),
        (lambda s: s.model("local", reynolds=150), "no unique local basis"),
        (lambda s: s.model("local", reynolds=200), "has no operators"),
        (lambda s: s.run(until="operator"), "'operator'; did you mean operators"),
        (lambda s: s.run_stage("fom", only=["reynolds=7"]), "this command runs"),
        (lambda s: fast(s).rates(np.zeros(4)), "must have the shape (3,); got (4,)"),
        (lambda s: fast(s).jacobian([0, np.inf, 0]), "coordinates: must be finite"),
        (lambda s: fast(s).rates(np.zeros(3), np.nan), "time: must be a finite number; got NaN"),
        (lambda s: fast(s).run(final_time=1e-9), "the time of the second snapshot"),
        (lambda s: fast(s).run_many({"reynolds": [120, -1]}), "reynolds: must be a number above"),
        (lambda s: fast(s).run_many({"reynolds": []}), "points: are empty"),
        (lambda s: fast(s).run_many([{"reynolds": 120}]), "points: must be values by parameter"),
        (lambda s: fast(s).run().fields([0.1, 0.2]), "must have the shape (n_points, 2); got (2,)"),
        (lambda s: sphrom.Study(CASE, threads="2"), "threads: must be a whole number"),
        (lambda s: sphrom.Study(CASE, resolutoin=3), "did you mean resolution?"),
    ],
)
def test_what_is_refused(study, call, text):
    with pytest.raises(sphrom.errors.CaseError) as refused:
        call(study)
    assert text in str(refused.value)


def test_an_unknown_argument_is_refused_with_the_name_of_the_function(study):
    with pytest.raises(TypeError, match=r"Model\.run: .* unexpected keyword argument 'lid'"):
        fast(study).run(lid=0.5)


def test_points_have_to_be_in_the_fluid(tmp_path):
    study = sphrom.Study(LID, out=tmp_path, threads=1, report=TOLD.append)
    study.run(until="operators")
    assert study.model("fast").parameters == {"reynolds": 100.0}
    result = study.model("fast", reynolds=90).run()
    assert result.fields([[0.5, 1.0], [0.0, 0.0]]).sizes["point"] == 2
    with pytest.raises(sphrom.errors.CaseError, match=r"\(0.5, 1.01\) m is not in the fluid"):
        result.fields([[0.5, 0.5], [0.5, 1.01]])


def test_every_kind_of_artifact_opens_with_all_that_it_holds(study):
    study.run()
    study.run_stage("sweep", workers=1)
    opened = set()
    for path in sorted(study.folder.glob("*.h5")):
        with open_artifact(path, None, made_by="") as artifact, sphrom.open(path) as shared:
            stored = {name: artifact.read(name) for name in artifact.datasets}
            opened.add(artifact.schema.removeprefix("sphrom/"))
        found = dict(shared.drop_vars(["component", "reynolds"], errors="ignore").variables)
        for group in shared.attrs.get("groups", ()):
            with sphrom.open(path, group) as labelled:
                own = {*labelled.variables} - {*shared.variables, "component"}
                prefix = group.replace("/", "_")
                found |= {f"{prefix}_{name}": labelled[name].load() for name in own}
        assert {name.replace("/", "_") for name in stored} == {*found}, path
        for name, values in stored.items():
            assert found[name.replace("/", "_")].shape == values.shape
    assert {"trajectory", "coordinates", "reference-snapshots", "basis", "spline"} <= opened
    assert {"operators", "comparison", "sweep", "packing"} <= opened


def test_values_are_read_and_verified_when_they_are_used(study, tmp_path, monkeypatch):
    path = tmp_path / "fom.h5"
    path.write_bytes((study.folder / "fom-reynolds100.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        file["velocity"][1, 2, 0] += 1.0
    with pytest.raises(
        sphrom.errors.ArtifactError, match="velocity has changed since it was written"
    ):
        sphrom.open(path)
    monkeypatch.setattr("sphrom.artifacts.reader.SMALL_BYTES", 0)
    with sphrom.open(path) as run:
        assert run.pressure.sel(time=0.1, method="nearest").dims == ("particle",)
        with pytest.raises(
            sphrom.errors.ArtifactError, match="velocity has changed since it was written"
        ):
            run.velocity.isel(snapshot=0).load()


def test_what_stops_a_call_from_without():
    with pytest.raises(sphrom.errors.ResourceError, match="out of memory"), guarded():
        raise MemoryError
    with pytest.raises(sphrom.errors.ArtifactError, match=r"x\.h5: Denied"), guarded():
        raise PermissionError(13, "Denied", "x.h5")
    failed = SystemError("an interrupt within a call of C code")
    failed.__cause__ = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt), guarded():
        raise failed


def test_a_study_computes_on_one_thread_of_linear_algebra():
    """With more of them the last bits differ from those of the command line."""
    before = [library["num_threads"] for library in threadpool_info()]
    with guarded():
        found = [lib for lib in threadpool_info() if lib["user_api"] == "blas"]
        assert found
        assert {library["num_threads"] for library in found} == {1}
    assert [library["num_threads"] for library in threadpool_info()][: len(before)] == before


def test_files_that_are_no_artifacts_are_refused(study, tmp_path):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["x"] = [1.0]
    part = tmp_path / "part.h5"
    part.write_bytes((study.folder / "pod.h5").read_bytes()[:4000])
    for path in (other, part, tmp_path, tmp_path / "none.h5"):
        with pytest.raises(sphrom.errors.ArtifactError):
            sphrom.open(path)
    with pytest.raises(sphrom.errors.CaseError, match="has no group bases/b; there are: bases/all"):
        sphrom.open(study.folder / "pod.h5", "bases/b")
