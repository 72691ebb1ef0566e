"""What makes an artifact another case's, and what does not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import pytest

from sphrom.case.fields import Section, key
from sphrom.case.model_sections import (
    ParticleModelSection,
    PointModelSection,
    ReducedModels,
    ReducedModelSection,
)
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import DiscretizationSection, SplineSection
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Target, Workspace

GIVEN = {
    "name": "x",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 16},
    "psi": {"order": 2},
    "rom": [{"name": "fast"}, {"name": "other", "evaluation": "operators", "output": "snapshots"}],
}


class NewSection(Section):
    colour: str = key("blue", "a section that is new")


class NewerSplines(SplineSection):
    smoothing: float = key(0.0, "a key that is new", unit="-")


class NewerDiscretization(DiscretizationSection):
    filter: str | None = key(None, "a key that is new")


class NewerModel(ParticleModelSection):
    filter: str = key("none", "a key that is new")


NEWER = ReducedModels(particles=NewerModel, points=PointModelSection)


class NewerCase(Case):
    """A case of a later version, with keys and a section that older ones don't know."""

    psi: NewerSplines = key(NewerSplines(), "splines")
    discretization: NewerDiscretization = key(NewerDiscretization(), "particles")
    rom: tuple[Annotated[ReducedModelSection, NEWER], ...] = key((), "models")
    novelty: NewSection = key(NewSection(), "what is new")


def targets(case: Case, folder: Path) -> dict[str, Target]:
    """Return the artifacts of a case by name."""
    workspace = Workspace(StageContext(case, folder, False, 1, None))  # type: ignore[arg-type]
    point = ParameterPoint(100.0)
    made = [
        workspace.packing(),
        workspace.spin_up(point),
        workspace.full_run(point),
        workspace.mapped(point),
        workspace.basis(),
        workspace.splines(),
        workspace.operators(),
        workspace.comparison(),
        *(workspace.reduced_run(model, point) for model in case.rom),
    ]
    return {target.path.name: target for target in made}


def changed(older: Case, newer: Case, folder: Path) -> set[str]:
    """Return the artifacts that are of another case in one than in the other."""
    before, after = targets(older, folder), targets(newer, folder)
    assert before.keys() == after.keys()
    return {name for name in before if before[name].inputs_digest != after[name].inputs_digest}


def newer(**sections: Any) -> Case:
    return NewerCase.model_validate(GIVEN | sections)


def test_new_keys_at_their_defaults_leave_older_artifacts_valid(tmp_path: Path) -> None:
    assert changed(Case.model_validate(GIVEN), newer(), tmp_path) == set()


FILTERED = {"rom": [{"name": "fast", "filter": "box"}, *GIVEN["rom"][1:]]}


@pytest.mark.parametrize(
    ("section", "kept", "made_again"),
    [
        ({"psi": {"order": 5}}, "pod.h5", "psi.h5"),
        ({"basis": {"n_modes": 4}}, "map-reynolds100.h5", "pod.h5"),
        ({"time": {"final_time": 3.0}}, "packing.h5", "fom-reynolds100.h5"),
        ({"discretization": {"resolution": 17}}, "", "packing.h5"),
        ({"psi": {"order": 2, "smoothing": 0.5}}, "pod.h5", "psi.h5"),
        ({"discretization": {"resolution": 16, "filter": "box"}}, "", "packing.h5"),
        (FILTERED, "packing.h5", "rom-fast-reynolds100.h5"),
    ],
    ids=["psi", "basis", "time", "discretization", "new of psi", "new of particles", "new of rom"],
)
def test_what_differs_is_made_again(
    section: dict[str, Any], kept: str, made_again: str, tmp_path: Path
) -> None:
    """Keys that are new and given make another case, too."""
    found = changed(Case.model_validate(GIVEN), newer(**section), tmp_path)
    assert {made_again, "compare.h5"} <= found
    assert kept not in found


def test_a_run_at_another_speed_of_sound_is_made_again(tmp_path: Path) -> None:
    given = {**GIVEN, "time": {"step": 1e-4}}
    thick = given | {"parameters": {"test": {"reynolds": [1.0]}}}
    assert "fom-reynolds100.h5" in changed(*map(Case.model_validate, (given, thick)), tmp_path)


def test_a_solid_that_differs_in_its_last_digit_is_packed_anew(tmp_path: Path) -> None:
    def packing(radius: float) -> Target:
        circle = {"circle": {"centre": [1, 1], "radius": radius}}
        scene = {"kind": "custom", "box": {"upper": [2, 2]}, "solids": {"disc": circle}}
        case = Case.model_validate({"name": "x", "scene": scene})
        context = StageContext(case, tmp_path, False, 1, None)  # type: ignore[arg-type]
        return Workspace(context).packing()

    first, other = packing(0.5), packing(0.5000000000000001)
    assert first.inputs_digest == packing(0.5).inputs_digest
    assert first.inputs_digest != other.inputs_digest
