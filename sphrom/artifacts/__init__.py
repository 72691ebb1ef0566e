"""HDF5 artifacts: the files that stages write completely or not at all, and check on reading.

This package does not interpret a case: it stores its text and compares digests.
"""

from sphrom.artifacts.layout import Identity as Identity
from sphrom.artifacts.layout import Origin as Origin
from sphrom.artifacts.reader import Artifact as Artifact
from sphrom.artifacts.reader import open_artifact as open_artifact
from sphrom.artifacts.reader import probe as probe
from sphrom.artifacts.reader import read_record as read_record
from sphrom.artifacts.records import SCHEMAS as SCHEMAS
from sphrom.artifacts.writer import ArtifactWriter as ArtifactWriter
from sphrom.artifacts.writer import Stream as Stream
from sphrom.artifacts.writer import create_artifact as create_artifact
from sphrom.artifacts.writer import write_record as write_record
from sphrom.whole_files import locked as locked
