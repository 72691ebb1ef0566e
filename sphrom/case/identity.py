"""Write a case out in full, and tell whether two cases agree in what a stage depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable

from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml


def resolved_yaml(case: Case, sections: Iterable[str] | None = None) -> str:
    """Return the case as YAML with every default filled in; it loads back to an equal case.

    With `sections`, return those alone.
    """
    names = None if sections is None else set(sections)
    return dump_yaml(case.model_dump(mode="json", include=names))


def section_digest(case: Case, sections: Iterable[str]) -> str:
    """Return a SHA-256 of the given sections of a case, defaults filled in.

    Raises ValueError for a section that a case doesn't have.
    """
    names = set(sections)
    if unknown := names - set(type(case).model_fields):
        raise ValueError(f"a case has no section {', '.join(sorted(unknown))}")
    values = case.model_dump(mode="json", include=names)
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
