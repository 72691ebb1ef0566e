"""A trained model in a file of its own: it is checked, and answers like its study."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import sphrom
from sphrom.errors import ArtifactError, CaseError
from sphrom.models.points.fast_model import FastModel
from sphrom.store.workspace import Workspace

HERE = {"reynolds": 120.0, "lid": 0.8}


@pytest.fixture
def alone(study: sphrom.Study, tmp_path: Path) -> Path:
    """The file of the model in a folder without anything else."""
    return Path(shutil.copy(study.folder / "model-fast.h5", tmp_path))


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
