"""A trained model in a file of its own: it answers like its study, alone and to the bit."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import sphrom
from sphrom.case import tables
from sphrom.errors import ArtifactError, CaseError
from sphrom.models.points.fast_model import FastModel
from sphrom.store.workspace import Workspace

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "drag": {"force_on": "top"},
            "centre": {"probe": [0.5, 0.5]},
            "middle": {"line": {"from": [0.5, 0], "to": [0.5, 1], "points": 5}},
        },
    },
    "discretization": {"resolution": 16},
    "time": {"final_time": 0.6},
    "snapshots": {"every": 6},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 5}],
    "compare": {"plots": False, "grid": 8},
}
HERE = {"reynolds": 120.0, "lid": 0.8}
TANK: dict[str, Any] = {
    "name": "tank",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1, 1]},
        "fluid": {"level": 0.5, "gravity": 1.0},
        "slip": "free",
        "constants": {"ratio": 0.9},
        "histories": {"sway": {"file": "sway.csv"}},
        "body_force": ["0.02*ratio*sway(t)", 0],
        "reference_length": 0.5,
        "measure": {"gauge": {"elevation": 0}, "side": {"force_on": "left"}},
    },
    "fluid": {"reference_speed": 0.7},
    "discretization": {"resolution": 10},
    "time": {"final_time": 2.0},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [250], "ratio": [0.85, 1.1]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False, "grid": 8},
}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    made = sphrom.Study(CASE, out=tmp_path_factory.mktemp("lid") / "runs", threads=1, quiet=True)
    made.run(until="operators")
    return made


@pytest.fixture
def alone(study: sphrom.Study, tmp_path: Path) -> Path:
    """The file of the model in a folder without anything else."""
    return Path(shutil.copy(study.folder / "model-fast.h5", tmp_path))


def answers(model: sphrom.Model) -> dict[str, np.ndarray]:
    """Return all that a model gives at one point."""
    result = model.at(**HERE).run()
    estimate = result.error_estimate
    assert estimate is not None
    measures = {str(name): values.to_numpy() for name, values in result.measures.items()}
    fields = result.fields([[0.2, 0.3], [0.7, 0.9]])
    slopes = model.at(**HERE).sensitivities("lid")
    return {
        **measures,
        "coordinates": result.coordinates,
        "velocity": fields.velocity.to_numpy(),
        "pressure": fields.pressure.to_numpy(),
        "velocity error": estimate.velocity,
        "pressure error": estimate.pressure,
        "slopes": slopes.coordinates,
    }


def test_a_file_alone_answers_to_the_bit_like_its_study(study: sphrom.Study, alone: Path) -> None:
    own, loaded = answers(study.model("fast", **HERE)), answers(sphrom.load(alone))
    assert own.keys() == loaded.keys()
    for name, values in own.items():
        np.testing.assert_array_equal(loaded[name], values, name)


OPENED = """
import sys, sphrom
heavy = "numba", "scipy", "matplotlib", "xarray", "rich"
model = sphrom.load(sys.argv[1]).at(reynolds=120, lid=0.8)
print(*[name for name in heavy if name in sys.modules])
model.run()._measured()
print(*[name for name in ("scipy.sparse", *heavy) if name in sys.modules])
"""


def test_opening_a_file_loads_no_compiled_code_and_no_scipy(alone: Path, printed) -> None:
    """A run needs compiled steps, and an exponential of scipy for their matrices."""
    assert printed(OPENED, alone) == "\nnumba scipy\n"


def test_a_model_that_was_just_trained_has_the_bits_of_its_file(study: sphrom.Study) -> None:
    workspace = Workspace(study._context)
    opened = FastModel(workspace, study.case.rom[0])
    trained = FastModel(workspace, study.case.rom[0])
    trained._stored = None
    point = study.case.plan.point(HERE)
    first, second = (model.run(point) for model in (opened, trained))
    np.testing.assert_array_equal(first.coordinates, second.coordinates)
    np.testing.assert_array_equal(first.measured["drag"]["force"], second.measured["drag"]["force"])
    assert first.estimate is not None
    assert second.estimate is not None
    np.testing.assert_array_equal(first.estimate.velocity, second.estimate.velocity)


def test_many_runs_of_a_file_are_those_of_its_study(study: sphrom.Study, alone: Path) -> None:
    points = {"reynolds": [60.0, 150.0], "lid": [0.6, 0.9]}
    own = study.model("fast", **HERE).run_many(points)
    assert sphrom.load(alone).run_many(points).identical(own)


def test_a_tank_s_file_alone_answers_like_its_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file has the measured history that shakes the tank, too."""
    monkeypatch.chdir(tmp_path)
    times = np.arange(0.0, 2.3, 0.1)
    np.savetxt("sway.csv", np.column_stack([times, np.sin(1.5 * times)]), "%.6f", ",", header="t,a")
    Path("sway.csv").write_text(Path("sway.csv").read_text().removeprefix("# "))
    study = sphrom.Study(TANK, out="runs", threads=1, quiet=True)
    study.run(until="operators")
    own = study.model("fast", reynolds=250, ratio=0.95).run()
    own_measures, own_fields = own.measures, own.fields([[0.3, 0.2]])
    alone = Path(shutil.copy(study.folder / "model-fast.h5", tmp_path))
    Path("sway.csv").unlink()
    tables._TABLES.clear()
    loaded = sphrom.load(alone).at(reynolds=250, ratio=0.95).run()
    np.testing.assert_array_equal(loaded.coordinates, own.coordinates)
    assert loaded.measures.identical(own_measures)
    assert loaded.fields([[0.3, 0.2]]).identical(own_fields)


def test_a_file_is_still_checked(alone: Path) -> None:
    with pytest.raises(CaseError, match="speed"):
        sphrom.load(alone).at(reynolds=100.0, speed=1.0)
    with h5py.File(alone, "r+") as file:
        file["bases/all/places"][0, 0] = 7.0
    with pytest.raises(ArtifactError, match="damaged"):
        sphrom.load(alone)


@pytest.mark.parametrize("name", ["operators.h5", "pod.h5"])
def test_other_artifacts_are_no_models(study: sphrom.Study, name: str) -> None:
    with pytest.raises(ArtifactError, match="no model"):
        sphrom.load(study.folder / name)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match=r"none\.h5"):
        sphrom.load(tmp_path / "none.h5")
