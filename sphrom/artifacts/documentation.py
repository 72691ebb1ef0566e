"""The schemas as Markdown, from the table that drives writing and checking."""

from __future__ import annotations

from collections.abc import Iterable

from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.schema import (
    PROVENANCE,
    SCHEMA_VERSION,
    TIMING,
    AttributeField,
    DatasetField,
    Schema,
)


def schemas_as_markdown() -> str:
    """Return the documentation of every schema."""
    parts = [
        f"# Artifacts, schema version {SCHEMA_VERSION}",
        "In a name, `*` stands for one group that the case names. Every artifact also holds the "
        "case as text in `/case`, and in `/lineage/<role>` the file name, `uuid` and "
        "`content_sha256` of each input.",
        "What holds fields shows them to ParaView 5.12 and later in `/VTKHDF`, a view of the same "
        "bytes: particles or reference points, stepping through snapshots, or through modes. No "
        "reader of artifacts looks at it.",
        "## Every artifact",
        _table(("attribute", "kind", "units", ""), map(_attribute_row, (*PROVENANCE, TIMING))),
        *(_schema_as_markdown(schema) for schema in SCHEMAS.values()),
    ]
    return "\n\n".join(parts) + "\n"


def _schema_as_markdown(schema: Schema) -> str:
    header = ("dataset", "axes", "type", "units", "symbol", "equation", "")
    parts = [f"## {schema.name}", f"{schema.meaning}."]
    parts.append(_table(header, map(_dataset_row, schema.datasets)))
    if schema.attributes:
        rows = map(_attribute_row, schema.attributes)
        parts.append(_table(("attribute", "kind", "units", ""), rows))
    return "\n\n".join(parts)


def _dataset_row(field: DatasetField) -> tuple[str, ...]:
    axes = f"({', '.join(field.axes)})"
    meaning = _meaning(field)
    return (
        f"`{field.name}`",
        axes,
        field.dtype,
        field.units,
        field.symbol,
        field.equation,
        meaning,
    )


def _attribute_row(field: AttributeField) -> tuple[str, ...]:
    kind = " or ".join(field.allowed) if field.allowed else field.kind
    return (f"`{field.name}`", kind, field.units, _meaning(field))


def _meaning(field: DatasetField | AttributeField) -> str:
    return field.meaning if field.required else f"{field.meaning} (optional)"


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(schemas_as_markdown(), end="")
