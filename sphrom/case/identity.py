"""Write a case out in full, and tell whether two cases agree in what a stage depends on."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from shapely.geometry.base import BaseGeometry

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


def default_case(case: Case) -> Case:
    """Return the case of the same scene that says nothing else."""
    return type(case).model_validate({"name": case.name, "scene": case.scene.model_dump()})


def section_inputs(
    case: Case, sections: Iterable[str], default: Case | None = None
) -> dict[str, object]:
    """Return what the given sections of a case say, by section: `stated`, and in which version.

    Raises ValueError for a section that a case doesn't have.

    Parameters
    ----------
    default : the case's `default_case`, where it is known.
    """
    names = set(sections)
    if unknown := names - set(type(case).model_fields):
        raise ValueError(f"a case has no section {', '.join(sorted(unknown))}")
    default = default or default_case(case)
    found = {name: stated(getattr(case, name), getattr(default, name)) for name in names}
    versions = {f"{name} version": VERSIONS[name] for name in names & VERSIONS.keys()}
    # Defaults differ from scene to scene.
    scene = stated(case.scene) if "scene" in names else case.scene.kind
    return found | versions | ({"scene": scene} if names else {})


def stated(value: object, default: object = None) -> object:
    """Return what of a value isn't its default, as JSON has it.

    So a key that is new and not given makes no difference to what is older than it. Of a polygon it
    is a SHA-256 of all its corners.
    """
    if isinstance(value, BaseGeometry):
        return hashlib.sha256(value.wkb).hexdigest()
    if isinstance(value, BaseModel) or dataclasses.is_dataclass(value):
        same_kind = type(default) is type(value)
        usual = {
            name: getattr(default, name) if same_kind else own for name, own in _defaults(value)
        }
        given = ((name, getattr(value, name), own) for name, own in usual.items())
        return {name: stated(one, own) for name, one, own in given if one != own}
    if isinstance(value, Mapping):
        return {str(key): stated(one) for key, one in value.items()}
    return [stated(one) for one in value] if isinstance(value, tuple | list) else value


def _defaults(value: Any) -> Iterator[tuple[str, object]]:
    """Yield the fields of a value, and what each is where it isn't given."""
    if isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield name, field.get_default(call_default_factory=True)
    else:
        for own in dataclasses.fields(value):
            yield own.name, own.default


def inputs_digest(inputs: Mapping[str, object]) -> str:
    """Return a SHA-256 of what something is made from, by name."""
    canonical = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
