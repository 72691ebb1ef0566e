"""Write a case out in full, and tell whether two cases agree in what a stage depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping

from pydantic import BaseModel

from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml

VERSIONS: Mapping[str, int] = {"discretization": 2, "operators": 2, "psi": 2, "rom": 2, "trade": 2}
"""Of sections in which a default has changed, or the meaning of a key: what was made before is then
of another case. A key that is new needs none, as long as its default is what was done without it.
"""


def resolved_yaml(case: Case, sections: Iterable[str] | None = None) -> str:
    """Return the case as YAML with every default filled in; it loads back to an equal case.

    With `sections`, return those alone.
    """
    names = None if sections is None else set(sections)
    return dump_yaml(case.model_dump(mode="json", include=names))


def section_inputs(case: Case, sections: Iterable[str]) -> dict[str, object]:
    """Return what the given sections of a case say, by section: `stated`, and in which version.

    Raises ValueError for a section that a case doesn't have.
    """
    names = set(sections)
    if unknown := names - set(type(case).model_fields):
        raise ValueError(f"a case has no section {', '.join(sorted(unknown))}")
    found = {name: stated(getattr(case, name)) for name in names}
    versions = {f"{name} version": VERSIONS[name] for name in names & VERSIONS.keys()}
    # Defaults differ from scene to scene.
    return {"scene": case.scene.kind if names else ""} | found | versions


def stated(value: object) -> object:
    """Return what of a value isn't its section's default, as JSON has it.

    So a key that is new and not given makes no difference to what is older than it.
    """
    if isinstance(value, BaseModel):
        fields = type(value).model_fields.items()
        usual = {name: field.get_default(call_default_factory=True) for name, field in fields}
        given = ((name, getattr(value, name)) for name in usual)
        return {name: stated(one) for name, one in given if one != usual[name]}
    if isinstance(value, Mapping):
        return {str(key): stated(one) for key, one in value.items()}
    return [stated(one) for one in value] if isinstance(value, tuple | list) else value


def inputs_digest(inputs: Mapping[str, object]) -> str:
    """Return a SHA-256 of what something is made from, by name."""
    canonical = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
