"""The case file as one frozen pydantic model, its resolved text, and the digests of its sections.

A section checks its own keys, and `sphrom.case.checks` has the rules between sections.
`sphrom.case.loader.load_case` applies both. `sphrom.case.plan` has the derived quantities.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationInfo, model_validator

from sphrom.case.custom_sections import SURFACE_DEFAULTS
from sphrom.case.fields import SafeName, Section, key
from sphrom.case.model_sections import AnyModel
from sphrom.case.plan import Plan
from sphrom.case.points import ParameterSection
from sphrom.case.scene_section import IN_SPACE
from sphrom.case.scenes import DEFAULTS, AnyScene, is_in_space, kind_of, with_defaults
from sphrom.case.sections import (
    BasisSection,
    CompareSection,
    DiscretizationSection,
    FluidSection,
    OperatorSection,
    ReferenceSection,
    SnapshotSection,
    SplineSection,
    TimeSection,
)
from sphrom.case.study_sections import FitSection, SweepSection, TradeSection, TrainingSection
from sphrom.case.yaml_reader import dump_yaml

MOST_MODELS = 100
"""Largest number of reduced models of one case; `trade` may add others."""


class Case(Section):
    """A case of sphrom: one flow, its full runs, and its reduced models."""

    name: SafeName = key(..., "name of the case, and of its folder under runs/")
    scene: AnyScene = key(
        ..., "geometry with initial and boundary conditions", discriminator="kind"
    )
    fluid: FluidSection = key(FluidSection(), "the fluid")
    discretization: DiscretizationSection = key(
        DiscretizationSection(), "discretisation of the fluid into particles"
    )
    time: TimeSection = key(TimeSection(), "duration and time step of full runs")
    snapshots: SnapshotSection = key(SnapshotSection(), "snapshots to store")
    parameters: ParameterSection = key(
        ParameterSection(), "parameter values for training and for testing"
    )
    reference: ReferenceSection = key(
        ReferenceSection(), "points that snapshots are mapped onto (Eq. 3.13-3.15)"
    )
    basis: BasisSection = key(BasisSection(), "the trial basis (Eq. 3.16)")
    psi: SplineSection = key(SplineSection(), "splines of the modes (Eq. 3.17-3.20)")
    operators: OperatorSection = key(
        OperatorSection(), "projected operators of models on the reference points"
    )
    rom: tuple[AnyModel, ...] = key(
        ({"name": "fast", "evaluation": "operators"},),
        f"reduced models to run and compare, at most {MOST_MODELS}",
        max_length=MOST_MODELS,
        validate_default=True,
    )
    compare: CompareSection = key(
        CompareSection(), "comparison of reduced and full runs (Eq. 4.1-4.3)"
    )
    trade: TradeSection = key(
        TradeSection(), "models whose speed and accuracy `sphrom trade` compares"
    )
    sweep: SweepSection = key(
        SweepSection(), "parameter values at which `sphrom sweep` runs one model"
    )
    fit: FitSection = key(FitSection(), "parameters that `sphrom fit` estimates from measurements")
    training: TrainingSection = key(
        TrainingSection(),
        "region of parameters for which `sphrom train` makes a model; every other key is a "
        "parameter with its least and greatest value, such as reynolds: [50, 1000]",
    )

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, values: Any) -> Any:
        """Fill missing values, and null, with the defaults of the kind of scene."""
        if not isinstance(values, Mapping):
            return values
        filled = {name: value for name, value in values.items() if value is not None}
        filled.setdefault("scene", {})
        if isinstance(filled["scene"], Mapping) and filled["scene"].get("fluid") is not None:
            filled = with_defaults(filled, SURFACE_DEFAULTS)
        if is_in_space(filled["scene"]):
            filled = with_defaults(filled, IN_SPACE)
        return with_defaults(filled, DEFAULTS.get(kind_of(values), {}))

    @model_validator(mode="after")
    def _with_folder(self, info: ValidationInfo) -> Case:
        # The path is absolute, because the current folder may change and differs in workers.
        self.__dict__["folder"] = Path((info.context or {}).get("folder", Path())).absolute()
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Case:
        """Return a copy with changed keys, and with a plan of its own."""
        copied = super().model_copy(update=update, deep=deep)
        for cached in ("plan", "text"):
            copied.__dict__.pop(cached, None)
        return copied

    @cached_property
    def folder(self) -> Path:
        """The folder of the case file; files that it names are relative to this folder."""
        return Path().absolute()

    @cached_property
    def plan(self) -> Plan:
        """The quantities that follow from the keys."""
        return Plan(self)

    @cached_property
    def text(self) -> str:
        """The case as resolved YAML."""
        return resolved_yaml(self)


VERSIONS: Mapping[str, int] = {
    "compare": 3, "discretization": 3, "fluid": 2, "operators": 4, "psi": 2, "rom": 3, "trade": 2
}  # fmt: skip
"""Versions of sections, raised when a default or the meaning of a key changes: older artifacts then
belong to another case. A new key needs none if its default keeps the earlier behaviour."""


FILE = "file"
"""The key that names a file. Keys beside it hold the file's content, so its place is irrelevant."""


def resolved_yaml(case: Case, folder: Path | None = None) -> str:
    """Return the case as YAML with all defaults filled in; it loads back to an equal case.

    With a folder, the paths of files are relative to it.
    """
    values = case.model_dump(mode="json")
    return dump_yaml(values if folder is None else moved(values, case.folder, folder))


def moved(values: Any, source: Path, folder: Path | None) -> Any:
    """Return the keys of a case with the paths of its files changed.

    The given paths are relative to the folder `source`, the returned ones to `folder`, or absolute
    if it is None. With a folder, outlines stay in their files, because they may be large.
    """
    if isinstance(values, list):
        return [moved(one, source, folder) for one in values]
    if not isinstance(values, dict):
        return values
    keys = {name: moved(one, source, folder) for name, one in values.items()}
    if isinstance(name := values.get(FILE), str):
        # Resolve links, because `..` after a link leads to the parent of its target.
        keys[FILE] = os.path.realpath(source / name)
        if folder is not None:
            keys.pop("wkt", None)
            keys[FILE] = os.path.relpath(keys[FILE], os.path.realpath(folder))
    return keys


def section_inputs(case: Case, sections: Iterable[str]) -> dict[str, object]:
    """Return the `stated` values of some sections of a case, and the versions of the sections."""
    names = set(sections)
    values = {name: stated(getattr(case, name)) for name in names}
    versions = {f"{name} version": VERSIONS[name] for name in names & VERSIONS.keys()}
    # The kind of scene is part of it, because defaults depend on it.
    return {"scene": case.scene.kind if names else ""} | values | versions


def stated(value: object) -> object:
    """Return a value as JSON, without the keys of sections that have their default.

    Therefore a new key with its default does not change the digests of older artifacts.
    """
    if isinstance(value, BaseModel):
        fields = type(value).model_fields.items()
        usual = {name: field.get_default(call_default_factory=True) for name, field in fields}
        values = ((name, getattr(value, name)) for name in usual if name != FILE)
        return {name: stated(one) for name, one in values if one != usual[name]}
    if isinstance(value, Mapping):
        return {str(key): stated(one) for key, one in value.items()}
    return [stated(one) for one in value] if isinstance(value, tuple | list) else value


def inputs_digest(inputs: Mapping[str, object]) -> str:
    """Return the SHA-256 of named inputs."""
    canonical = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
