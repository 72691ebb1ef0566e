"""The progress of a command that is not complete, on disk, so that it can go on where it stopped.

A journal is JSON: `rows`, what they were found with as a digest, and a digest of the rows, so that
damage is noticed. It is there as a whole or not at all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sphrom.whole_files import write_whole


def read_journal(path: Path) -> dict[str, Any] | None:
    """Return the content of a journal, {} where it is damaged, None where there is none."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
        whole = known["rows_sha256"] == _rows_digest(known["rows"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError, TypeError, KeyError):
        return {}
    return known if whole else {}


def write_journal(path: Path, key: str, rows: Any) -> None:
    """Write a journal. Raises ArtifactError when the folder can't be written to."""
    content = json.dumps({"key": key, "rows_sha256": _rows_digest(rows), "rows": rows}, indent=1)
    write_whole(path, content.encode())


def digest_of(parts: Iterable[str]) -> str:
    """Return a digest of all that rows depend on."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _rows_digest(rows: Any) -> str:
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()
