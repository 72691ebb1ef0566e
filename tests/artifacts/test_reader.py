"""What an artifact gives, and whether it is of the kind, case and inputs that are asked for."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from sphrom.artifacts import Identity, open_artifact, probe, reader
from sphrom.artifacts.reader import case_differences
from sphrom.errors import ArtifactError, ResourceError

SCHEMA = "sphrom/trajectory"
MADE_BY = "sphrom fom CASE"
SETTLED = "sphrom.artifacts.reader.SETTLED"


def test_reads_back_what_was_written(write_trajectory, fields) -> None:
    with open_artifact(write_trajectory(), SCHEMA, made_by=MADE_BY) as artifact:
        assert artifact.datasets == sorted(fields)
        for name, array in fields.items():
            np.testing.assert_array_equal(artifact.read(name), array)
        velocity = artifact.dataset("velocity")
        assert velocity.shape == (3, 5, 2)
        np.testing.assert_array_equal(velocity[1:, 2:4], fields["velocity"][1:, 2:4])
        np.testing.assert_array_equal(list(velocity), fields["velocity"])
        with pytest.raises(KeyError):
            artifact.read("vorticity")


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: None, "is missing"),
        (os.mkfifo, "is not a file"),
        (Path.touch, "is damaged, truncated, or not an HDF5 file"),
        (lambda path: path.write_text("time\n0\n"), "is damaged, truncated, or not an HDF5 file"),
        (lambda path: h5py.File(path, "w").close(), "is not an artifact of sphrom"),
    ],
)
def test_what_is_no_artifact_is_refused(tmp_path: Path, refusal, make, reason: str) -> None:
    make(tmp_path / "fom.h5")
    assert refusal(tmp_path / "fom.h5") == reason


def test_file_that_may_not_be_read(write_trajectory, refusal, monkeypatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = write_trajectory()
    monkeypatch.setattr(Path, "open", refuse)
    assert refusal(path) == "can't be read (Permission denied)"


def test_another_kind_is_refused(write_trajectory, refusal) -> None:
    reason = "holds 'sphrom/trajectory', not 'sphrom/basis'"
    assert refusal(write_trajectory(), "sphrom/basis") == reason


def test_newer_minor_version_only_adds(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = np.bytes_("1.7")
        file["vorticity"] = np.zeros((3, 5))
        file.attrs["colour"] = "of variable length, and so never read"
    assert probe(path, SCHEMA) is None


CASE = {
    "name": "demo",
    "fluid": {"reynolds": 100, "density": 1000.0},
    "rom": [{"method": "galerkin", "modes": 5}, {"method": "apg"}],
    "train": [100, 150],
}


@pytest.mark.parametrize(
    ("sections", "changed", "told"),
    [
        (CASE, {"floor": {"file": "floor.wkt"}}, ""),  # what it holds is beside it
        (CASE, {"name": "other", "train": []}, "name is demo there, other here; train is "
         "[100, 150] there, [] here"),
        (CASE, {"rom": [{"method": "galerkin", "modes": 10}], "train": [100, 175]},
         "rom[0].modes is 5 there, 10 here; train is [100, 150] there, [100, 175] here; "
         "rom[1].method is apg there, absent here"),
        (("train",), {"name": "other", "train": [100.0, 20, 150]}, "train is [100, 150] there, "
         "[100, 20, 150] here"),
    ],
)  # fmt: skip
def test_keys_in_which_cases_differ_are_named(sections, changed, told: str) -> None:
    """Those of the sections that are asked about, and first those that both have."""
    there, here = (yaml.safe_dump(case, sort_keys=False) for case in (CASE, CASE | changed))
    assert case_differences(there, here, sections) == told


def test_another_parent_is_refused(write_trajectory, refusal) -> None:
    parent = Identity("packing.h5", "uuid-1", "content-1")
    path = write_trajectory(lineage={"packing": parent})
    other = Identity("packing.h5", "uuid-1", "content-2")
    reason = refusal(path, lineage={"packing": other})
    assert reason == "was made from another input: packing.h5 (packing) has changed since"
    reason = refusal(path, lineage={"basis": parent})
    assert reason == "was made without the input basis (packing.h5)"


@pytest.mark.parametrize("settled", [-1.0, 1e9])
def test_file_that_changes_after_it_was_verified_is_verified_again(
    write_large, monkeypatch, settled: float
) -> None:
    """Whether it is remembered that it was verified, or the file is too new for that."""
    path = write_large()
    monkeypatch.setattr(SETTLED, settled)
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        artifact.verify_content()
    os.utime(path, (0, 0))
    with h5py.File(path, "r+") as file:
        file["velocity"][2] = 0.0
    os.utime(path, (0, 0))
    with (
        open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact,
        pytest.raises(ArtifactError, match="velocity has changed since it was written"),
    ):
        artifact.dataset("velocity")[0]


def test_a_file_is_looked_through_and_verified_once(write_large, monkeypatch) -> None:
    path = write_large()
    monkeypatch.setattr(SETTLED, -1.0)
    for _ in range(2):
        with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
            artifact.dataset("velocity")[1]
            artifact.read("velocity")
        monkeypatch.setattr(reader, "inspect", None)  # would raise
        monkeypatch.setattr(reader, "hashlib", None)


def test_data_larger_than_the_memory_are_refused(write_trajectory, monkeypatch) -> None:
    """Parts of them are read all the same."""
    monkeypatch.setattr(reader, "SMALL_BYTES", 0)
    with open_artifact(write_trajectory(), SCHEMA, made_by=MADE_BY) as artifact:
        monkeypatch.setattr(reader, "available_ram", lambda: 8 * 3 * 5 * 2)
        assert artifact.read("velocity").shape == (3, 5, 2)
        monkeypatch.setattr(reader, "available_ram", lambda: 8 * 3 * 5 * 2 - 1)
        assert artifact.dataset("velocity")[1].shape == (5, 2)
        with pytest.raises(ResourceError, match=r"velocity of .* needs"):
            artifact.read("velocity")


@pytest.mark.parametrize("locking", [None, True, False, "best-effort"])
def test_other_readers_in_this_process_open_it_too(write_trajectory, locking) -> None:
    """HDF5 refuses a file that the process has open with other flags for its lock."""
    path = write_trajectory()
    with h5py.File(path, locking=locking), open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        assert len(artifact.read("time")) == 3
    with open_artifact(path, SCHEMA, made_by=MADE_BY), h5py.File(path) as file:
        assert len(file["time"]) == 3


def test_a_lock_of_another_program_keeps_no_reader_out(write_trajectory) -> None:
    """An artifact never changes; some file systems have locks that never end, or none."""
    path = write_trajectory()
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
            assert len(artifact.read("time")) == 3


def test_of_long_lists_the_difference_is_shown() -> None:
    there, here = list(range(100)), [*range(50), 49.5, *range(50, 100)]
    texts = (yaml.safe_dump({"train": values}) for values in (there, here))
    told = "train is [..., ...] there, [..., 49.5, ...] here"
    assert case_differences(*texts, ("train",)) == told
