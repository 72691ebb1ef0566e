"""Snapshots of other programs become a full run, from which the stages go on."""

from __future__ import annotations

import json
import pickle
import shlex
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact
from sphrom.exchange.import_options import ImportOptions
from sphrom.scenes.flows import TaylorGreen

PYSPH = sorted((Path(__file__).parent / "data" / "pysph").glob("*.hdf5"))
SHIFT = "--origin=-0.25,-0.25"
BY_PRESSURE = ("--pressure", "p", "--zero-mean-pressure", SHIFT)
CASE: dict[str, Any] = {
    "name": "theirs",
    "scene": {"kind": "taylor-green"},
    "fluid": {"reference_density": 1.0},
    "discretization": {
        "resolution": 10,
        "smoothing_length_ratio": 2.0,
        "initial_particles": "lattice",
    },
    "time": {"final_time": 0.1, "step": 2.5e-3},
    "snapshots": {"every": 20},
    "parameters": {"train": {"reynolds": [100]}},
    "rom": [{"name": "galerkin", "n_modes": 1}],
    "compare": {"plots": False, "grid": 8, "line_points": 9},
}
OUT = Path("runs/theirs")
RUN = OUT / "fom-reynolds100.h5"
SPACING, N = 0.1, 100
HIGH = np.linspace(0.0, 1.0, N)


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The case in a folder of its own, to work in."""
    monkeypatch.chdir(tmp_path)
    path = Path("theirs.yaml")
    path.write_text(yaml.safe_dump(CASE))
    return path


def imported() -> dict[str, np.ndarray]:
    """Return the datasets of the trajectory that an import wrote."""
    with open_artifact(RUN, "sphrom/trajectory", made_by="import") as artifact:
        artifact.verify_content()
        return {name: artifact.read(name) for name in artifact.datasets}


def read_pysph(name: str) -> np.ndarray:
    """Return a field of the files that PySPH wrote (3, n_particles)."""
    return np.stack([h5py.File(path)[f"particles/fluid/arrays/{name}"][...] for path in PYSPH])


def test_what_pysph_wrote_comes_through(case, sphrom) -> None:
    result = sphrom("import", case, *PYSPH, *BY_PRESSURE, code=0)
    assert "3 snapshots of 100 particles" in result.stdout
    run = imported()
    np.testing.assert_allclose(run["time"], [0.0, 0.05, 0.1], rtol=1e-12)
    np.testing.assert_array_equal(run["step"], [0, 20, 40])
    place = np.stack((read_pysph("x"), read_pysph("y")), axis=2) + 0.25
    np.testing.assert_array_equal(run["position"], place % 1.0)
    velocity = np.stack((read_pysph("u"), read_pysph("v")), axis=2)
    np.testing.assert_array_equal(run["velocity"], velocity)
    pressure = read_pysph("p")
    pressure -= pressure.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(run["pressure"], pressure, atol=1e-15)
    np.testing.assert_allclose(run["density_fluctuation"], pressure / 100.0, atol=1e-17)
    result = sphrom("fom", case, "--set=parameters.test={reynolds: [150]}")
    assert "were imported, those at reynolds=150 are simulated here" in result.stderr


def test_stages_go_on_from_what_pysph_wrote(case, sphrom) -> None:
    measured = "--set=scene.measure={centre: {probe: [0.3, 0.3]}}"
    sphrom("import", case, *PYSPH, *BY_PRESSURE, "--seconds", 7.0, measured, code=0)
    result = sphrom("run", case, "--threads", 1, "--verbose", measured, code=0)
    assert "fom-reynolds100.h5: up to date, kept" in result.stdout
    with open_artifact(OUT / "pod.h5", "sphrom/basis", made_by="pod") as basis:
        values = basis.read("bases/all/singular_values/joint")
    # A vortex that decays in place: one mode has nearly all of it.
    assert values[0] > 10.0 * values[1]
    with open_artifact(RUN, "sphrom/trajectory", made_by="import") as run:
        assert run.text("stage") == "import"
        assert run.text("imported/files").startswith(f"{PYSPH[0].parent}/taylor_green_*.hdf5 --")
        assert run.number("timing/integration") == 7.0
        found = run.read("measure/centre/velocity")
    timings = json.loads((OUT / "compare.json").read_text())["timings"]
    assert {(each["full_seconds"], each["speed_up"]) for each in timings} == {(7.0, None)}
    assert "No speed-up is given" in result.stdout
    flow = TaylorGreen(length=1.0, speed=1.0, reference_density=1.0, kinematic_viscosity=0.01)
    assert found.shape == (3, 1, 2)
    np.testing.assert_allclose(found[0], flow.velocity(np.array([[0.3, 0.3]]), 0.0), atol=0.05)


def test_what_nobody_knows_is_unknown(case, sphrom) -> None:
    sphrom("import", case, *PYSPH, *BY_PRESSURE, code=0)
    with open_artifact(RUN, "sphrom/trajectory", made_by="import") as run:
        assert "timing/integration" not in run.attributes
    result = sphrom("run", case, "--threads", 1, code=0)
    figures = json.loads((OUT / "compare.json").read_text())
    for timing in figures["timings"]:
        assert (timing["full_seconds"], timing["speed_up"]) == (None, None)
        assert timing["reduced_seconds"] > 0.0
    assert "unknown" in result.stdout
    few = ("trade.full_runs=false", "trade.n_modes=[1]", "trade.repeats=1")
    settings = [f"--set={each}" for each in few]
    result = sphrom("trade", case, *settings, "--threads", 1, "--tolerance", "1000%", code=0)
    stored = json.loads((OUT / "trade" / "trade.json").read_text())
    for row in stored["models"]:
        assert (row["speed_up"], row["break_even_runs"]) == (None, None)
        assert row["offline_seconds"] in (None, 0.0)
    assert stored["models"][0]["online_seconds"] is None
    (advice,) = stored["recommendation"]
    assert (advice["full_run"], advice["pays_from_run"]) == (None, None)
    assert "unknown" in result.stdout


def fields(time: float) -> dict[str, np.ndarray]:
    """Return fields on a lattice, in SI units."""
    x, y = np.meshgrid(*[(np.arange(10) + 0.5) * SPACING] * 2)
    random = np.random.default_rng(int(100 * time))
    return {
        "x": x.ravel(),
        "y": y.ravel(),
        "u": random.standard_normal(N),
        "v": random.standard_normal(N),
        "rho": 1.0 + 0.01 * random.standard_normal(N),
    }


def write_npz(**changed: Any) -> list[str]:
    """Write three files that fit the case; fields may be changed, or left out by None."""
    names = []
    for time in (0.0, 0.05, 0.1):
        values = {**fields(time), "time": time, **changed}
        names.append(f"their_{round(100 * time)}.npz")
        np.savez(names[-1], **{k: v for k, v in values.items() if v is not None})
    return names


def test_units_are_those_of_the_options(case, sphrom) -> None:
    names = []
    for time in (0.0, 0.05, 0.1):
        si = fields(time)
        theirs = {
            "px": 1e3 * si["x"],
            "py": 1e3 * si["y"],
            "vel": 1e2 * np.stack((si["u"], si["v"]), axis=1),
            "density": 1e-3 * si["rho"],
            "t": 1e3 * time,
        }
        np.savez(f"their_{time:g}.npz", **theirs)
        names.append(f"their_{time:g}.npz")
    sphrom(
        "import", case, *names, "--position", "px,py", "--velocity", "vel.x,vel.y",
        "--density", "density",
        "--units", "length=mm,velocity=0.01,density=g/cm3,time=ms", code=0,
    )  # fmt: skip
    run = imported()
    np.testing.assert_allclose(run["time"], [0.0, 0.05, 0.1], rtol=1e-12)
    si = fields(0.05)
    np.testing.assert_allclose(run["position"][1], np.stack((si["x"], si["y"]), 1), rtol=1e-12)
    np.testing.assert_allclose(run["velocity"][1], np.stack((si["u"], si["v"]), 1), rtol=1e-12)
    np.testing.assert_allclose(run["density_fluctuation"][1], si["rho"] - 1.0, atol=1e-14)
    np.testing.assert_allclose(run["pressure"][1], 100.0 * (si["rho"] - 1.0), atol=1e-12)


def test_the_table_of_units() -> None:
    units = "pressure=GPa,velocity=km/h,time=h,density=t/mm3,length=um"
    values = {
        "pressure": 1e9,
        "velocity": 1.0 / 3.6,
        "time": 3600.0,
        "density": 1e12,
        "length": 1e-6,
    }
    assert ImportOptions(units=units).scales == values
    assert ImportOptions(units="velocity=mm/ms,pressure=bar").scales["velocity"] == 1.0


def test_one_array_of_several_is_taken(case, sphrom, refused) -> None:
    times = (0.1, 0.0, 0.05)  # files are sorted by their times
    names = [f"their_{time:g}.hdf5" for time in times]
    for name, time in zip(names, times, strict=True):
        with h5py.File(name, "w") as file:
            file.create_group("solver_data").attrs["t"] = time
            file["particles/wall/arrays/x"] = file["particles/wall/arrays/y"] = np.zeros(3)
            for field, values in fields(time).items():
                file[f"particles/fluid/arrays/{field}"] = values
    with h5py.File("plain.h5", "w") as file:
        for field, values in fields(0.0).items():
            file[field] = values
    assert "plain.h5 has no /particles/NAME/arrays like PySPH's" in refused(
        "import", case, "plain.h5"
    )
    for name in ("plain.h5", "plain.csv"):
        Path(name).touch()
        assert "numpy.savez('run_0.npz', t=time, x=x," in refused("import", case, name)
    assert "one of its sets of particles as --array: fluid, wall" in refused("import", case, *names)
    sphrom("import", case, *names, "--array", "fluid", code=0)
    np.testing.assert_array_equal(imported()["velocity"][2][:, 0], fields(0.1)["u"])


def test_files_without_times_need_a_step(case, sphrom, refused) -> None:
    names = write_npz(time=None)
    assert "--time-step: is required" in refused("import", case, *names, code=2)
    sphrom("import", case, *names, "--time-step", 0.05, code=0)


@pytest.mark.parametrize("way", ["pvd", "vtkhdf"])
def test_what_was_exported_comes_back_to_the_last_bit(place, sphrom, way: str) -> None:
    pytest.importorskip("vtkmodules", reason="VTK is not installed")
    run = place / "fom-reynolds100.h5"
    with open_artifact(run, "sphrom/trajectory", made_by="fom") as artifact:
        before = {name: artifact.read(name) for name in artifact.datasets}
    sphrom("export", "tiny.yaml", "--only", "reynolds=100", code=0)
    artifact_itself = run.rename(place / "run.vtkhdf")
    files = [place / "export" / "fom-reynolds100.pvd"]
    if way == "vtkhdf":
        files = [artifact_itself]
    sphrom("import", "tiny.yaml", *files, "--only", "reynolds=100", "--force", code=0)
    with open_artifact(run, "sphrom/trajectory", made_by="import") as artifact:
        for name in artifact.datasets:
            np.testing.assert_array_equal(artifact.read(name), before[name])


def test_flow_in_the_plane_of_x_and_z_is_refused_with_what_takes_it(case, sphrom, refused) -> None:
    """A component is never dropped in silence."""
    files = []
    for time in (0.0, 0.05, 0.1):
        si = fields(time)
        nothing = 0.0 * si["x"]
        vectors = {
            "points": np.stack((si["x"], nothing, si["y"]), axis=1),
            "velocity": np.stack((si["u"], nothing, si["v"]), axis=1),
        }
        files.append(f"a_{time:g}.npz")
        np.savez(files[-1], **vectors, rho=si["rho"], time=time)
    place = ("--position", "points.x,points.z")
    velocity = ("--velocity", "velocity.x,velocity.z")
    for wrong, says in (
        (("--position", "points.x,points.y", *velocity), "points.z reaches 0.9"),
        (place, "velocity.z reaches"),
    ):
        assert f"is three-dimensional: {says}" in refused("import", case, *files, *wrong, code=2)
        assert not RUN.exists()
    sphrom("import", case, *files, *place, *velocity, code=0)
    np.testing.assert_array_equal(imported()["velocity"][2][:, 1], fields(0.1)["v"])
    np.testing.assert_array_equal(imported()["position"][2][:, 1], fields(0.1)["y"])


def moving(time: float) -> dict[str, np.ndarray]:
    """Return fields that are cubic in time, of particles that cross the box's edge."""
    si = fields(0.0)
    curve = 1.0 + time - 4.0 * time**2 + 9.0 * time**3
    return {**si, "x": (si["x"] + 5.0 * time) % 1.0, "u": 5.0 * si["u"] / 9.0, "v": curve * si["v"],
            "rho": 1.0 + curve * (si["rho"] - 1.0)}  # fmt: skip


UNEVEN = (0.0, 0.017, 0.031, 0.044, 0.058, 0.079, 0.101)


def write_uneven(order: Any = lambda time: np.arange(N)) -> list[str]:
    """Write files of uneven times, their particles in an order."""
    names = []
    for time in UNEVEN:
        at, names = order(time), [*names, f"uneven_{round(1000 * time):03}.npz"]
        values = {name: value[at] for name, value in moving(time).items()}
        np.savez(names[-1], **values, id=at, time=time)
    return names


def test_uneven_times_are_interpolated(case, sphrom) -> None:
    names = write_uneven()
    result = sphrom("import", case, *names, code=0)
    assert "2 of 3 snapshots interpolated in time, by cubic polynomials; the" in result.stderr
    run = imported()
    np.testing.assert_allclose(run["time"], [0.0, 0.05, 0.1], rtol=1e-12)
    for index, time in enumerate((0.0, 0.05, 0.1)):
        si = moving(time)
        apart = run["position"][index] - np.stack((si["x"], si["y"]), axis=1)
        assert np.abs(apart - np.round(apart)).max() < 1e-12
        np.testing.assert_allclose(run["velocity"][index][:, 1], si["v"], atol=1e-12)
        np.testing.assert_allclose(run["density_fluctuation"][index], si["rho"] - 1.0, atol=1e-13)


def test_particles_in_another_order_are_not_interpolated(case, sphrom, refused) -> None:
    names = write_uneven(lambda time: np.random.default_rng(int(1e3 * time)).permutation(N))
    assert "--sort-by: a particle moves by" in refused("import", case, *names, code=2)
    sphrom("import", case, *names, "--sort-by", "id", code=0)
    np.testing.assert_allclose(imported()["velocity"][1][:, 1], moving(0.05)["v"], atol=1e-12)


@pytest.mark.parametrize("uneven", [False, True])
def test_case_with_the_times_of_the_files_is_written_and_imported(case, sphrom, uneven) -> None:
    names = write_uneven() if uneven else write_npz()
    end, says = 0.0948 if uneven else 0.1, "interpolated"
    if not uneven:  # Many programs write a last file wherever they end.
        names, says = [*names, "their_end.npz"], "1 of 4 snapshots left out, because"
        np.savez(names[-1], **fields(0.1), time=0.113)
    wrong = ("--set", "time.final_time=0.3", "--write-case", "fitting.yaml")
    sphrom("import", case, *names, *wrong[:2], code=2)
    sphrom("import", case, *names, *wrong, "--velocity", "a,b", code=3)
    assert not Path("fitting.yaml").exists()
    result = sphrom("import", case, *names, *wrong, code=0)
    assert says in result.stderr
    assert f"wrote fitting.yaml, with time.final_time={end} time.step=" in result.stdout
    written = yaml.safe_load(Path("fitting.yaml").read_text())
    assert written["time"]["final_time"] == end
    kept = {key: value for key, value in CASE.items() if key not in ("time", "snapshots")}
    assert {key: written[key] for key in kept} == kept
    np.testing.assert_allclose(imported()["time"], np.linspace(0.0, end, 7 if uneven else 3))
    again = sphrom("import", case, *names, "--write-case", "fitting.yaml", code=2)
    assert "fitting.yaml: must be a new .yaml file; --force overwrites one" in again.stderr


def test_case_is_fitted_to_the_particles_of_the_files_and_has_no_spin_up(case, sphrom) -> None:
    wrong = ("--set", "discretization.resolution=30", "--set", "time.spin_up=0.05")
    several = ("--set", "parameters.train.reynolds=[100,200]", "--only", "reynolds=100")
    result = sphrom(
        "import", case, *write_npz(), *wrong, *several, "--write-case", "fitting.yaml", code=0
    )
    assert "next: import reynolds=200 for fitting.yaml (sphrom run fitting.yaml" in result.stdout
    written = yaml.safe_load(Path("fitting.yaml").read_text())
    assert (written["discretization"]["resolution"], written["time"]["spin_up"]) == (10, 0)
    assert len(imported()["time"]) == 3


def test_more_modes_than_imported_snapshots_are_not_blamed_on_keys_that_nobody_gave(case, sphrom):
    many = ("--set", "rom=[{name: x, n_modes: 4}]", "--set", "time.final_time=0.3")
    short = (*many, "--write-case", "fitting.yaml")
    result = sphrom("import", case, *write_npz(), *short, code=2)
    assert "fitted to 3 snapshots, at t = 0, 0.05, 0.1 s, the case is invalid: " in result.stderr
    assert "rom.0.n_modes: must be at most the number of snapshots of basis all, 3" in result.stderr
    assert "because of" not in result.stderr


def test_advice_on_the_start_works_when_it_is_followed(case, sphrom) -> None:
    names = []
    for time in (0.0, 0.05, 0.1):
        names.append(f"late_{round(100 * time)}.npz")
        np.savez(names[-1], **fields(time), time=1e3 * (2.5 + time))
    about = ("--units", "time=ms", "--write-case", "fitting.yaml")
    refused = sphrom("import", case, *names, *about, code=2)
    assert "use --start 2500.0 to start it with the files" in refused.stderr
    assert not Path("fitting.yaml").exists()
    sphrom("import", case, *names, *about, "--start", 2500.0, code=0)
    np.testing.assert_allclose(imported()["time"], [0.0, 0.05, 0.1], atol=1e-12)


def test_pickles_are_refused_and_not_run(case, refused) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (Path("sprung"),)

    assert pickle.dumps(Trap())
    names = write_npz(trap=np.array([Trap()], dtype=object))
    assert "which could run code and are refused" in refused("import", case, *names)
    assert not Path("sprung").exists()
    assert not RUN.exists()


def test_particles_that_come_and_go_are_refused(case, sphrom) -> None:
    names = write_npz()
    np.savez(names[2], **{name: value[1:] for name, value in fields(0.1).items()}, time=0.1)
    result = sphrom("import", case, *names, code=3)
    assert "their_10.npz: has 99 particles, their_0.npz has 100; particles that enter or leave" in (
        result.stderr
    )
    assert not RUN.exists()


@pytest.mark.parametrize(
    ("changed", "arguments", "code", "says"),
    [
        ({"rho": None}, (), 3, "has no field rho (--density, or use --pressure); it has x, y"),
        ({}, ("--velocity", "a,b,c"), 2, "--velocity: must be two"),
        ({}, ("--density", "rho", "--pressure", "p"), 2, "--density, --pressure"),
        ({}, ("--units", "length=furlong"), 2, "got 'length=furlong'"),
        ({}, ("--units", "length=1e308"), 2, "must be a number from 1e-12 to 1e+12, or one of"),
        ({}, ("--units", "time=1e-308"), 2, "got 'time=1e-308'"),
        ({}, ("--origin=nan,nan",), 2, "must be two numbers up to 1e+12, like 0.5,0.5"),
        ({}, ("--origin=0,-inf",), 2, "--origin: must be two numbers"),
        ({}, ("--time-step", "1e308"), 2, "--time-step: must be a number above zero, up to 1e+12"),
        ({}, ("--seconds", "1e308"), 2, "--seconds: must be a number above zero"),
        ({}, ("--start=-inf",), 2, "--start: must be a number up to 1e+12; got -inf"),
        ({}, ("--units", "density=kg/mm3"), 2, "check the density or pressure of --units"),
        ({}, ("--units", "time=ms"), 2, "--write-case FILE; time=s of --units would"),
        ({"u": HIGH, "v": HIGH}, ("--units", "velocity=6"), 2, "speed); velocity=m/s of --units"),
        ({}, ("--units", "length=1000"), 2, "the size of the scene; length=m of --units would fit"),
        ({}, ("--origin", "0.5,0", "--set", "scene={kind: lid-driven-cavity}"), 2,
         "the particles span -0.45 to 0.45 m and 0.05 to 0.95 m, with a spacing of 0.1 m; the "
         "scene spans 0 to 1 m and 0 to 1 m, with a spacing of 0.1 m, and"),
        ({}, ("--time-step", "0"), 2, "--time-step"),
        ({}, ("--start", "nan"), 2, "--start"),
        ({}, ("--set", "discretization.resolution=20"), 2, "discretization.resolution=10 is near"),
        ({}, ("--set", "parameters.train.reynolds=[1,2]"), 2, "--only: name the parameter value"),
        ({"u": np.where(HIGH > 0.5, np.nan, 1.0)}, (), 3, "u of particle 50 is nan"),
        ({"u": HIGH[1:]}, (), 3, "its fields have different lengths"),
        ({"time": 0.0}, (), 3, "their_5.npz: has the same time as their_0.npz"),
        ({"id": np.zeros(N)}, ("--sort-by", "id"), 3, "must be a unique number of each"),
        ({"\x1b[2J\u202e[red]": HIGH}, ("--velocity", "\x9bu,v"), 3, "has no field \\x9bu"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said(case, sphrom, changed, arguments, code, says) -> None:
    result = sphrom("import", case, *write_npz(**changed), *arguments, code=code)
    assert says in result.stderr
    assert result.output.rstrip("\n").isprintable()
    assert not RUN.exists()


def test_files_without_pressure_are_refused(case, sphrom) -> None:
    result = sphrom("import", case, *write_npz(p=np.zeros(N)), "--pressure", "p", code=2)
    assert "there is no pressure; name a field with" in result.stderr
    assert not RUN.exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("gone.hdf5", None),
        ("readme.txt", b"hello"),
        ("broken.hdf5", b"hello"),
        ("\u202e.vtu", b'<VTKFile type="\xe2\x80\xaex"/>'),
        ("empty.pvd", b"<VTKFile/>"),
    ],
)
def test_file_that_cannot_be_read_is_named(case, sphrom, name, content) -> None:
    if content is not None:
        Path(name).write_bytes(content)
    result = sphrom("import", case, name, code=3)
    assert name.replace("\u202e", "\\u202e") in result.stderr
    assert result.output.rstrip("\n").isprintable()


def test_files_without_particles_say_so(case, sphrom) -> None:
    names = write_npz(**{name: np.empty(0) for name in ("x", "y", "u", "v", "rho")})
    result = sphrom("import", case, *names)
    assert (result.exit_code, result.stderr) == (3, f"error: {names[0]} has no particles\n")


def test_import_of_another_flow_than_the_case_says_so(case, sphrom) -> None:
    cavity = {
        "scene": {"kind": "lid-driven-cavity", "lid": "uniform"},
        "discretization": {"resolution": 20},
        "time": {"final_time": 1.0, "step": 0.005},
        "snapshots": {"every": 10},
        "rom": [{"name": "fast", "n_modes": 2, "evaluation": "operators"}],
    }
    case.write_text(yaml.safe_dump({**CASE, **cavity}))
    sphrom("fom", case, "--threads", 1, code=0)
    own = imported()
    for k, time in enumerate(own["time"]):
        names = ("position", "velocity", "density_fluctuation")
        np.savez(f"own_{k}.npz", time=time, **{name: own[name][k] for name in names})
    vectors = ("--position", "position.x,position.y", "--threads", 1, "--force")
    for change, says in (
        ("scene.lid=uniform", ""),
        ("scene.lid=regularised", " % slower per 1 s; for other schemes both are within"),
        ("parameters.train.reynolds=[200]", "full model come to differ from the files by"),
    ):
        change = "--set", change
        files = Path().glob("own_*.npz")
        assert says in sphrom("import", case, *files, *vectors, *change, code=0).stderr
        answer = sphrom("run", case, "--threads", 1, "--force", *change).stdout
        assert ("was imported, and may be of another flow" in answer) == bool(says)


def test_run_that_is_there_is_kept_unless_forced(case, sphrom, refused) -> None:
    names = write_npz()
    sphrom("fom", case, code=0)
    ours = RUN.read_bytes()
    assert "exists already, computed here, and not from ./their_*.npz" in refused(
        "import", case, *names
    )
    assert RUN.read_bytes() == ours
    sphrom("import", case, *names, "--force", code=0)
    theirs = RUN.read_bytes()
    assert "up to date, kept" in sphrom("import", case, *names, code=0).stdout
    assert ours != RUN.read_bytes() == theirs
    # Other options, or other files, are another import.
    said = "imported from ./their_*.npz --only"
    assert said in refused("import", case, *names, "--velocity", "v,u")
    assert said in refused("import", case, *write_npz(u=HIGH))


def test_force_replaces_no_imported_run(case, sphrom) -> None:
    """What no stage can make, none writes over; the command that does is given."""
    names = write_npz(id=np.arange(N))
    sphrom("import", case, *names, "--sort-by", "id", "--units", "time=1.0", code=0)
    theirs, again = RUN.read_bytes(), ("./their_*.npz", "--sort-by=id", "--units=time=1.0")
    assert "fom-reynolds100.h5: up to date" in sphrom("fom", case, "--force").stdout
    other = ("--set", "fluid.mach_number=0.09")
    for words in (("map",), ("run",), ("fom",), ("run", "--force"), ("fom", "--force")):
        refused = sphrom(words[0], case, *words[1:], *other, code=3)
        assert all(part in refused.stderr for part in again), refused.stderr
        assert RUN.read_bytes() == theirs
    # Nor where it can't be seen that it was imported.
    with h5py.File(RUN, "r+") as file:
        file.flush()
        marked = RUN.read_bytes()
    RUN.write_bytes(marked)
    for words in (("fom", case, "--force"), ("import", case, *names, "--force"), ("run", case)):
        assert f"`h5clear -s {RUN}`" in sphrom(*words, code=3).stderr
    assert RUN.read_bytes() == marked
    RUN.write_bytes(theirs)
    words = shlex.split(refused.stderr.split("`")[1])
    sphrom(*words[1:3], *other, *names, *words[6:], code=0)
    assert theirs != RUN.read_bytes()
