"""A damaged artifact is refused in one line, or gives what was written."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sphrom.artifacts import Identity, open_artifact, probe
from sphrom.errors import ArtifactError

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


def refused_however_read(path: Path, name: str, reason: str) -> None:
    """Every way to read a dataset refuses it."""
    for read in READS:
        with (
            pytest.raises(ArtifactError, match=rf"is damaged: {name} {reason}; .* --force`"),
            open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact,
        ):
            read(artifact, name)


def test_a_flipped_bit_in_large_data_is_found_on_reading(write_large) -> None:
    path = write_large()
    with h5py.File(path) as file:
        place = file["velocity"].id.get_chunk_info(1).byte_offset + 500_000
    content = bytearray(path.read_bytes())
    content[place] ^= 0x10
    path.write_bytes(content)
    refused_however_read(path, "velocity", "can't be read")


def test_no_flipped_bit_and_no_cut_goes_unnoticed(write_trajectory, fields) -> None:
    """Wherever the damage is, the file is refused in one line or gives what was written."""
    path = write_trajectory(lineage={"packing": Identity("packing.h5", "u", "c")})
    whole = path.read_bytes()
    damaged = path.with_name("damaged.h5")
    refused = 0
    for place in range(0, len(whole), 97):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << place % 8
        for content in (flipped, whole[:place]):
            damaged.write_bytes(content)
            try:
                with open_artifact(damaged, SCHEMA, made_by=MADE_BY) as artifact:
                    for name, array in fields.items():
                        np.testing.assert_array_equal(artifact.read(name), array)
            except ArtifactError as error:
                refused += str(error).startswith(f"{damaged} ") and "\n" not in str(error)
    # The view for ParaView is large here, and what is wrong in it is never read.
    assert refused > 1.3 * len(whole) / 97


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300), signed=st.booleans())
def test_any_bytes_at_all(tmp_path: Path, content: bytes, signed: bool) -> None:
    path = tmp_path / "any.h5"
    path.write_bytes((b"\x89HDF\r\n\x1a\n" if signed else b"") + content)
    assert probe(path, SCHEMA) is not None


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values * np.array([1.0, 0.0, 1.0])[:, None, None],  # a zeroed chunk
        lambda values: np.nextafter(values, 2.0),
    ],
)
def test_values_that_another_program_changed_are_refused_however_they_are_read(
    write_trajectory, write_large, refusal, change
) -> None:
    """HDF5's checksums then hold."""
    for write in (write_trajectory, write_large):
        path = write()
        with h5py.File(path, "r+") as file:
            file["velocity"][...] = change(file["velocity"][...])
        if write is write_trajectory:
            assert refusal(path) == "is damaged: velocity has changed since it was written"
        refused_however_read(path, "velocity", "has changed since it was written")
        path.unlink()


def named_in_latin_1(group: h5py.Group) -> None:
    h5py.h5g.create(group.id, "höhe".encode("latin-1"))


def attribute_in_latin_1(item: h5py.HLObject) -> None:
    scalar = h5py.h5s.create(h5py.h5s.SCALAR)
    h5py.h5a.create(item.id, "höhe".encode("latin-1"), h5py.h5t.NATIVE_DOUBLE, scalar)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda file: file.attrs.__setitem__("sound_speed", 11.0), "its digest does not match"),
        (lambda file: file.attrs.__delitem__("uuid"), "attribute uuid is missing"),
        (lambda file: file.__delitem__("pressure"), "its digest does not match"),
        (lambda file: file["case"].__setitem__((), b"name: other"), "the stored case has changed"),
        (lambda file: attribute_in_latin_1(file), "its digest does not match"),
        # Two names for one thing.
        (lambda file: file.__setitem__("parameters/again", file["/"]), "its digest"),
    ],
)
def test_what_another_program_changed_is_refused(write_trajectory, refusal, change, reason) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        change(file)
    assert refusal(path).startswith(f"is damaged: {reason}")


def elsewhere() -> h5py.VirtualLayout:
    layout = h5py.VirtualLayout((3, 5), "f8")
    layout[...] = h5py.VirtualSource("o.h5", "p", (3, 5))
    return layout


def dataset(**given: object):
    return lambda file: file.create_dataset("pressure", **given)


@pytest.mark.parametrize(
    ("replace", "reason"),
    [
        (dataset(data=["a", "b"]), "not plain numbers"),
        (
            dataset(shape=(10**6, 10**6), dtype="f8", chunks=(1, 1000)),
            "has changed since it was written",
        ),
        (dataset(data=np.zeros((3, 5)), compression="gzip"), "changed by a filter"),
        (dataset(shape=(3, 5), dtype="f8", external=[("o.h5", 0, 120)]), "in another file"),
        (lambda file: file.create_virtual_dataset("pressure", elsewhere()), "in another file"),
        (lambda file: file.__setitem__("pressure", h5py.ExternalLink("o.h5", "/p")), "is a link"),
    ],
)
def test_data_of_another_program_are_refused(
    write_trajectory, refusal, monkeypatch, replace, reason: str
) -> None:
    """Nothing is followed out of the file, and no plugin is run for a filter."""
    path = write_trajectory()
    monkeypatch.chdir(path.parent)
    with h5py.File("o.h5", "w") as file:
        file["p"] = np.zeros((3, 5))
    with h5py.File(path, "r+") as file:
        del file["pressure"]
        replace(file)
    assert reason in refusal(path)


def test_file_that_is_open_for_writing_is_not_called_damaged(write_trajectory) -> None:
    """HDF5 marks a file while a program has it open; a killed program leaves the mark."""
    path = write_trajectory()
    with h5py.File(path, "r+", libver="latest") as file:
        file.flush()
        marked = path.read_bytes()
    assert probe(path, "sphrom/trajectory") is None
    path.write_bytes(marked)
    says = f"{path} is marked as open for writing: .*killed; .* `h5clear -s {path}` removes"
    with pytest.raises(ArtifactError, match=says):
        probe(path, "sphrom/trajectory")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (named_in_latin_1, "the name /h\\xf6he is not UTF-8"),
        (lambda file: named_in_latin_1(file["parameters"]), "the name /parameters/h\\xf6he is"),
        (lambda file: file.create_group("/".join(3000 * "g")), "more than 32 deep"),
        (lambda file: file.__setitem__("soft", h5py.SoftLink("/time")), "/soft is a link"),
        (lambda file: file.__setitem__("soft", h5py.SoftLink("/nowhere")), "/soft is a link"),
        (lambda file: file.__setitem__("empty", h5py.Empty("f8")), "empty is empty, or of"),
        (lambda file: file.__setitem__("opaque", np.zeros(2, "V8")), "of type |V8"),
        (lambda file: file.__setitem__("pair", np.zeros(2, "f8,i4")), "not plain numbers"),
    ],
)
def test_structure_that_no_artifact_has_is_refused(
    write_trajectory, refusal, change, reason: str
) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        change(file)
    refused = refusal(path)
    assert refused.startswith("is refused: ")
    assert reason in refused


def test_additions_that_are_never_read_do_no_harm(write_trajectory) -> None:
    """An attribute's name in another encoding, a type with a name, a group within itself."""
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        attribute_in_latin_1(file["time"])
        file["type"] = np.dtype("f8")
        deepest = file.create_group("/".join(31 * "g"))
        deepest["again"] = file["g"]
    assert probe(path, "sphrom/trajectory") is None
