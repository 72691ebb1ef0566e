"""What an artifact gives, and every reason for which one is refused."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from sphrom.artifacts import Identity, open_artifact, probe, read_density, validity
from sphrom.errors import ArtifactError, ResourceError

SCHEMA = "sphrom/trajectory"
MADE_BY = "sphrom fom CASE"
READS = (
    lambda artifact, name: artifact.read(name),
    lambda artifact, name: artifact.dataset(name)[0],
    lambda artifact, name: artifact.dataset(name)[:, 1:3],
    lambda artifact, name: next(iter(artifact.dataset(name))),
    lambda artifact, name: artifact.verify_content(),
)
"""The ways to read a dataset; each has to find damage anywhere in it."""


def refusal(path: Path, schema: str = SCHEMA, **expected: object) -> str:
    """Return why `path` is refused, having checked the message and `probe` along the way."""
    with (
        pytest.raises(ArtifactError) as caught,
        open_artifact(path, schema, made_by=MADE_BY, **expected),
    ):
        pass
    reason = probe(path, schema, **expected)
    assert reason is not None
    assert str(caught.value).startswith(f"{path} {reason}; make it ")
    assert f"`{MADE_BY}" in str(caught.value)
    return reason


def flip(path: Path, dataset: str, chunk: int, byte: int = 3) -> None:
    """Flip one bit in the data of a dataset."""
    with h5py.File(path) as file:
        offset = file[dataset].id.get_chunk_info(chunk).byte_offset
    with path.open("r+b") as stream:
        stream.seek(offset + byte)
        value = stream.read(1)[0]
        stream.seek(offset + byte)
        stream.write(bytes([value ^ 0x10]))


def test_reads_back_what_was_written(write_trajectory, fields) -> None:
    path = write_trajectory()
    assert probe(path, SCHEMA, inputs_digest="inputs") is None
    with open_artifact(path, SCHEMA, made_by=MADE_BY, inputs_digest="inputs") as artifact:
        assert artifact.datasets == sorted(fields)
        for name, array in fields.items():
            np.testing.assert_array_equal(artifact.read(name), array)
        velocity = artifact.dataset("velocity")
        assert velocity.shape == (3, 5, 2)
        np.testing.assert_array_equal(velocity[1], fields["velocity"][1])
        np.testing.assert_array_equal(velocity[1:, 2:4], fields["velocity"][1:, 2:4])
        np.testing.assert_array_equal(list(velocity), fields["velocity"])
        assert artifact.number("sound_speed") == 10.0
        assert artifact.attributes["box_length"] == (1.0, 1.0)
        assert artifact.attributes_of("parameters") == {"reynolds": 100.0}
        assert artifact.case_text.startswith("name: demo")
        assert "generalized_coordinates" not in artifact
        np.testing.assert_array_equal(
            read_density(artifact, 2), 1000.0 + fields["density_fluctuation"][2]
        )
        artifact.verify_content()
        assert artifact.identity == Identity("fom.h5", artifact.uuid, artifact.content_sha256)


def test_missing_file_names_the_command(tmp_path: Path) -> None:
    assert refusal(tmp_path / "fom.h5") == "is missing"
    with (
        pytest.raises(ArtifactError, match=r"is missing; make it with `sphrom fom CASE`$"),
        open_artifact(tmp_path / "fom.h5", SCHEMA, made_by=MADE_BY),
    ):
        pass


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.h5").mkdir()
    assert refusal(tmp_path / "folder.h5") == "is not a file"
    os.mkfifo(tmp_path / "pipe.h5")
    assert refusal(tmp_path / "pipe.h5") == "is not a file"
    (tmp_path / "link.h5").symlink_to(tmp_path / "nowhere.h5")
    assert refusal(tmp_path / "link.h5") == "is a symbolic link to nothing"
    (tmp_path / "empty.h5").touch()
    assert refusal(tmp_path / "empty.h5") == "is empty"
    (tmp_path / "text.h5").write_text("time,velocity\n0,1\n")
    assert refusal(tmp_path / "text.h5") == "is not an HDF5 file"


def test_symbolic_link_to_an_artifact_is_read(write_trajectory, tmp_path: Path) -> None:
    (tmp_path / "link.h5").symlink_to(write_trajectory())
    assert probe(tmp_path / "link.h5", SCHEMA) is None


def test_file_that_may_not_be_read(
    write_trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = write_trajectory()
    monkeypatch.setattr(Path, "open", refuse)
    assert refusal(path) == "can't be read (Permission denied)"


def test_hdf5_of_another_program_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "fom.h5", "w") as file:
        file["time"] = np.zeros(3)
    assert refusal(tmp_path / "fom.h5") == "is not an artifact of sphrom"


def test_another_kind_is_refused(write_trajectory) -> None:
    assert refusal(write_trajectory(), "sphrom/basis") == (
        "holds 'sphrom/trajectory', not 'sphrom/basis'"
    )


@pytest.mark.parametrize("version", ["2.0", "0.9", "", "one"])
def test_another_major_version_is_refused(write_trajectory, version: str) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = np.bytes_(version)
    assert "has schema version" in refusal(path)


def test_newer_minor_version_only_adds(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = np.bytes_("1.7")
        file["vorticity"] = np.zeros((3, 5))
        file.attrs["colour"] = "of variable length, and so never read"
    assert probe(path, SCHEMA) is None


def test_another_case_is_refused_naming_the_keys(write_trajectory) -> None:
    path = write_trajectory()
    assert refusal(path, inputs_digest="other") == "was made with another case"
    reason = refusal(path, inputs_digest="other", case_text="name: demo\nfluid:\n  reynolds: 200\n")
    assert reason == "was made with another case (fluid.reynolds is 100 there, 200 here)"


def test_another_parent_is_refused(write_trajectory, tmp_path: Path) -> None:
    parent = Identity("packing.h5", "uuid-1", "content-1")
    path = write_trajectory(lineage={"packing": parent})
    assert probe(path, SCHEMA, lineage={"packing": parent}) is None
    again = Identity("packing.h5", "uuid-2", "content-1")
    assert probe(path, SCHEMA, lineage={"packing": again}) is None
    other = Identity("packing.h5", "uuid-1", "content-2")
    reason = refusal(path, lineage={"packing": other})
    assert reason == "was made from another input: packing.h5 (packing) has changed since"
    assert (
        refusal(path, lineage={"basis": parent}) == "was made without the input basis (packing.h5)"
    )


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.99])
def test_truncated_file_is_refused(write_trajectory, kept: float) -> None:
    path = write_trajectory()
    os.truncate(path, int(path.stat().st_size * kept))
    assert refusal(path) == "is truncated: HDF5 can't open it"


def test_flipped_bit_in_small_data_is_found_on_opening(write_trajectory) -> None:
    path = write_trajectory()
    flip(path, "velocity", 1)
    assert refusal(path) == "is damaged: velocity can't be read"


def test_flipped_bit_in_large_data_is_found_on_reading(write_trajectory) -> None:
    large = {
        "position": np.zeros((3, 50_000, 2)),
        "velocity": np.ones((3, 50_000, 2)),
        "density_fluctuation": np.zeros((3, 50_000)),
        "pressure": np.zeros((3, 50_000)),
    }
    path = write_trajectory(changed=large)
    flip(path, "velocity", 1, 500_000)
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        for read in READS:
            with pytest.raises(ArtifactError, match=r"velocity can't be read; .* --force`"):
                read(artifact, "velocity")
        np.testing.assert_array_equal(artifact.dataset("position")[0], 0.0)


def test_no_flipped_bit_and_no_cut_goes_unnoticed(write_trajectory, fields) -> None:
    """Wherever the damage is, the file is refused or gives what was written."""
    path = write_trajectory(lineage={"packing": Identity("packing.h5", "u", "c")})
    whole = path.read_bytes()
    damaged = path.with_name("damaged.h5")
    refused = 0
    for place in range(0, len(whole), 29):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << place % 8
        for content in (flipped, whole[:place]):
            damaged.write_bytes(content)
            try:
                with open_artifact(damaged, SCHEMA, made_by=MADE_BY) as artifact:
                    for name, array in fields.items():
                        np.testing.assert_array_equal(artifact.read(name), array)
                    artifact.verify_content()
            except ArtifactError:
                refused += 1
    # The view for ParaView is large here, and what is wrong in it is never read.
    assert refused > 1.3 * len(whole) / 29


def rewritten(path: Path, name: str, **dataset: object) -> Path:
    """Replace a dataset with one that another program wrote."""
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_dataset(name, **dataset)
    return path


def changed(path: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Change values in place, as another program would: HDF5's checksums then hold."""
    with h5py.File(path, "r+") as file:
        file[name][...] = change(file[name][...])
    return path


def at(index: object, value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Set some values."""

    def change(values: np.ndarray) -> np.ndarray:
        values[index] = value
        return values

    return change


@pytest.fixture
def write_large(write_trajectory) -> Callable[[], Path]:
    """Write a trajectory with data too large to be verified on opening."""
    n = 70_000
    generator = np.random.default_rng(1)
    fields = {
        "position": generator.random((3, n, 2)),
        "velocity": generator.random((3, n, 2)),
        "density_fluctuation": generator.random((3, n)),
        "pressure": generator.random((3, n)),
    }
    return lambda: write_trajectory(changed=fields)


CHANGES = {
    "zeroed chunk": at(1, 0.0),
    "two values": lambda values: np.concatenate((values[:1], values[:0:-1])),
    "reversed": lambda values: values[::-1],
    "one bit": lambda values: np.nextafter(values, 2.0),
}


@pytest.mark.parametrize("change", CHANGES)
def test_values_that_another_program_changed_are_refused_in_small_data(
    write_trajectory, change: str
) -> None:
    path = changed(write_trajectory(), "velocity", CHANGES[change])
    assert refusal(path) == "is damaged: velocity is not what was written"


@pytest.mark.parametrize("change", CHANGES)
def test_values_that_another_program_changed_are_refused_however_they_are_read(
    write_large, change: str
) -> None:
    path = changed(write_large(), "velocity", CHANGES[change])
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        for read in READS:
            with pytest.raises(ArtifactError, match="velocity is not what was written; make"):
                read(artifact, "velocity")


def test_zeroed_chunk_has_the_checksum_of_zeros(write_large) -> None:
    """What a disk that lost a block gives back: HDF5 takes it for valid."""
    path = write_large()
    with h5py.File(path) as file:
        chunk = file["velocity"].id.get_chunk_info(1)
    with path.open("r+b") as stream:
        stream.seek(chunk.byte_offset)
        stream.write(bytes(chunk.size))
    with h5py.File(path) as file:
        assert not file["velocity"][1].any()
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        for read in READS:
            with pytest.raises(ArtifactError, match="velocity is not what was written"):
                read(artifact, "velocity")


def test_file_that_changes_after_it_was_verified_is_verified_again(
    write_large, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_large()
    for settled in (-1.0, 1e9):  # whether what was verified is remembered, or its file too new
        monkeypatch.setattr("sphrom.artifacts.inspection.SETTLED", settled)
        with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
            artifact.verify_content()
        os.utime(path, (0, 0))
        changed(path, "velocity", at(2, 0.0))
        os.utime(path, (0, 0))
        with (
            open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact,
            pytest.raises(ArtifactError, match="velocity is not what was written"),
        ):
            artifact.dataset("velocity")[0]
        path.unlink()
        write_large()


def test_a_file_is_looked_through_once_until_it_changes(write_large, monkeypatch) -> None:
    looked, look = [], validity.inspect
    monkeypatch.setattr(validity, "inspect", lambda file: looked.append(file) or look(file))
    path = write_large()
    for settled, times in ((1e9, 3), (-1.0, 4)):  # a file that is too new, and one that is not
        monkeypatch.setattr("sphrom.artifacts.inspection.SETTLED", settled)
        for _ in range(3):
            with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
                assert artifact.datasets
        assert len(looked) == times
    with path.open("ab") as stream:
        stream.write(bytes(8))
    with open_artifact(path, SCHEMA, made_by=MADE_BY):
        assert len(looked) == 5


def test_nothing_is_verified_twice(write_large, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_large()
    with monkeypatch.context() as patch, open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        first = artifact.dataset("velocity")[1]
        patch.setattr("sphrom.artifacts.dataset_reader.verify", None)  # would raise
        np.testing.assert_array_equal(artifact.dataset("velocity")[1], first)
    monkeypatch.setattr("sphrom.artifacts.inspection.SETTLED", -1.0)
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        artifact.dataset("velocity")[1]
    monkeypatch.setattr("sphrom.artifacts.dataset_reader.verify", None)
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        np.testing.assert_array_equal(artifact.dataset("velocity")[1], first)
        np.testing.assert_array_equal(artifact.read("velocity")[1], first)
        with pytest.raises(TypeError):
            artifact.read("position")


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("time", lambda values: values[::-1], "time does not rise from one snapshot to the next"),
        ("time", at(1, 0.0), "time does not rise from one snapshot to the next"),
        ("step", at(2, 500), "step does not rise from one snapshot to the next"),
        ("time", at(1, np.nan), "time holds nan"),
        ("velocity", at((2, 3, 1), -np.inf), "velocity holds -inf"),
        ("velocity", at((2, 3, 1), 1e120), "velocity holds 1e+120"),
        ("step", at(0, -1), "step holds -1, below 0"),
        ("position", at((1, 2), 1e300), "position holds 1e+300, far outside of the domain"),
        ("position", at((1, 2), -40.0), "position holds -40, far outside of the domain"),
    ],
)
def test_values_that_can_not_be_are_refused_whatever_their_digest(
    write_trajectory, write_large, signed, name: str, change, reason: str
) -> None:
    path = signed(changed(write_trajectory(), name, change))
    assert refusal(path) == f"is damaged: {reason}"
    path.unlink()
    signed(changed(write_large(), name, change))
    for read in READS:
        with (
            pytest.raises(ArtifactError) as caught,
            open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact,
        ):
            read(artifact, name)
        assert f"is damaged: {reason}; make it again" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("sound_speed", 0.0, "sound_speed holds 0, which is not positive"),
        ("mass", -10.0, "mass holds -10, which is not positive"),
        ("kinematic_viscosity", -1e-3, "kinematic_viscosity holds -0.001, below 0"),
        ("box_length", (1.0, 0.0), "box_length holds 0, which is not positive"),
        ("parameters/reynolds", 1e300, "parameters/* holds 1e+300"),
        ("particle_spacing", np.nan, "particle_spacing holds nan"),
    ],
)
def test_attributes_that_can_not_be_are_refused_whatever_their_digest(
    write_trajectory, signed, arguments, name: str, value: object, reason: str
) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        group, _, key = name.rpartition("/")
        file[group or "/"].attrs[key] = value
    assert refusal(signed(path)) == f"is damaged: attribute {reason}"
    path.unlink()
    attributes = arguments["attributes"] | {name: value}
    with pytest.raises(ValueError, match=re.escape(reason)):
        write_trajectory(attributes=attributes)
    assert not path.exists()


def test_axes_that_can_not_be_are_refused_whatever_their_digest(write_trajectory, fields, signed):
    path = write_trajectory()
    for name in ("position", "velocity"):
        rewritten(path, name, data=np.zeros((3, 5, 3)), chunks=(1, 5, 3), fletcher32=True)
    with h5py.File(path, "r+") as file:
        for name in ("position", "velocity"):
            file[name].attrs["sha256"] = ""
    assert refusal(signed(path)) == "is damaged: it has 3 along component, not 2"


def test_what_one_artifact_has_another_may_have_to_have(write_trajectory) -> None:
    with open_artifact(write_trajectory(), SCHEMA, made_by=MADE_BY) as artifact:
        artifact.require(snapshot=3, particle=5, mode=7)
        with pytest.raises(ArtifactError, match=r"is damaged: .* has 3 along snapshot, not 4;"):
            artifact.require(snapshot=4)
        with (
            pytest.raises(ArtifactError, match="is damaged: no cells; make it again"),
            artifact.refused_where_it_does_not_fit(),
        ):
            raise ValueError("no cells")


def test_signing_is_what_the_writer_does(write_trajectory, signed) -> None:
    path = signed(changed(write_trajectory(), "velocity", CHANGES["reversed"]))
    assert probe(path, SCHEMA) is None


def test_dataset_that_another_program_wrote_is_refused(write_trajectory, fields) -> None:
    path = rewritten(write_trajectory(), "time", data=fields["time"])
    assert refusal(path) == "is damaged: time is not what was written"


@pytest.mark.parametrize(
    ("name", "value"), [("sound_speed", 11.0), ("status", np.bytes_("unstable")), ("spare", 1.0)]
)
def test_attributes_that_another_program_changed_are_refused(write_trajectory, name, value) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    assert refusal(path) == "is damaged: its digest is not that of what it holds"


def test_changed_case_is_refused(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file["case"][()] = b"name: other"
    assert refusal(path) == "is damaged: the case in it is not what was written"


@pytest.mark.parametrize(
    ("dataset", "reason"),
    [
        ({"data": np.zeros((3, 4))}, "along particle"),
        ({"data": np.zeros((3, 5), "float32")}, "of type float32"),
        ({"data": np.zeros(15)}, "1 axes"),
        ({"data": ["a", "b"]}, "which no artifact holds"),
        ({"data": np.zeros((3, 5), [("a", "f8")])}, "which no artifact holds"),
        ({"shape": (3, 5), "dtype": "f8", "chunks": (1, 5)}, "never written"),
        ({"shape": (3, 5), "dtype": "f8"}, "never written"),
        ({"shape": (10**6, 10**6), "dtype": "f8", "chunks": (1, 1000)}, "never written"),
        ({"data": h5py.Empty("f8")}, "which no artifact holds"),
    ],
)
def test_dataset_that_does_not_fit_is_refused(
    write_trajectory, dataset: dict[str, object], reason: str
) -> None:
    assert reason in refusal(rewritten(write_trajectory(), "pressure", **dataset))


@pytest.mark.parametrize("status", ["complete", "unstable"])
def test_only_an_unstable_run_may_have_no_snapshots(
    write_trajectory, fields, arguments, status: str
) -> None:
    path = write_trajectory(
        changed={name: array[:0] for name, array in fields.items()},
        attributes={**arguments["attributes"], "status": status},
    )
    if status == "unstable":
        assert probe(path, SCHEMA) is None
    else:
        assert refusal(path) == "is damaged: step has no snapshots"


def test_missing_dataset_and_attribute_are_named(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        del file.attrs["mass"]
    assert refusal(path) == "is damaged: attribute mass is missing"
    with h5py.File(path, "r+") as file:
        del file["pressure"]
    assert refusal(path) == "is damaged: dataset pressure is missing"


def test_what_leads_out_of_the_file_is_refused(write_trajectory, tmp_path: Path) -> None:
    other = tmp_path / "secret.h5"
    with h5py.File(other, "w") as file:
        file["pressure"] = np.zeros((3, 5))
    outside = h5py.VirtualLayout((3, 5), "f8")
    outside[...] = h5py.VirtualSource(other, "pressure", (3, 5))
    ways = {
        "link": lambda file: file.__setitem__("pressure", h5py.ExternalLink(other, "/pressure")),
        "soft": lambda file: file.__setitem__("pressure", h5py.SoftLink("/density_fluctuation")),
        "view": lambda file: file.create_virtual_dataset("pressure", outside),
        "raw": lambda file: file.create_dataset(
            "pressure", (3, 5), "f8", external=[(str(other), 0, 120)]
        ),
    }
    for name, replace in ways.items():
        path = write_trajectory(tmp_path / f"{name}.h5")
        with h5py.File(path, "r+") as file:
            del file["pressure"]
            replace(file)
        assert refusal(path).startswith("is refused: ")


def test_view_within_the_file_is_let_through(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        layout = h5py.VirtualLayout((15,), "f8")
        for snapshot in range(3):
            source = h5py.VirtualSource(".", "pressure", (3, 5))[snapshot]
            layout[5 * snapshot : 5 * snapshot + 5] = source
        del file["VTKHDF/PointData/pressure"]
        file.create_virtual_dataset("VTKHDF/PointData/pressure", layout)
    assert probe(path, SCHEMA) is None


@pytest.mark.parametrize("name", ["parameters", "velocity", "/"])
def test_what_has_two_names_is_refused(write_trajectory, name: str) -> None:
    """Artifacts never hold it, and a reader that follows both may never end."""
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file["parameters/again"] = file[name]
    assert "is another name of " in refusal(path)


def test_names_that_fan_out_are_not_followed(write_trajectory) -> None:
    """Two names for each group, level after level: a million ways to the last."""
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        group = file.create_group("fan")
        for _ in range(19):
            below = group.create_group("a")
            group["b"] = below
            group = below
    assert "is another name of " in refusal(path)


@pytest.fixture
def tight(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine so small that not even a few numbers always fit."""
    monkeypatch.setattr("sphrom.artifacts.dataset_reader.ALWAYS_FITS", 0)


def test_little_is_read_without_a_question(write_trajectory, monkeypatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr("sphrom.artifacts.dataset_reader.available_ram", lambda: asked.append(1))
    many = {"position": np.zeros((3, 2000, 2)), "velocity": np.zeros((3, 2000, 2))}
    many |= {name: np.zeros((3, 2000)) for name in ("density_fluctuation", "pressure")}
    with open_artifact(write_trajectory(changed=many), SCHEMA, made_by=MADE_BY) as artifact:
        asked.clear()
        artifact.read("time")
        artifact.dataset("velocity")[0]
        assert asked == []
        artifact.read("velocity")
        assert asked


@pytest.mark.usefixtures("tight")
def test_data_larger_than_the_memory_are_refused(
    write_trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_trajectory()
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        monkeypatch.setattr("sphrom.artifacts.dataset_reader.available_ram", lambda: 200)
        assert artifact.dataset("velocity")[0].shape == (5, 2)
        with pytest.raises(ResourceError, match=r"velocity of .* needs"):
            artifact.read("velocity")


@pytest.mark.usefixtures("tight")
@pytest.mark.parametrize(
    ("selection", "n_values"),
    [
        (np.s_[:, 1:3], 3 * 2 * 2),
        (np.s_[:, 1:3, 0], 3 * 2),
        (np.s_[..., 0], 3 * 5),
        (np.s_[1, ...], 5 * 2),
        (np.s_[1:, ::2], 2 * 3 * 2),
        (np.s_[-1], 5 * 2),
        ((), 3 * 5 * 2),
        (np.s_[:], 3 * 5 * 2),
    ],
)
def test_only_what_is_selected_has_to_fit(
    write_trajectory, monkeypatch: pytest.MonkeyPatch, selection, n_values: int
) -> None:
    with open_artifact(write_trajectory(), SCHEMA, made_by=MADE_BY) as artifact:
        velocity = artifact.dataset("velocity")
        for spare in (0, -1):
            available = 8 * n_values + spare
            monkeypatch.setattr(
                "sphrom.artifacts.dataset_reader.available_ram", lambda a=available: a
            )
            if spare == 0:
                assert velocity[selection].size == n_values
            else:
                with pytest.raises(ResourceError, match="velocity of"):
                    velocity[selection]


def test_absent_names_are_programming_errors(write_trajectory) -> None:
    with open_artifact(write_trajectory(), SCHEMA, made_by=MADE_BY) as artifact:
        with pytest.raises(KeyError, match="vorticity"):
            artifact.read("vorticity")
        with pytest.raises(KeyError):
            artifact.number("vorticity")
        with pytest.raises(TypeError):
            artifact.number("status")
        with pytest.raises(TypeError):
            artifact.text("mass")


@pytest.mark.parametrize(
    ("dataset", "reason"),
    [
        ({"data": np.zeros((3, 5)), "compression": "gzip"}, "changed by a filter"),
        ({"data": np.zeros((3, 5)), "shuffle": True}, "changed by a filter"),
        (
            {"shape": (3, 10**9), "dtype": "f8", "chunks": (1, 10**8), "compression": "gzip"},
            "changed by a filter",
        ),
    ],
)
def test_data_behind_a_filter_are_refused(write_trajectory, dataset, reason) -> None:
    """HDF5 would run plugins for filters, and let little data claim to be much."""
    assert reason in refusal(rewritten(write_trajectory(), "pressure", **dataset))


def test_data_that_are_put_together_from_others_are_refused(write_trajectory) -> None:
    """A view may claim any size."""
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        layout = h5py.VirtualLayout((3, 5), "f8")
        layout[...] = h5py.VirtualSource(".", "density_fluctuation", (3, 5))
        del file["pressure"]
        file.create_virtual_dataset("pressure", layout)
    assert refusal(path) == "is refused: pressure is put together from other data"


def test_data_that_claim_to_be_larger_than_the_file_are_refused(
    write_trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where pieces of a damaged file lie upon each other."""
    path = write_trajectory()
    assert probe(path, SCHEMA) is None
    monkeypatch.setattr("sphrom.artifacts.inspection.file_size", lambda file: 700)
    assert refusal(path).startswith("is damaged: it claims to hold ")


def test_groups_within_groups_without_end_are_refused(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.create_group("/".join(["a"] * 2000))
    assert "holds more than any artifact" in refusal(path)


def test_attributes_and_cases_without_end_are_refused(write_trajectory) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs["remark"] = np.zeros(2**20)
    assert "attribute remark of / is larger than any is" in refusal(path)
    path = write_trajectory(path.with_name("other.h5"))
    with h5py.File(path, "r+") as file:
        del file["case"]
        file["case"] = np.zeros(2**20, "S8")
    assert "is refused: the case in it is larger than any is" in refusal(path)


def test_a_lock_of_another_program_keeps_no_reader_out(write_trajectory) -> None:
    """An artifact never changes; some file systems have locks that never end, or none."""
    path = write_trajectory()
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
            assert len(artifact.read("time")) == 3


@pytest.mark.parametrize("locking", [None, True, False, "best-effort"])
def test_other_readers_in_this_process_open_it_too(write_trajectory, locking) -> None:
    """HDF5 refuses a file that the process has open with other flags for its lock."""
    path = write_trajectory()
    with h5py.File(path, locking=locking), open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        assert len(artifact.read("time")) == 3
    with open_artifact(path, SCHEMA, made_by=MADE_BY), h5py.File(path) as file:
        assert len(file["time"]) == 3
