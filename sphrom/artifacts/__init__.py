"""HDF5 artifacts: the files that stages write, whole or not at all, and read, checked.

This package doesn't interpret a case: it stores its text and compares digests.
"""

from sphrom.artifacts.layout import Identity, Origin
from sphrom.artifacts.reader import (
    Artifact,
    open_artifact,
    probe,
    read_record,
)
from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.writer import ArtifactWriter, Stream, create_artifact, write_record
from sphrom.whole_files import locked

__all__ = [
    "SCHEMAS",
    "Artifact",
    "ArtifactWriter",
    "Identity",
    "Origin",
    "Stream",
    "create_artifact",
    "locked",
    "open_artifact",
    "probe",
    "read_record",
    "write_record",
]
