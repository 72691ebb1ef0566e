"""The case file as one frozen pydantic model, written in full, and as the inputs of stages.

A section checks its own keys; `sphrom.case.checks` has the rules between sections. Use
`sphrom.case.loader.load_case` to have both. `sphrom.case.plan` is what follows from the keys.
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

from sphrom.case.fields import SafeName, Section, key
from sphrom.case.free_surfaces import surface_defaults
from sphrom.case.full_model_sections import (
    DiscretizationSection,
    FluidSection,
    SnapshotSection,
    TimeSection,
)
from sphrom.case.plan import Plan
from sphrom.case.points import ParameterSection
from sphrom.case.scenes import DEFAULTS, AnyScene, kind_of, with_defaults
from sphrom.case.sections import (
    BasisSection,
    CompareSection,
    OperatorSection,
    ReducedModelSection,
    ReferenceSection,
    SplineSection,
)
from sphrom.case.study_sections import FitSection, TradeSection, TrainingSection
from sphrom.case.sweep_section import SweepSection
from sphrom.case.yaml_reader import dump_yaml

MOST_MODELS = 100
"""Reduced models of one case; `trade` weighs others beside them."""


class Case(Section):
    """A case of sphrom: one flow, its full runs, and the reduced models made from them."""

    name: SafeName = key(..., "what its folder under runs/ is called")
    scene: AnyScene = key(
        ..., "geometry with initial and boundary conditions", discriminator="kind"
    )
    fluid: FluidSection = key(FluidSection(), "the fluid")
    discretization: DiscretizationSection = key(
        DiscretizationSection(), "how the fluid is cut into particles"
    )
    time: TimeSection = key(TimeSection(), "how long, and in which steps, the full model runs")
    snapshots: SnapshotSection = key(SnapshotSection(), "which instants are kept")
    parameters: ParameterSection = key(
        ParameterSection(), "values of the parameters to learn from and to predict"
    )
    reference: ReferenceSection = key(
        ReferenceSection(), "points that snapshots are mapped onto (Eq. 3.13-3.15)"
    )
    basis: BasisSection = key(BasisSection(), "the trial basis (Eq. 3.16)")
    psi: SplineSection = key(SplineSection(), "splines of the modes (Eq. 3.17-3.20)")
    operators: OperatorSection = key(
        OperatorSection(), "the projected operators of models on the reference points"
    )
    rom: tuple[ReducedModelSection, ...] = key(
        (ReducedModelSection(name="fast", evaluation="operators"),),
        f"reduced models to run and compare, at most {MOST_MODELS}",
        max_length=MOST_MODELS,
    )
    compare: CompareSection = key(
        CompareSection(), "how reduced and full runs are compared (Eq. 4.1-4.3)"
    )
    trade: TradeSection = key(
        TradeSection(), "the models that `sphrom trade` weighs, speed against accuracy"
    )
    sweep: SweepSection = key(
        SweepSection(), "the values at which `sphrom sweep` runs one model, one or thousands"
    )
    fit: FitSection = key(
        FitSection(), "the parameters that `sphrom fit` looks for, given measurements"
    )
    training: TrainingSection = key(
        TrainingSection(),
        "the region of parameters that `sphrom train` makes a model for; every other key is a "
        "parameter with its least and greatest value, such as reynolds: [50, 1000]",
    )

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, values: Any) -> Any:
        """Put the defaults of the kind of scene where no value is given; null gives none."""
        if not isinstance(values, Mapping):
            return values
        given = {name: value for name, value in values.items() if value is not None}
        given.setdefault("scene", {})
        if isinstance(given["scene"], Mapping) and given["scene"].get("fluid") is not None:
            scene = given["scene"]
            along_axes = scene.get("slip") == "free" and not scene.get("solids")
            given = with_defaults(given, surface_defaults(along_axes))
        return with_defaults(given, DEFAULTS.get(kind_of(values), {}))

    @model_validator(mode="after")
    def _with_folder(self, info: ValidationInfo) -> Case:
        # A process may change its own folder, and another one has its own.
        self.__dict__["folder"] = Path((info.context or {}).get("folder", Path())).absolute()
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Case:
        """Return a copy with keys changed, and with a plan of its own."""
        copied = super().model_copy(update=update, deep=deep)
        for worked_out in ("plan", "text"):
            copied.__dict__.pop(worked_out, None)
        return copied

    @cached_property
    def folder(self) -> Path:
        """The folder of the case's file, which files that it names are relative to."""
        return Path().absolute()

    @cached_property
    def plan(self) -> Plan:
        """What follows from the keys."""
        return Plan(self)

    @cached_property
    def text(self) -> str:
        """The case as `resolved_yaml` has it."""
        return resolved_yaml(self)


VERSIONS: Mapping[str, int] = {
    "compare": 2, "discretization": 2, "fluid": 2, "operators": 4, "psi": 2, "rom": 3, "trade": 2
}  # fmt: skip
"""Of sections in which a default has changed, or the meaning of a key: what was made before is then
of another case. A key that is new needs none, as long as its default is what was done without it.
"""


FILE = "file"
"""The key that names a file; what the file held is in keys beside it, and it may lie anywhere."""


def resolved_yaml(case: Case, folder: Path | None = None) -> str:
    """Return the case as YAML with every default filled in; it loads back to an equal case.

    With a folder, files that the case names are found from there.
    """
    values = case.model_dump(mode="json")
    return dump_yaml(values if folder is None else moved(values, case.folder, folder))


def moved(values: Any, source: Path, folder: Path | None) -> Any:
    """Return keys of a case in the folder `source` for a case in another folder, None for any.

    In a folder outlines are in their files alone: a case is smaller than they may be.
    """
    if isinstance(values, list):
        return [moved(one, source, folder) for one in values]
    if not isinstance(values, dict):
        return values
    found = {name: moved(one, source, folder) for name, one in values.items()}
    if isinstance(name := values.get(FILE), str):
        # Links are followed, as `..` behind one leads elsewhere.
        found[FILE] = os.path.realpath(source / name)
        if folder is not None:
            found.pop("wkt", None)
            found[FILE] = os.path.relpath(found[FILE], os.path.realpath(folder))
    return found


def section_inputs(case: Case, sections: Iterable[str]) -> dict[str, object]:
    """Return what the given sections of a case say, by section: `stated`, and in which version."""
    names = set(sections)
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
        given = ((name, getattr(value, name)) for name in usual if name != FILE)
        return {name: stated(one) for name, one in given if one != usual[name]}
    if isinstance(value, Mapping):
        return {str(key): stated(one) for key, one in value.items()}
    return [stated(one) for one in value] if isinstance(value, tuple | list) else value


def inputs_digest(inputs: Mapping[str, object]) -> str:
    """Return a SHA-256 of what something is made from, by name."""
    canonical = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
