"""Whether a file is an artifact of the kind, version, case and inputs that are asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py

from sphrom.artifacts.differences import case_differences
from sphrom.artifacts.identity import Identity, content_digest, dataset_line, text_digest
from sphrom.artifacts.inspection import (
    CASE,
    Contents,
    Fault,
    FileKey,
    Missing,
    attribute_at,
    attributes_at,
    damage,
    file_key,
    inspect,
    is_settled,
)
from sphrom.artifacts.layout import attributes_problem, find_field, layout_problem
from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.schema import SCHEMA_VERSION, Schema
from sphrom.artifacts.text import plain_text

DIGEST = "sha256"
"""The attribute with the digest of a dataset's values."""
MOST_CHECKED = 256
"""Files whose contents are remembered: those that were opened last."""
_checked: dict[tuple[FileKey, str], Contents] = {}
"""What files of a schema hold, the one opened last at the end."""
LOCKINGS = (None, False, True)
"""How a file is locked. HDF5 refuses another way than that in which this process has it open, and
so the default comes first. An artifact never changes: it needs no lock where none can be had."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def open_file(path: Path) -> h5py.File:
    """Open a regular HDF5 file for reading. Raises Fault."""
    try:
        # Asked before opening: opening a pipe would wait for ever.
        if not path.is_file():
            raise Missing(_absence(path))
        with path.open("rb") as stream:
            start = stream.read(len(_SIGNATURE))
    except OSError as error:
        raise Fault(f"can't be read ({error.strerror})") from error
    if not start:
        raise Fault("is empty")
    if start != _SIGNATURE:
        raise Fault("is not an HDF5 file")
    for locking in LOCKINGS:
        try:
            return h5py.File(path, "r", locking=locking)
        except (OSError, RuntimeError, ValueError) as error:
            fault = error
    kind = "truncated" if "truncated" in str(fault) else "damaged"
    raise Fault(f"is {kind}: HDF5 can't open it") from fault


def _absence(path: Path) -> str:
    if path.is_symlink() and not path.exists():
        return "is a symbolic link to nothing"
    return "is not a file" if path.exists() else "is missing"


def check_contents(file: h5py.File, schema: str) -> Contents:
    """Return what the file holds, once it fits the schema. Raises Fault.

    A process looks through a file once, and again when it has changed since.
    """
    key = file_key(file)
    contents = _checked.pop((key, schema), None) or _contents(file, schema)
    if is_settled(key):
        _checked[key, schema] = contents
        if len(_checked) > MOST_CHECKED:
            del _checked[next(iter(_checked))]
    return contents


def _contents(file: h5py.File, schema: str) -> Contents:
    """Look through a file, and compare what it holds with a schema. Raises Fault."""
    root = attributes_at(file, "")
    kind, version = root.get("schema"), root.get("schema_version")
    if not isinstance(kind, str) or not isinstance(version, str):
        raise Fault("is not an artifact of sphrom")
    if kind != schema:
        raise Fault(f"holds {kind!r}, not {schema!r}")
    if version.partition(".")[0] != SCHEMA_VERSION.partition(".")[0]:
        raise Fault(f"has schema version {version!r}; this program reads {SCHEMA_VERSION}")
    contents = inspect(file)
    table = SCHEMAS[schema]
    datasets = contents.datasets
    problem = layout_problem(table, datasets) or attributes_problem(
        table, contents.attributes, datasets
    )
    if problem:
        raise Fault(f"is damaged: {problem}")
    _require_snapshots(contents, table)
    for name in contents.views:
        if find_field(table.datasets, name) is not None or name == CASE:
            raise Fault(f"is refused: {name} is put together from other data")
    contents.case_text = _case_text(file)
    contents.digests = _digests(file, contents)
    _check_digests(contents, table)
    return contents


def _require_snapshots(contents: Contents, table: Schema) -> None:
    """Raise Fault when a series has no snapshots, unless its run was unstable from the start."""
    if contents.attributes.get("status") == "unstable":
        return
    for name, (shape, _) in contents.datasets.items():
        field = find_field(table.datasets, name)
        if field is not None and field.rises and shape[0] == 0:
            raise Fault(f"is damaged: {name} has no snapshots")


def _digests(file: h5py.File, contents: Contents) -> dict[str, str]:
    """Return what the writer stored of each dataset's values."""
    found = {}
    for name in contents.datasets:
        digest = attribute_at(file[name], name, DIGEST)
        if name != CASE and isinstance(digest, str):
            found[name] = digest
    return found


def _check_digests(contents: Contents, table: Schema) -> None:
    """Raise Fault unless the artifact's own digest is that of its attributes and datasets."""
    for name in contents.datasets:
        if name not in contents.digests and find_field(table.datasets, name) is not None:
            raise Fault(f"is damaged: {name} is not what was written")
    lines = {
        name: dataset_line(contents.datasets[name][1], contents.datasets[name][0], digest)
        for name, digest in contents.digests.items()
    }
    values = contents.attributes
    own = {name: at for name, at in values.items() if not name.startswith("lineage/")}
    if content_digest(table.name, own, lines) != values["content_sha256"]:
        raise Fault("is damaged: its digest is not that of what it holds")


def _case_text(file: h5py.File) -> str:
    """Return the case in the file. Raises Fault when it is not what was written."""
    with damage("the case"):
        text = plain_text(file[CASE][()])
    if attribute_at(file[CASE], CASE, DIGEST) != text_digest(text):
        raise Fault("is damaged: the case in it is not what was written")
    return text


def check_origin(
    contents: Contents,
    inputs_digest: str | None,
    case_text: str | None,
    lineage: Mapping[str, Identity],
) -> None:
    """Raise Fault when the artifact was made with another case or from other inputs."""
    if inputs_digest is not None and contents.attributes["inputs_sha256"] != inputs_digest:
        keys = case_differences(contents.case_text, case_text) if case_text else ""
        raise Fault("was made with another case" + (f" ({keys})" if keys else ""))
    for role, identity in lineage.items():
        stored = contents.attributes.get(f"lineage/{role}/content_sha256")
        if stored is None:
            raise Fault(f"was made without the input {role} ({identity.path})")
        # The content decides: an input that was made again, bit for bit the same, is the same.
        if stored != identity.content_sha256:
            raise Fault(f"was made from another input: {identity.path} ({role}) has changed since")
