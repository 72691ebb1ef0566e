"""What all families of reduced models have in common, shown with a run of each."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import sphrom
from sphrom.case import tables
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.models.contract import FAMILIES, Ability, Model, ModelRun, family_of, model_of
from sphrom.models.points.fast_model import FastModel
from sphrom.models.stored_run import StoredRun
from sphrom.store.workspace import Workspace

NAMES = {"points": "fast", "particles": "slow", "surface": "fast"}
HERE = {
    "points": {"reynolds": 50.0, "lid": 0.5},
    "particles": {"reynolds": 50.0, "lid": 0.5},
    "surface": {"reynolds": 250.0, "ratio": 0.85},
}
BETWEEN = {"points": {"reynolds": 120.0, "lid": 0.8}, "surface": {"reynolds": 250.0, "ratio": 0.95}}
PROBE = {"points": [0.5, 0.5], "particles": [0.5, 0.5], "surface": [0.5, 0.25]}
ASKED: dict[Ability, Callable[[sphrom.Study, sphrom.Model], Any]] = {
    Ability.RUNS_ALONE: lambda study, model: model.start,
    Ability.OTHER_TIMES: lambda study, model: model.run(final_time=0.1),
    Ability.EQUATIONS: lambda study, model: model.rates(np.zeros(5)),
    Ability.SENSITIVITIES: lambda study, model: model.sensitivities(),
    Ability.TRAINING: lambda study, model: study.run_stage("train"),
    Ability.EXTREMES: lambda study, model: study.run_stage("extremes"),
}
Opened = tuple[Model[Any], ParameterPoint, ModelRun]


@pytest.fixture(params=FAMILIES)
def family(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def opened(family: str, study_of: Callable[[str], sphrom.Study]) -> Opened:
    study = study_of(family)
    (section,) = (each for each in study.case.rom if each.name == NAMES[family])
    model = model_of(Workspace(study._context), section)
    assert model.family is FAMILIES[family] is family_of(study.case, section)
    point = study.case.plan.point(HERE[family])
    return model, point, model.run(point)


def test_a_run_has_times_shapes_and_a_name(opened: Opened) -> None:
    model, point, run = opened
    steps = model.workspace.case.plan.steps
    times = steps.start_time + steps.snapshot_interval * np.arange(steps.n_snapshots)
    np.testing.assert_allclose(run.time, times, rtol=1e-12)
    assert run.coordinates.shape[0] == len(times)
    assert np.isfinite(run.coordinates).all()
    assert run.time_step > 0.0
    assert run.name == f"{model.section.name}, {point.label}"
    assert (run.failure, run.outside, run.doubts) == (None, (), ())
    assert run.kinetic_energy.shape == times.shape
    assert run.kinetic_energy[-1] > 0.0
    assert run.largest_speed > 0.0
    assert set(run.measured) == set(model.workspace.case.scene.recorded)
    assert all(len(v) == len(times) for each in run.measured.values() for v in each.values())
    if run.estimate is None:
        assert run.measured_errors == run.measured_shares == {}
    else:
        assert run.estimate.velocity.shape == run.estimate.pressure.shape == times.shape
        assert set(run.measured_errors) == set(run.measured)


def test_runs_probes_and_stored_runs_have_one_field(family: str, opened: Opened) -> None:
    model, point, run = opened
    places = np.array([PROBE[family], [0.4, 0.2]])
    # The section of the case, whose number of modes may be reduced by noise in the model's.
    (section,) = (each for each in model.workspace.case.rom if each.name == NAMES[family])
    with StoredRun.opened(model.workspace, point, section) as stored:
        assert stored.is_complete
        found = stored.sampled(places)
        velocity, pressure = stored.fields(1)
        assert velocity.shape == stored.position(1).shape
        assert pressure.shape == velocity.shape[:1]
    expected = run.sampled(places)
    for name in ("velocity", "pressure"):  # a probe measures what is sampled there
        sampled = getattr(expected, name)[:, :1]
        measured = run.measured["centre"][name]
        np.testing.assert_allclose(measured, sampled, atol=1e-9 * np.abs(sampled).max())
    np.testing.assert_array_equal(found.velocity, expected.velocity)
    np.testing.assert_array_equal(found.pressure, expected.pressure)


def test_sensitivities_are_differences_of_runs(opened: Opened) -> None:
    model, point, _ = opened
    if not model.family.can(Ability.SENSITIVITIES):
        return
    slopes = model.tangents(point, ["lid"], model.at(point))
    plan = model.workspace.case.plan
    low, high = (model.run(plan.point({**point.as_dict(), "lid": lid})) for lid in (0.499, 0.501))
    expected = (high.coordinates - low.coordinates) / 2e-3
    # The correction has a kink at a training point; rounding of steps is far below its size.
    np.testing.assert_allclose(slopes.coordinates[0], expected, atol=0.05 * np.abs(expected).max())


def answers(model: sphrom.Model) -> dict[str, Any]:
    """Return all that a model gives at one point."""
    result = model.run()
    fields = result.fields([[0.2, 0.3], [0.7, 0.4]])
    found = {"coordinates": result.coordinates, **result.measures, **fields}
    if (estimate := result.error_estimate) is not None:
        found |= {"velocity error": estimate.velocity, "pressure error": estimate.pressure}
    if "lid" in model.parameters:
        found["slopes"] = model.sensitivities("lid").coordinates
    return found


@pytest.mark.parametrize("family", BETWEEN)
def test_a_file_alone_answers_to_the_bit_like_its_study(
    family: str,
    study_of: Callable[[str], sphrom.Study],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The file has the measured history that shakes the tank, too."""
    study = study_of(family)
    own = answers(study.model("fast", **BETWEEN[family]))
    alone = Path(shutil.copy(study.folder / "model-fast.h5", tmp_path))
    monkeypatch.setattr(tables, "_TABLES", {})
    loaded = answers(sphrom.load(alone).at(**BETWEEN[family]))
    assert own.keys() == loaded.keys()
    for name, values in own.items():
        np.testing.assert_array_equal(loaded[name], values, name)


@pytest.mark.parametrize("ability", ASKED)
def test_what_a_family_lacks_is_refused_by_name(
    ability: Ability, family: str, study_of: Callable[[str], sphrom.Study]
) -> None:
    lacks = FAMILIES[family].lacks
    if ability not in lacks or (family, ability) == ("particles", Ability.TRAINING):
        return  # a case with models on particles trains its other models
    study = study_of(family)
    words = re.escape(lacks[ability].format(model=NAMES[family]))
    with pytest.raises(CaseError, match=words):
        ASKED[ability](study, study.model(NAMES[family], **HERE[family]))


@pytest.fixture
def alone(study: sphrom.Study, tmp_path: Path) -> Path:
    """The file of the model in a folder without anything else."""
    return Path(shutil.copy(study.folder / "model-fast.h5", tmp_path))


def test_a_model_that_was_just_trained_has_the_bits_of_its_file(study: sphrom.Study) -> None:
    workspace = Workspace(study._context)
    opened = FastModel(workspace, study.case.rom[0])
    trained = FastModel(workspace, study.case.rom[0])
    trained._stored = None
    point = study.case.plan.point(BETWEEN["points"])
    first, second = (model.run(point) for model in (opened, trained))
    np.testing.assert_array_equal(first.coordinates, second.coordinates)
    np.testing.assert_array_equal(first.measured["drag"]["force"], second.measured["drag"]["force"])
    assert first.estimate is not None
    assert second.estimate is not None
    np.testing.assert_array_equal(first.estimate.velocity, second.estimate.velocity)


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


def test_many_runs_of_a_file_are_those_of_its_study(study: sphrom.Study, alone: Path) -> None:
    points = {"reynolds": [60.0, 150.0], "lid": [0.6, 0.9]}
    own = study.model("fast", **BETWEEN["points"]).run_many(points)
    assert sphrom.load(alone).run_many(points).identical(own)


def test_a_file_is_still_checked(alone: Path) -> None:
    with pytest.raises(CaseError, match="speed"):
        sphrom.load(alone).at(reynolds=100.0, speed=1.0)
    with h5py.File(alone, "r+") as file:
        file["bases/all/places"][0, 0] = 7.0
    with pytest.raises(ArtifactError, match="damaged"):
        sphrom.load(alone)


@pytest.mark.parametrize("name", ["operators.h5", "pod.h5"])
def test_other_artifacts_are_no_models(study: sphrom.Study, name: str) -> None:
    with pytest.raises(ArtifactError, match="not a model"):
        sphrom.load(study.folder / name)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match=r"none\.h5"):
        sphrom.load(tmp_path / "none.h5")
