"""Whatever the bytes of an artifact: it is refused in one line, or gives what was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sphrom.artifacts import open_artifact, probe
from sphrom.errors import ArtifactError

SCHEMA = "sphrom/trajectory"
ANY_BYTES = settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
places = st.floats(0.0, 1.0)
edits = st.tuples(st.sampled_from(["flip", "fill", "cut", "insert", "copy"]), places, places,
                  st.binary(min_size=1, max_size=64))  # fmt: skip


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


def read_all(path: Path, fields: dict[str, np.ndarray]) -> None:
    """Read everything; raise AssertionError where it isn't what was written."""
    with open_artifact(path, SCHEMA, made_by="sphrom fom CASE") as artifact:
        for name, array in fields.items():
            np.testing.assert_array_equal(artifact.read(name), array)
        artifact.verify_content()


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
