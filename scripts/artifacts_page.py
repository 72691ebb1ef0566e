"""The schemas as Markdown, from the table that drives writing and checking."""

from __future__ import annotations

from collections.abc import Iterable

from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import PROVENANCE, SCHEMA_VERSION, TIMING, Field


def schemas_as_markdown() -> str:
    """Return the documentation of every schema."""
    parts = [
        f"# Artifacts, schema version {SCHEMA_VERSION}",
        "In a name, `*` stands for one group that the case names. Every artifact also holds the "
        "case as text in `/case`, and in `/lineage/<role>` the file name, `uuid` and "
        "`content_sha256` of each input.",
        "Artifacts with fields show them to ParaView 5.12 and later in `/VTKHDF`, a view of the "
        "same bytes: particles or reference points, stepping through snapshots, or through modes. "
        "No reader of artifacts looks at it.",
        "## Every artifact",
        _attributes((*PROVENANCE, TIMING)),
    ]
    for schema in SCHEMAS.values():
        parts += [f"## {schema.name}", f"{schema.meaning}.", _datasets(schema.datasets)]
        if schema.attributes:
            parts.append(_attributes(schema.attributes))
    return "\n\n".join(parts) + "\n"


def _datasets(fields: Iterable[Field]) -> str:
    header = ("dataset", "axes", "type", "units", "symbol", "equation", "")
    rows = [
        (
            f"`{f.name}`",
            f"({', '.join(f.axes)})",
            f.kind,
            _units(f),
            f.symbol,
            f.equation,
            _meaning(f),
        )
        for f in fields
    ]
    return _table(header, *rows)


def _attributes(fields: Iterable[Field]) -> str:
    rows = [
        (f"`{f.name}`", " or ".join(f.allowed) or f.kind, _units(f), _meaning(f)) for f in fields
    ]
    return _table(("attribute", "kind", "units", ""), *rows)


def _units(field: Field) -> str:
    return f"{field.units}, in space {field.in_space}" if field.in_space else field.units


def _meaning(field: Field) -> str:
    return field.meaning if field.required else f"{field.meaning} (optional)"


def _table(header: tuple[str, ...], *rows: tuple[str, ...]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(schemas_as_markdown(), end="")
