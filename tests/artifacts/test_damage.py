"""Whatever the bytes of an artifact: it is refused in one line, or gives what was written."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
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
ANY_BYTES = settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
places = st.floats(0.0, 1.0)
edits = st.tuples(st.sampled_from(["flip", "fill", "cut", "insert", "copy"]), places, places,
                  st.binary(min_size=1, max_size=64))  # fmt: skip


def read_all(path: Path, fields: dict[str, np.ndarray]) -> None:
    """Read everything; raise AssertionError where it isn't what was written."""
    with open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact:
        for name, array in fields.items():
            np.testing.assert_array_equal(artifact.read(name), array)
        artifact.verify_content()


def refused_however_read(path: Path, name: str, reason: str) -> None:
    """Every way to read a dataset refuses it."""
    for read in READS:
        with (
            pytest.raises(ArtifactError, match=rf"is damaged: {re.escape(reason)}; .* --force`"),
            open_artifact(path, SCHEMA, made_by=MADE_BY) as artifact,
        ):
            read(artifact, name)


@pytest.mark.parametrize("kept", [0.1, 0.99])
def test_truncated_file_is_refused(write_trajectory, refusal, kept: float) -> None:
    path = write_trajectory()
    os.truncate(path, int(path.stat().st_size * kept))
    assert refusal(path) == "is truncated: HDF5 can't open it"


def test_flipped_bit_is_found_on_opening_or_reading(write_trajectory, write_large, refusal) -> None:
    """In small data on opening, in large ones on reading."""
    for write, byte in ((write_trajectory, 3), (write_large, 500_000)):
        path = write()
        with h5py.File(path) as file:
            place = file["velocity"].id.get_chunk_info(1).byte_offset + byte
        content = bytearray(path.read_bytes())
        content[place] ^= 0x10
        path.write_bytes(content)
        if write is write_trajectory:
            assert refusal(path) == "is damaged: velocity can't be read"
        refused_however_read(path, "velocity", "velocity can't be read")
        path.unlink()


def test_no_flipped_bit_and_no_cut_goes_unnoticed(write_trajectory, fields) -> None:
    """Wherever the damage is, the file is refused or gives what was written."""
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
                read_all(damaged, fields)
            except ArtifactError:
                refused += 1
    # The view for ParaView is large here, and what is wrong in it is never read.
    assert refused > 1.3 * len(whole) / 97


def edited(content: bytes, edit: tuple[str, float, float, bytes]) -> bytes:
    kind, first, second, data = edit
    at, source = int(first * len(content)), int(second * len(content))
    if kind == "flip":
        at = min(at, len(content) - 1)
        return content[:at] + bytes([content[at] ^ (1 << data[0] % 8)]) + content[at + 1 :]
    if kind == "cut":
        return content[:at]
    if kind == "insert":
        return content[:at] + data + content[at:]
    middle = data if kind == "fill" else content[source : source + len(data)]
    return content[:at] + middle + content[at + len(middle) :]


@pytest.fixture
def whole(write_trajectory) -> bytes:
    return write_trajectory().read_bytes()


@ANY_BYTES
@given(changes=st.lists(edits, min_size=1, max_size=4))
def test_changed_bytes(whole, fields, tmp_path: Path, changes) -> None:
    content = whole
    for change in changes:
        content = edited(content, change) or b"\0"
    path = tmp_path / "mutant.h5"
    path.write_bytes(content)
    told = f"{path} "
    try:
        read_all(path, fields)
    except ArtifactError as error:
        told = str(error)
    assert told.startswith(f"{path} ")
    assert len(told.splitlines()) == 1
    assert path.read_bytes() == content


@ANY_BYTES
@given(content=st.binary(max_size=300), signed=st.booleans())
def test_any_bytes_at_all(tmp_path: Path, content: bytes, signed: bool) -> None:
    path = tmp_path / "any.h5"
    path.write_bytes((b"\x89HDF\r\n\x1a\n" if signed else b"") + content)
    assert probe(path, SCHEMA) is not None


Change = Callable[[np.ndarray], np.ndarray]


def changed(path: Path, name: str, change: Change) -> Path:
    """Change values in place, as another program would: HDF5's checksums then hold."""
    with h5py.File(path, "r+") as file:
        file[name][...] = change(file[name][...])
    return path


def at(index: object, value: float) -> Change:
    """Set some values."""

    def change(values: np.ndarray) -> np.ndarray:
        values[index] = value
        return values

    return change


CHANGES = {
    "zeroed chunk": at(1, 0.0),
    "two values": lambda values: np.concatenate((values[:1], values[:0:-1])),
    "reversed": lambda values: values[::-1],
    "one bit": lambda values: np.nextafter(values, 2.0),
}


@pytest.mark.parametrize("change", CHANGES)
def test_values_that_another_program_changed_are_refused_however_they_are_read(
    write_trajectory, write_large, refusal, change: str
) -> None:
    path = changed(write_trajectory(), "velocity", CHANGES[change])
    assert refusal(path) == "is damaged: velocity is not what was written"
    path.unlink()
    path = changed(write_large(), "velocity", CHANGES[change])
    refused_however_read(path, "velocity", "velocity is not what was written")


def rewritten(path: Path, name: str, **dataset: object) -> Path:
    """Replace a dataset with one that another program wrote."""
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_dataset(name, **dataset)
    return path


@pytest.mark.parametrize(
    ("name", "value"), [("sound_speed", 11.0), ("status", np.bytes_("unstable")), ("spare", 1.0)]
)
def test_attributes_that_another_program_changed_are_refused(
    write_trajectory, refusal, name, value
) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    assert refusal(path) == "is damaged: its digest is not that of what it holds"


def test_changed_case_is_refused(write_trajectory, refusal) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file["case"][()] = b"name: other"
    assert refusal(path) == "is damaged: the case in it is not what was written"


def view(source: str) -> h5py.VirtualLayout:
    layout = h5py.VirtualLayout((3, 5), "f8")
    layout[...] = h5py.VirtualSource(source, "density_fluctuation", (3, 5))
    return layout


@pytest.mark.parametrize(
    ("dataset", "reason"),
    [
        ({"data": np.zeros((3, 5))}, "is damaged: pressure is not what was written"),
        ({"data": np.zeros((3, 4), "float32")}, "pressure is not what was written"),
        ({"data": ["a", "b"]}, "which no artifact holds"),
        ({"shape": (3, 5), "dtype": "f8", "chunks": (1, 5)}, "pressure is not what was written"),
        ({"shape": (10**6, 10**6), "dtype": "f8", "chunks": (1, 1000)}, "it claims to hold"),
        ({"shape": (3, 5), "dtype": "f8", "chunks": (3, 10**6), "maxshape": (3, None)},
         "it claims to hold"),
    ],
)  # fmt: skip
def test_dataset_that_does_not_fit_is_refused(write_trajectory, refusal, dataset, reason) -> None:
    assert reason in refusal(rewritten(write_trajectory(), "pressure", **dataset))


@pytest.mark.parametrize(
    "dataset",
    [
        {"data": np.zeros((3, 5)), "compression": "gzip"},
        {"data": np.zeros((3, 5)), "shuffle": True},
        {"shape": (3, 10**9), "dtype": "f8", "chunks": (1, 10**8), "compression": "gzip"},
    ],
)
def test_data_behind_a_filter_are_refused(write_trajectory, refusal, dataset) -> None:
    """HDF5 would run plugins for filters, and let little data claim to be much."""
    path = rewritten(write_trajectory(), "pressure", **dataset)
    assert "changed by a filter" in refusal(path)


@pytest.mark.parametrize(
    ("replace", "reason"),
    [
        (lambda file: file.__setitem__("pressure", h5py.ExternalLink("o.h5", "/p")), "is a link"),
        (lambda file: file.__setitem__("pressure", h5py.SoftLink("/velocity")), "is a link"),
        (lambda file: file.create_virtual_dataset("pressure", view("o.h5")), "in another file"),
        (lambda file: file.create_virtual_dataset("pressure", view(".")), "not what was written"),
        (lambda file: file.create_dataset("pressure", (3, 5), "f8", external=[("o.h5", 0, 120)]),
         "in another file"),
    ],
)  # fmt: skip
def test_what_leads_out_of_the_file_is_refused(
    write_trajectory, refusal, monkeypatch, replace, reason: str
) -> None:
    path = write_trajectory()
    monkeypatch.chdir(path.parent)
    with h5py.File("o.h5", "w") as file:
        file["p"] = file["density_fluctuation"] = np.zeros((3, 5))
    with h5py.File(path, "r+") as file:
        del file["pressure"]
        replace(file)
    assert reason in refusal(path)


@pytest.mark.parametrize("name", ["parameters", "velocity", "/"])
def test_what_has_two_names_is_refused(write_trajectory, refusal, name: str) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file["parameters/again"] = file[name]
    assert refusal(path) == "is damaged: its digest is not that of what it holds"


def test_groups_within_groups_without_end_are_refused(write_trajectory, refusal) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.create_group("/".join(["a"] * 2000))
    assert "groups within groups without end" in refusal(path)


def test_data_that_claim_to_be_larger_than_the_file_are_refused(
    write_trajectory, refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where pieces of a damaged file lie upon each other."""
    path = write_trajectory()
    assert probe(path, SCHEMA) is None
    monkeypatch.setattr("sphrom.artifacts.inspection.file_size", lambda file: 700)
    assert refusal(path).startswith("is damaged: it claims to hold ")


def test_attributes_without_end_are_refused(write_trajectory, refusal) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        file.attrs["remark"] = np.zeros(2**20)
    assert "attribute remark of / is larger than any is" in refusal(path)


def test_missing_dataset_and_attribute_are_found(write_trajectory, refusal) -> None:
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        del file["pressure"]
    assert refusal(path) == "is damaged: its digest is not that of what it holds"
    with h5py.File(path, "r+") as file:
        del file.attrs["uuid"]
    assert refusal(path) == "is damaged: attribute uuid is missing, or no text"


def test_names_that_fan_out_are_not_followed(write_trajectory) -> None:
    """Two names for each group, level after level: a million ways to the last."""
    path = write_trajectory()
    with h5py.File(path, "r+") as file:
        group = file.create_group("fan")
        for _ in range(19):
            below = group.create_group("a")
            group["b"] = below
            group = below
    assert probe(path, SCHEMA) is None
