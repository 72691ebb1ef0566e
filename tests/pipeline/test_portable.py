"""Exported models answer like `rom`, by programs that know nothing of this package."""

from __future__ import annotations

import ctypes
import hashlib
import json
import re
import subprocess
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import sphrom as package
from sphrom.case.loader import parameter_point
from sphrom.errors import CaseError
from sphrom.metrics.measures import Samples
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.points.portable import Products
from sphrom.portable import fmu, page
from sphrom.portable.document import content, document, fields
from sphrom.reduction.affine import VISCOSITY
from sphrom.reduction.correction import interpolation_weights
from sphrom.reduction.reference_model import Integrator
from sphrom.sph.space_box import SpaceBox

ROOT = Path(__file__).parents[2]
VORTEX = {
    "name": "portable_vortex",
    "scene": {"kind": "taylor-green", "measure": {"spot": {"probe": [0.25, 0.1]}}},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.1, "courant_number": 0.75},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}, {"name": "particles"}],
}
LID = {
    "name": "portable_lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "drag": {"force_on": "top", "coefficient": {"speed": 1.0, "length": 1.0}},
            "vortex": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1.0]}},
            "line": {"line": {"from": [0.5, 0.2], "to": [0.5, 0.8], "points": 3}},
        },
    },
    "discretization": {"resolution": 10},
    "time": {"final_time": 1.0},
    "snapshots": {"every": 3},
    "parameters": {"train": {"reynolds": [50, 100], "lid": [0.5, 1.0]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 5}],
}
CHANNEL = {
    "name": "portable_channel",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [3, 2], "periodic": ["x"]},
        "solids": {"body": {"circle": {"centre": [1, 1], "radius": 0.4}}},
        "body_force": ["0.4*(1 - exp(-t*t))", 0],
        "reference_length": 0.8,
        "measure": {"drag": {"force_on": "body"}, "behind": {"probe": [2, 1]}},
    },
    "discretization": {"resolution": 11},
    "time": {"final_time": 2.0},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [20, 40], "body_force": [0.5, 1.0]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 5}],
}
CASES = {"vortex": VORTEX, "lid": LID, "channel": CHANNEL}
POINTS = {
    "vortex": [{"reynolds": 137.0}, {"reynolds": 190.0}, {"reynolds": 230.0}],
    "lid": [{"reynolds": 73.0, "lid": 0.6}, {"reynolds": 90.0, "lid": 0.95}],
    "channel": [{"reynolds": 33.0, "body_force": 0.7}, {"reynolds": 25.0, "body_force": 1.1}],
}


@pytest.fixture(scope="session")
def trained(tmp_path_factory) -> Callable[[str], FastModel]:
    """The trained model of a case, alone."""
    known: dict[str, FastModel] = {}

    def model(name: str) -> FastModel:
        if name not in known:
            out = tmp_path_factory.mktemp(name)
            package.Study(CASES[name], out=out, quiet=True, threads=1).run(until="operators")
            known[name] = package.load(out / "model-fast.h5")._fast
        return known[name]

    return model


@pytest.fixture(scope="module")
def reader() -> SimpleNamespace:
    """The programs of the documentation."""
    text, _ = (ROOT / "docs" / "portable.md").read_text().split("## In a system simulation")
    names: dict[str, Any] = {}
    for program in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(program, names)
    return SimpleNamespace(**names)


@pytest.fixture
def written(trained, tmp_path) -> Callable[[str], Path]:
    """The document of a case as a file."""

    def write(name: str) -> Path:
        path = tmp_path / f"{name}.json"
        path.write_bytes(content(trained(name)))
        return path

    return write


def in_its_steps(
    model: FastModel, values: Mapping[str, float], steps: Mapping[str, Any]
) -> FastRun:
    """Return a run with as many steps as the document has."""
    point = parameter_point(model.workspace.case, values)
    reduced = model.at(point)
    own = model.at_point(point).integrator(reduced)
    intervals = reduced.output_times.n_snapshots - 1
    n = -(-intervals // steps["snapshots_per_step"]) * steps["steps_per_snapshot"]
    parts = [part and part.scaled(part.n_steps / n) for part in (own.whole, own.leading)]
    return model.run(point, reduced, Integrator(reduced, *parts))


def column(quantities: Mapping[str, Any], output: Mapping[str, Any]) -> np.ndarray:
    """Return the history (n_snapshots,) of an output."""
    values = quantities[output["measure"]][output["quantity"]]
    if output["at"] is not None:
        place = re.search(r"\[(\d+)\]", output["name"])
        values = values[:, int(place[1]) if place else 0]
    return values if output["component"] is None else values[:, output["component"]]


@pytest.mark.parametrize("name", CASES)
def test_the_programs_of_the_documentation_run_as_rom_does(name, trained, written, reader) -> None:
    model, path = trained(name), written(name)
    for values in POINTS[name]:
        run = reader.PortableModel(path, **values)
        places = run.d["runs"]["places"]
        nearest = np.linalg.norm(places - run.place, axis=1).argmin()
        known = in_its_steps(model, values, run.d["runs"]["steps"][nearest])
        size = np.abs(known.coordinates).max()
        assert np.abs(run.coordinates - known.coordinates).max() < 1e-12 * size
        assert np.abs(run.states - known.states).max() < 1e-9 * np.abs(known.states).max()
        outputs = run.outputs()
        percent, errors, outside = reader.errors(run)
        estimate = known.estimate
        assert outside == estimate.extrapolated
        assert percent == pytest.approx(
            [estimate.velocity_percent, estimate.pressure_percent], rel=1e-8
        )
        for index, output in enumerate(run.d["outputs"]):
            expected = column(known.measured, output)
            found = outputs[output["name"]]
            assert np.abs(found - expected).max() < 1e-8 * max(np.abs(expected).max(), 1e-6)
            expected = column(known.measured_errors, output)
            np.testing.assert_allclose(errors[:, index], expected, rtol=1e-7)
        usual = model.run(parameter_point(model.workspace.case, values))
        assert np.abs(run.coordinates - usual.coordinates).max() < 0.01 * size


def test_the_second_program_knows_models_without_estimates(reader) -> None:
    assert reader.errors(SimpleNamespace(d={"errors": None})) is None


@pytest.mark.parametrize("name", CASES)
def test_documents_follow_their_schema(name, written) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    schema = json.loads((ROOT / "sphrom" / "portable" / "model.schema.json").read_text())
    found = json.loads(written(name).read_text())
    jsonschema.Draft202012Validator(schema).validate(found)
    assert {each["name"]: (each["low"], each["high"]) for each in found["parameters"]} == {
        key: (min(values), max(values))
        for key, values in CASES[name]["parameters"]["train"].items()
    }
    names = [each["name"] for each in found["outputs"]]
    assert len(set(names)) == len(names) == found["errors"]["noise"]["shape"][1]


@pytest.mark.parametrize("name", CASES)
def test_documents_of_pages_follow_the_schema_too(name, trained) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    schema = json.loads((ROOT / "sphrom" / "portable" / "model.schema.json").read_text())
    text = page.content(trained(name), 24).decode()
    part = re.search(r'<script id="model" type="application/json">(.*?)</script>', text, re.DOTALL)
    found = json.loads(part[1])
    jsonschema.Draft202012Validator(schema).validate(found)
    digest = found.pop("digest")
    assert hashlib.sha256(json.dumps(found).encode()).hexdigest() == digest


def test_fields_are_those_of_runs(trained) -> None:
    model = trained("channel")
    grid = fields(model, 30)
    run = model.run(parameter_point(model.workspace.case, POINTS["channel"][0]))
    states = np.column_stack((np.ones(len(run.time)), run.states))
    found = np.tensordot(states, grid["modes"], (1, 1))
    x, y = 1.75, 0.35  # the centre of a cell
    column, row = int(x / 3 * grid["nx"]), int(y / 2 * grid["ny"])
    centre = np.array([[3 * (column + 0.5) / grid["nx"], 2 * (row + 0.5) / grid["ny"]]])
    samples = run.sampled(centre)
    velocity = found[:, :2, row, column]
    assert np.abs(velocity - samples.velocity[:, 0]).max() < 1e-6 * np.abs(velocity).max()
    pressure = found[:, 2, row, column]
    pressure += run.reduced.mean_density_fluctuation * model.workspace.case.plan.sound_speed**2
    assert np.abs(pressure - samples.pressure[:, 0]).max() < 1e-5 * np.abs(pressure).max()
    assert not grid["inside"][int(0.5 * grid["ny"]), int(grid["nx"] / 3)]


def changed(case: Mapping[str, Any], **keys: Any) -> dict[str, Any]:
    model = {**case["rom"][0], **keys}
    return {**case, "rom": [model]}


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"time_step": 1 / 180}, "time_step is 0.0055"),
        ({"until": 0.15}, "until"),
        ({"memory_length": "auto", "projection": "apg"}, "memory length"),
    ],
)
def test_what_the_document_lacks_is_refused_by_name(keys, reason, tmp_path) -> None:
    study = package.Study(changed(VORTEX, **keys), out=tmp_path, quiet=True, threads=1)
    study.run(until="operators")
    with pytest.raises(CaseError, match=reason):
        document(study.model("fast", reynolds=100)._fast)


def test_initial_states_that_depend_on_a_parameter_are_refused(tmp_path) -> None:
    scene = {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1, 1], "periodic": ["x", "y"]},
        "constants": {"k": 2 * np.pi, "speed": 1.0},
        "initial": {"u": "speed*sin(k*y)", "v": "0.2*sin(k*x)"},
        "reference_length": 1.0,
    }
    train = {"reynolds": [50, 100], "speed": [0.5, 1.0]}
    case = {**VORTEX, "scene": scene, "parameters": {"train": train}}
    study = package.Study(changed(case), out=tmp_path, quiet=True, threads=1)
    study.run(until="operators")
    with pytest.raises(CaseError, match="its initial state depends on a parameter"):
        document(study.model("fast", reynolds=100)._fast)


@pytest.mark.parametrize("ends", [(-1.0, 0.0), (-1.0, -0.5), (0.2, 0.2), (0.0, 0.0), (0.0, 0.4)])
def test_arrays_are_split_into_products_whatever_the_sign_of_a_parameter(ends) -> None:
    products = Products({VISCOSITY: (0.015, 0.017), "f": ends})
    for within_ranges in (False, True):
        split = products.of(
            "array",
            lambda viscosity, factors: np.array([1.0, 2.0 * factors["f"] - 40.0 * viscosity]),
            within_ranges,
        )
        expected = [[1.0, 0.0], [0.0, -40.0], [0.0, 2.0], [0.0, 0.0]]
        np.testing.assert_allclose(split, expected, atol=1e-9)


# Units for system simulation


@pytest.fixture(scope="module")
def unit(trained, tmp_path_factory) -> Callable[[str], tuple[Any, Any, str]]:
    """FMPy, the description of a case's unit, and its folder."""
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    if fmu.binary() is None:
        pytest.skip("there is no C compiler")
    from fmpy.validation import validate_fmu

    known: dict[str, tuple[Any, Any, str]] = {}

    def make(name: str) -> tuple[Any, Any, str]:
        if name not in known:
            folder = tmp_path_factory.mktemp(f"unit-{name}")
            (folder / "model.fmu").write_bytes(fmu.content(trained(name)))
            assert validate_fmu(str(folder / "model.fmu")) == []
            unpacked = fmpy.extract(str(folder / "model.fmu"), str(folder / "unpacked"))
            known[name] = fmpy, fmpy.read_model_description(unpacked), unpacked
        return known[name]

    return make


def simulated(unit, kind: str, times: np.ndarray, values: Mapping[str, float], **more: Any) -> Any:
    """Return the outputs of a unit at times."""
    fmpy, about, folder = unit
    if kind == "ModelExchange":
        more["relative_tolerance"] = 1e-8
    return fmpy.simulate_fmu(
        folder,
        model_description=about,
        fmi_type=kind,
        start_time=times[0],
        stop_time=times[-1],
        output_interval=times[1] - times[0],
        start_values=dict(values),
        output=[each.name for each in about.modelVariables if each.causality == "output"],
        **more,
    )


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("name", CASES)
def test_units_run_as_rom_does_in_fine_steps(name, kind, trained, unit) -> None:
    model = trained(name)
    for values in POINTS[name]:
        point = parameter_point(model.workspace.case, values)
        reduced = model.at(point)
        fine = model.at_point(point).integrator(reduced).with_steps(1 / 16)
        known = model.run(point, reduced, fine)
        found = simulated(unit(name), kind, known.time, values)
        for output in document(model)["outputs"]:
            expected = column(known.measured, output)
            size = max(np.abs(column(known.measured, output)).max(), 1e-3)
            assert np.abs(found[output["name"]] - expected).max() < 1e-4 * size, output["name"]
        # Residuals accumulate between snapshots, too.
        velocity = found["error_velocity"][-1]
        assert velocity == pytest.approx(known.estimate.velocity[-1], rel=0.4)
        assert (found["outside"] == known.estimate.extrapolated).all()


def test_the_driving_is_an_input_whose_errors_are_unknown(trained, unit) -> None:
    model = trained("channel")
    values = {"reynolds": 40.0, "body_force": 1.0}
    run = model.run(parameter_point(model.workspace.case, values))
    times = np.linspace(0.0, 2.0, 401)  # an input is constant within a communication step
    table = zip(times, run.reduced.amplitude(times), strict=True)
    history = np.array([*table], dtype=[("time", float), ("driving", float)])
    kept = unit("channel")
    own = simulated(kept, "CoSimulation", times, values)
    switched = {**values, "own_driving": 0.0}
    given = simulated(kept, "CoSimulation", times, switched, input=history)
    size = np.abs(own["drag_force_x"]).max()
    assert np.abs(given["drag_force_x"] - own["drag_force_x"]).max() < 0.01 * size
    assert (given["outside"] == 1.0).all()
    errors = [name for name in given.dtype.names if name.startswith("error_")]
    assert all((given[name] == -1.0).all() for name in errors)
    assert all((own[name] >= 0.0).all() for name in errors)


def compiled(model: FastModel, functions: str, folder: Path) -> ctypes.CDLL:
    """Return the library of a unit with more functions."""
    if fmu.binary() is None:
        pytest.skip("there is no C compiler")
    (folder / "model.h").write_bytes(fmu._header(document(model)))
    (folder / "more.c").write_text(f'#include "{fmu.SOURCE}"\n{functions}\n')
    library = folder / "more.so"
    command = [fmu.COMPILER, *fmu.FLAGS, "-I", folder, folder / "more.c", "-o", library, "-lm"]
    subprocess.run(command, check=True, timeout=120)
    return ctypes.CDLL(str(library))


def test_units_weigh_training_runs_as_rom_does(trained, tmp_path) -> None:
    function = (
        "API double weights(const double *place, double *w) { return interpolation(place, w); }"
    )
    weights = compiled(trained("lid"), function, tmp_path).weights
    weights.restype = ctypes.c_double
    places = document(trained("lid"))["errors"]["places"]  # the corners of a rectangle
    low, high = places.min(axis=0), places.max(axis=0)
    for share in ([0.5, 0.5], [0.5, 0.2], [0.3, 0.6], [0.0, 0.5], [1.4, 0.5], [-0.2, 1.3]):
        place = low + share * (high - low)
        expected, distance = interpolation_weights(places, place)
        w = np.zeros(len(places))
        pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in (place, w)]
        assert weights(*pointers) == pytest.approx(distance, rel=1e-5, abs=1e-9)
        np.testing.assert_allclose(w, expected, atol=1e-3)


@pytest.mark.parametrize("state", ["NAN", "INFINITY"])
def test_errors_of_diverged_units_are_unknown(state, trained, tmp_path) -> None:
    function = f"""API double largest_error(double state) {{
        static Model m;
        double largest = -INFINITY;
        fmi2Reset(&m);
        prepare(&m, 1);
        m.state[0] = state, m.state[N] = state;
        compute(&m);
        for (int o = 0; o < N_UNKNOWN; o++)
            if (!(m.outputs[N_OUTPUTS + o] <= largest)) largest = m.outputs[N_OUTPUTS + o];
        return largest;
    }}
    API double of_diverged(void) {{ return largest_error({state}); }}
    API double of_zero(void) {{ return largest_error(0); }}"""
    unit = compiled(trained("lid"), function, tmp_path)
    unit.of_diverged.restype = unit.of_zero.restype = ctypes.c_double
    assert unit.of_diverged() == -1.0
    assert unit.of_zero() > 0.0


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("parameters", "driving"),
        ("parameters", "own_driving"),
        ("parameters", "outside"),
        ("outputs", "error_drag_force_x"),
    ],
)
def test_units_whose_variables_would_share_a_name_are_refused(kind, name, trained) -> None:
    found = document(trained("channel"))
    last = {**found[kind][-1], "name": name}
    with pytest.raises(CaseError, match=f"two variables of the unit would be called {name};"):
        fmu._description({**found, kind: [*found[kind][:-1], last]}, "unit")


@pytest.mark.parametrize("flags", [("-no-such-flag",), ()])
def test_units_that_do_not_compile_have_sources_alone(
    flags, trained, monkeypatch, capsys, tmp_path
) -> None:
    if fmu.binary() is None:
        pytest.skip("there is no C compiler")
    monkeypatch.setattr(fmu, "FLAGS", flags or fmu.FLAGS)
    monkeypatch.setattr(fmu, "SECONDS", 300 if flags else 1e-3)
    (tmp_path / "model.fmu").write_bytes(fmu.content(trained("vortex")))
    with zipfile.ZipFile(tmp_path / "model.fmu") as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
    said = capsys.readouterr().err
    assert "has sources alone, without a binary, because the C compiler failed" in said
    assert ("no-such-flag" if flags else "timed out") in said


def test_units_without_a_compiler_have_sources_alone(trained, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(fmu, "COMPILER", "no-such-compiler")
    (tmp_path / "model.fmu").write_bytes(fmu.content(trained("vortex")))
    with zipfile.ZipFile(tmp_path / "model.fmu") as archive:
        names = set(archive.namelist())
        about = ElementTree.fromstring(archive.read("modelDescription.xml"))
    assert names == {"modelDescription.xml", "sources/fmu.c", "sources/model.h"}
    assert about.attrib["guid"] == document(trained("vortex"))["digest"]


@pytest.fixture
def shown(trained, browser, tmp_path) -> Callable[..., Any]:
    """The browser with the page of a case."""

    def show(name: str, **window: Any) -> Any:
        path = tmp_path / "page.html"
        path.write_bytes(page.content(trained(name), 24))
        browser.open(path, **window)
        return browser

    return show


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_page_answers_as_rom_does(name, trained, shown) -> None:
    model, browser = trained(name), shown(name)
    for values in POINTS[name]:
        found = browser.value(
            f"""(() => {{
                const found = run(model, {json.dumps(values)}), known = estimated(model, found);
                solution = found;
                return {{
                    coordinates: [...found.coordinates], outputs: measured(model, found),
                    percent: known.percent, errors: known.outputs, outside: known.outside,
                    nearest: nearest(rowsOf(model.runs.places).map(x => distance(x, found.place))),
                    fields: [[u], [v], [pressure], [u, v], [vorticity]].map((parts, k) => {{
                        state.quantity = Object.keys(QUANTITIES)[k === 2 ? 1 : 0];
                        return [...fieldOf(parts, stateAt(end))];
                    }}),
                }};
            }})()"""
        )
        numbers = document(model)
        known = in_its_steps(model, values, numbers["runs"]["steps"][found["nearest"]])
        size = np.abs(known.coordinates).max()
        coordinates = np.reshape(found["coordinates"], known.coordinates.shape)
        assert np.abs(coordinates - known.coordinates).max() < 1e-10 * size
        estimate = known.estimate
        assert found["outside"] == estimate.extrapolated
        expected = [estimate.velocity_percent, estimate.pressure_percent]
        assert found["percent"] == pytest.approx(expected, rel=1e-5)
        for index, output in enumerate(numbers["outputs"]):
            expected = column(known.measured, output)
            tolerance = 1e-8 * max(np.abs(expected).max(), 1e-6)
            assert np.abs(np.array(found["outputs"][index]) - expected).max() < tolerance
            expected = column(known.measured_errors, output)
            np.testing.assert_allclose(found["errors"][index], expected, rtol=1e-5)
        grid = fields(model, 24)
        inside = grid["inside"].astype(bool).ravel()
        axes = (
            low + (high - low) * (np.arange(n) + 0.5) / n
            for low, high, n in zip(
                grid["lower"], grid["upper"], (grid["nx"], grid["ny"]), strict=True
            )
        )
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)[inside]
        samples = known.sampled(points)
        *shown_fields, vorticity = (np.array(field)[inside] for field in found["fields"])
        velocity, pressure = samples.velocity[-1], samples.pressure[-1]
        exact = velocity[:, 0], velocity[:, 1], pressure, np.hypot(*velocity.T)
        for seen, truth in zip(shown_fields, exact, strict=True):
            scale = np.abs(pressure if truth is pressure else velocity).max()
            assert np.abs(seen - truth).max() < 1e-4 * scale
        assert np.isfinite(vorticity).all()


@pytest.mark.slow
def test_the_vorticity_of_a_page_is_that_of_the_flow(shown) -> None:
    browser = shown("vortex")
    found = browser.value(
        "(() => { state.quantity = 'vorticity'; "
        "return [...fieldOf([vorticity], stateAt(start))] })()"
    )
    x, y = np.meshgrid(*[(np.arange(24) + 0.5) / 24] * 2)
    velocity = browser.value("[u, v].map(part => [...onGrid(part, stateAt(start), nx * ny)])")
    amplitude = np.abs(velocity).max()
    assert len(found) == x.size == y.size
    # Both velocities are products of a sine and a cosine of 2 pi x and 2 pi y.
    largest = 4 * np.pi * amplitude
    assert np.abs(found).max() == pytest.approx(largest, rel=0.05)
    assert abs(np.mean(found)) < 1e-3 * largest


@pytest.mark.slow
def test_a_page_of_a_box_in_space_shows_three_slices(
    trained, browser, tmp_path, monkeypatch
) -> None:
    model = trained("vortex")
    known = document(model)
    n_columns = 1 + known["n_modes"] + known["n_own"]
    box = SpaceBox((0.0, 0.0, 1.0), (2.0, 1.0, 2.0), (True, True, False))
    factors = np.random.default_rng(2).normal(size=(n_columns, 3))

    def samples(_: Any, points: np.ndarray) -> Samples:
        velocity = factors[:, None] * np.sin(points)
        return Samples(np.zeros(n_columns), velocity, np.cos(velocity[..., 2]))

    scene = SimpleNamespace(domain=box)
    stub = SimpleNamespace(
        workspace=SimpleNamespace(case=SimpleNamespace(scene=scene)),
        family=SimpleNamespace(part=lambda _: samples),
    )
    in_space = fields(stub, 24)
    known["geometry"] |= {"lower": list(box.lower), "upper": list(box.upper), "fluid": []}
    monkeypatch.setattr(page.document, "fields", lambda *_: in_space)
    monkeypatch.setattr(page.document, "document", lambda _: known)
    path = tmp_path / "page.html"
    path.write_bytes(page.content(model, 24))
    browser.open(path)
    state = np.array(browser.value("[1, ...stateAt(end)]"))
    for number, name in enumerate(("x-velocity", "y-velocity", "z-velocity")):
        seen = np.array(browser.value(f"[...fieldOf(columnsOf['{name}'], stateAt(end))]"))
        exact = np.tensordot(state, in_space["modes"][number], 1).ravel()
        assert np.abs(seen - exact).max() < 1e-3 * np.abs(exact).max()
    inside = in_space["inside"].astype(bool)
    assert 0.7 < inside.mean() < 1.0
    assert not inside[-1, -1]
    names = browser.value("[...document.querySelectorAll('#quantity option')].map(x => x.value)")
    assert names == ["speed", "pressure", "x-velocity", "y-velocity", "z-velocity"]
    labels = browser.value("['rightward', 'right', 'top'].map(name => $(name).textContent)")
    assert labels == ["x, then z [m]", "2", "2"]
    assert (browser.requests, browser.problems) == ([], [])


@pytest.mark.slow
def test_a_page_is_used_by_keyboard_and_asks_for_nothing(shown) -> None:
    browser = shown("lid", width=400)
    said = "document.querySelector('[role=status]').textContent"
    before = browser.value(said)
    assert "reynolds = 71, lid = 0.75, t = " in before
    assert "Estimated error over the whole field and run: " in before
    assert not browser.value("document.body.classList.contains('outside')")
    browser.value("document.getElementById('p1').focus()")
    browser.press("ArrowRight", 39)
    assert "lid = 0.76" in browser.value(said)
    browser.press("End", 35)
    assert "Outside of the trained range: lid was trained from 0.5 to 1." in browser.value(said)
    assert "extrapolated" in browser.value(said)
    assert browser.value("document.body.classList.contains('outside')")
    browser.value("document.getElementById('time').focus()")
    browser.press("Home", 36)
    assert "t = 0 s" in browser.value(said)
    browser.value("document.getElementById('quantity').focus()")
    browser.press("ArrowDown", 40)
    assert "pressure from " in browser.value(said)
    browser.value("document.getElementById('play').focus()")
    browser.press(" ", 32)
    browser.value("new Promise(done => setTimeout(done, 200))")
    browser.press(" ", 32)
    assert browser.value("state.time") > 0.0
    rows = browser.value("[...document.querySelectorAll('#values tr')].map(x => x.textContent)")
    assert len(rows) == 2 + browser.value("model.outputs.length")
    assert browser.value("document.documentElement.scrollWidth <= innerWidth")
    assert (browser.requests, browser.problems) == ([], [])


@pytest.mark.slow
def test_hostile_names_stay_texts(trained, browser, tmp_path, monkeypatch) -> None:
    hostile = "</script><!-- <script><img src=x onerror=document.title='taken'>"
    known = document(trained("channel"))
    known["case"] = hostile
    for part in (known["outputs"][0], known["parameters"][1], known["geometry"]["solids"][0]):
        part["name"] = hostile
    known["products"] = [
        [hostile if name == "body_force" else name for name in names] for names in known["products"]
    ]
    monkeypatch.setattr(page.document, "document", lambda model: known)
    path = tmp_path / "page.html"
    path.write_bytes(page.content(trained("channel"), 24))
    browser.open(path)
    for place in ("h1", "label", "figcaption", "th", "#outlines title"):
        texts = f"[...document.querySelectorAll('{place}')].map(x => x.textContent)"
        assert any(hostile in text for text in browser.value(texts)), place
    assert browser.value("document.images.length") == 0
    assert browser.value("document.title") == f"{hostile}: fast"
    assert browser.value("document.querySelector('[role=status]').textContent").startswith(
        "reynolds = "
    )
    assert (browser.requests, browser.problems) == ([], [])


def test_the_documentation_shows_the_present_page() -> None:
    text = (ROOT / "docs" / "static" / "model-fast.html").read_text()
    assert len(text) < 500_000
    for name in ("model.js", "page.js"):
        assert (ROOT / "sphrom" / "portable" / name).read_text() in text, "export it again"


def test_pages_are_small(trained) -> None:
    model = trained("lid")
    assert len(page.content(model, 24)) < len(page.content(model)) < 1_500_000
