"""The kinds of artifacts, each declared once: see `sphrom.declaration`."""

from sphrom.artifacts.records import (  # noqa: F401
    comparison,
    fit,
    reduced_models,
    runs,
    sweep,
)
from sphrom.declaration import DECLARED, Schema

SCHEMAS = {kind: Schema.of(kind, record) for kind, record in DECLARED.items()}
