"""Artifacts are written whole, described, checked, or not at all."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from sphrom.artifacts import create_artifact, open_artifact
from sphrom.errors import ArtifactError
from sphrom.whole_files import TemporaryFile

SCHEMA = "sphrom/trajectory"


def test_datasets_and_attributes_carry_what_the_table_says(write_trajectory, fields) -> None:
    with h5py.File(write_trajectory()) as file:
        for name, array in fields.items():
            np.testing.assert_array_equal(file[name][...], array)
            assert file[name].fletcher32
        velocity = file["velocity"]
        assert velocity.attrs["axes"] == b"snapshot,particle,component"
        assert velocity.attrs["units"] == b"m/s"
        assert velocity.attrs["equation"] == b"Eq. 2.7"
        assert velocity.chunks == (1, 5, 2)
        assert file.attrs["schema"] == b"sphrom/trajectory"
        assert file.attrs["stage"] == b"fom"
        assert file.attrs["inputs_sha256"] == b"inputs"
        assert file.attrs["wall_seconds"] > 0
        assert file["parameters"].attrs["reynolds"] == 100.0
        assert file["case"][()].decode().startswith("name: demo")


def test_streamed_and_whole_writing_give_the_same_content(
    tmp_path: Path, write_trajectory, fields, arguments
) -> None:
    with create_artifact(tmp_path / "streamed.h5", SCHEMA, **arguments) as artifact:
        streams = {name: artifact.stream(name, a.shape[1:], 3) for name, a in fields.items()}
        for snapshot in range(3):
            for name, stream in streams.items():
                stream.append(fields[name][snapshot])
    with (
        open_artifact(tmp_path / "streamed.h5", SCHEMA, made_by="fom") as streamed,
        open_artifact(write_trajectory(), SCHEMA, made_by="fom") as whole,
    ):
        assert streamed.content_sha256 == whole.content_sha256
        assert streamed.identity != whole.identity


@pytest.mark.parametrize(
    ("changed", "attributes", "n_digests"),
    [
        ({"time": np.array([0.0, 0.5, 1.0 + 2.0**-50])}, {}, 2),
        ({}, {"mass": 11.0}, 2),
        ({}, {"timing/loop": 2.0}, 1),
    ],
)
def test_digest_tells_contents_apart_but_for_the_time_spent(
    tmp_path: Path, write_trajectory, arguments, changed, attributes, n_digests: int
) -> None:
    given = arguments["attributes"] | attributes
    digests = set()
    for path in (
        write_trajectory(),
        write_trajectory(tmp_path / "other.h5", changed, attributes=given),
    ):
        with open_artifact(path, SCHEMA, made_by="fom") as artifact:
            digests.add(artifact.content_sha256)
    assert len(digests) == n_digests


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path: Path, arguments, bad: float) -> None:
    with (
        pytest.raises(ArtifactError, match=r"pressure holds .* at snapshot 1, particle 4"),
        create_artifact(tmp_path / "fom.h5", SCHEMA, **arguments) as artifact,
    ):
        artifact.stream("pressure", (5,), 3).extend(np.array([5 * [0.0], [0, 0, 0, 0, bad]]))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda artifact: None, "time is missing"),
        (lambda artifact: artifact.stream("time", (), 3).append(0.0), "time has 1 of 3 items"),
        (lambda artifact: artifact.write("temperature", np.zeros(3)), "temperature is no dataset"),
        (lambda artifact: artifact.write("time", np.zeros((3, 1))), "axes"),
        (lambda artifact: artifact.write("time", np.arange(3)), "float64"),
    ],
)
def test_what_is_not_as_declared_is_a_programming_error(
    tmp_path: Path, arguments, write, message: str
) -> None:
    with (
        pytest.raises(ValueError, match=message),
        create_artifact(tmp_path / "fom.h5", SCHEMA, **arguments) as artifact,
    ):
        write(artifact)
    assert list(tmp_path.iterdir()) == []


def test_no_garbage_is_collected_while_hdf5_calls_the_file(write_trajectory, monkeypatch) -> None:
    """What is freed then may be HDF5's own: entered a second time, it damages what it writes."""
    collected = []

    def spied(method: Callable) -> Callable:
        def called(*arguments):
            collected.append(gc.isenabled())
            return method(*arguments)

        return called

    for name in ("readinto", "write"):
        monkeypatch.setattr(TemporaryFile, name, spied(getattr(TemporaryFile, name)))
    write_trajectory()
    assert collected
    assert not any(collected)
    assert gc.isenabled()


def test_a_thousand_datasets_are_written_and_read(tmp_path: Path, arguments) -> None:
    """As for many models and sizes of basis: HDF5 holds open what is being written alone."""
    path = tmp_path / "sweep.h5"
    names = ("coordinate", "reference_value", "value", "scatter")
    before = open_datasets()
    with create_artifact(path, "sphrom/comparison", **(arguments | {"attributes": {}})) as artifact:
        for i in range(250):
            for name in names:
                artifact.write(f"reference/full/reynolds{i}/{name}", np.array([1.0, i]))
        assert open_datasets() == before
    with open_artifact(path, "sphrom/comparison", made_by="") as artifact:
        assert len(artifact.datasets) == 1000
        for name in artifact.datasets:
            assert artifact.read(name)[1] == float(name.split("/")[2].removeprefix("reynolds"))
        assert open_datasets() == before


def open_datasets() -> int:
    return h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_DATASET)
