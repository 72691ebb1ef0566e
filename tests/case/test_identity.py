from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import sphrom
from sphrom.case.hints import case_warnings
from sphrom.case.loader import load_case
from sphrom.case.models import VERSIONS, Case, inputs_digest, resolved_yaml, section_inputs
from sphrom.case.scenes import DEFAULTS
from sphrom.case.schema import json_schema, key_paths, node_at
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.case.template import new_case
from sphrom.errors import CaseError

CASES = sorted((Path(sphrom.__file__).parents[1] / "cases").glob("*.yaml"))


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_shipped_cases(path):
    case = load_case(path)
    assert case.name == path.stem
    assert case_warnings(case) == []


def test_case_of_the_paper_is_as_printed_but_for_its_sign_and_steps():
    case = load_case(next(path for path in CASES if path.stem == "taylor_green_paper"))
    plan = case.plan.steps
    assert (case.discretization.resolution, plan.n_steps, plan.n_snapshots) == (300, 600, 201)
    assert case.plan.smoothing_length == pytest.approx(4 / 300)
    assert case.plan.reference_smoothing_length == case.plan.smoothing_length
    assert case.scene.pressure_sign == "exact"  # with the printed one pressure is off by 300 %
    assert {model.advection for model in case.rom} == {"consistent"}
    assert {m.memory_length for m in case.rom if m.projection == "apg"} == {1e-4}


@pytest.mark.parametrize("scene", ["lid_driven_cavity", "open_cavity"])
def test_cavities_of_the_paper_are_as_printed_but_for_walls_and_steps(scene):
    case = load_case(next(path for path in CASES if path.stem == f"{scene}_paper"))
    walls = case.discretization.walls
    assert (walls.kind, walls.layers) == ("adami", 3)
    assert case.discretization.smoothing_length_ratio == 2.0
    assert case.plan.reference_smoothing_length == case.plan.smoothing_length
    assert (case.fluid.reference_density, case.fluid.mach_number) == (1.0, 0.1)
    assert (case.basis.inner_product, case.plan.separate_mean_density) == ("raw", False)
    assert {model.advection for model in case.rom} == {"consistent"}
    assert {m.memory_length for m in case.rom if m.projection == "apg"} == {1e-7}


@pytest.mark.parametrize(
    ("scene", "given", "kind"),
    [
        ("lid_driven_cavity_demo", {"no_slip": "linear"}, "adjoint"),
        ("lid_driven_cavity_demo", {"continuity": "normal"}, "normal"),
        ("lid_driven_cavity_demo", {"no_slip": "paper", "continuity": "paper"}, "printed"),
        ("lid_driven_cavity_paper", {"continuity": "paper"}, "adami-as-fluid"),
        ("lid_driven_cavity_paper", {"no_slip": "paper"}, "printed-normal"),
        ("sloshing", {"continuity": "adjoint"}, "adjoint"),
        ("sloshing", {"no_slip": "linear"}, "adjoint"),
    ],
)
def test_earlier_keys_of_walls_are_read_as_kinds(scene, given, kind):
    (path,) = CASES[0].parent.rglob(f"{scene}.yaml")
    overrides = {f"discretization.walls.{name}": value for name, value in given.items()}
    case = load_case(path, overrides if "paper" in scene else {"rom": [], **overrides})
    assert case.discretization.walls.kind == kind
    assert "no_slip" not in resolved_yaml(case)


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_resolved_case_loads_back_equal(path, load):
    case = load_case(path)
    again = load(resolved_yaml(case), base="")
    assert again == case
    assert resolved_yaml(again) == resolved_yaml(case)


@pytest.mark.parametrize("kind", DEFAULTS)
def test_template_loads_and_explains_every_key(kind, load):
    text = new_case(kind, full=True)
    case = load(text, base="")
    assert case.scene.kind == kind
    assert case_warnings(case) == []
    assert max(map(len, text.splitlines())) <= 80
    lines = text.splitlines()
    for path in own_paths(kind):
        named = f"{path[-1]}:"
        if path[0] == "rom" and f"# {named}" in text:  # a key of models on particles
            continue
        line = next(n for n, found in enumerate(lines) if found.strip().startswith(named))
        assert lines[line - 1].strip().startswith("#"), path


def test_template_of_custom_shows_every_key_of_shapes_and_measures():
    text, sections = new_case("custom", full=True), json_schema()["$defs"]
    names = ["CustomScene", "DrawnSection"]
    for name in names:  # which grows
        found = re.findall(r"#/\$defs/(\w+)", json.dumps(sections[name]))
        names += [each for each in dict.fromkeys(found) if each not in names]
        for key in sections[name]["properties"]:
            assert re.search(rf"[ .]{key}:", text), (name, key)


def own_paths(kind):
    """Return the keys that a case has unasked; it has no figures, no inflow and no surface."""
    paths = [path for path in key_paths(kind=kind) if not {"figures", "inflow"} & {*path[:-1]}]
    return [path for path in paths if path[:2] != ("scene", "fluid")]


EXAMPLES = {"name": True, "parameters": True, "rom": True, "sweep": {"reynolds"}}
"""What a template has no defaults for."""


@pytest.mark.parametrize("kind", DEFAULTS)
def test_template_holds_the_defaults(kind, load):
    given = load(new_case(kind, full=True), base="").model_dump(exclude=EXAMPLES)
    default = Case.model_validate({"name": "x", "scene": {"kind": kind}})
    assert given == default.model_dump(exclude=EXAMPLES)


@pytest.mark.parametrize("kind", DEFAULTS)
def test_short_template_is_short_and_leads_to_the_fast_model(kind, load):
    text = new_case(kind)
    assert len(text.splitlines()) <= 32
    assert max(map(len, text.splitlines())) <= 80
    case = load(text, base="")
    assert case.scene.kind == kind
    assert case_warnings(case) == []
    (fast,) = case.rom
    assert fast.from_operators
    assert sweep_model(case) == fast
    assert len(sweep_points(case)) == 1000
    (predicted,) = case.plan.test_points
    assert min(case.plan.train_points) < predicted < max(case.plan.train_points)
    assert case.plan.n_particles < 4000
    assert f"sphrom case new {kind} --full" in text


def test_unknown_kind():
    with pytest.raises(CaseError, match=r"did you mean taylor-green\?") as error:
        new_case("taylor_green")
    assert all(kind in str(error.value) for kind in DEFAULTS)


@pytest.mark.parametrize("kind", DEFAULTS)
def test_schema_describes_every_key_and_gives_numbers_a_unit(kind):
    for path in own_paths(kind):
        node = node_at(path, kind)
        assert node is not None
        assert node.get("description"), path
        branches = node.get("anyOf", [node])
        if any(branch.get("type") == "number" for branch in branches):
            assert node.get("unit"), path
    assert json_schema()["required"] == ["name", "scene"]


def test_every_key_is_set_somewhere():
    """A key that no case, page, script or test sets serves nobody."""
    root, here = Path(sphrom.__file__).parents[1], Path(__file__)
    kinds = {".py", ".yaml", ".md", ".ipynb"}
    files = (f for name in ("cases", "docs", "scripts", "tests") for f in (root / name).rglob("*"))
    others = {here, here.with_name("test_defaults.py"), root / "docs" / "case-file.md"}
    text = "\n".join(f.read_text("utf-8") for f in files if f.suffix in kinds and f not in others)
    keys = {str(path[-1]) for kind in DEFAULTS for path in key_paths(kind=kind)}
    keys |= {key for section in json_schema()["$defs"].values() for key in section["properties"]}
    given = set(re.findall(r"(?<!\w)(\w+)\\?[\"']?(?:=|\s*:)", text))
    assert sorted(keys - given) == []


def digest(case, sections):
    return inputs_digest(section_inputs(case, sections))


def test_digest_depends_on_its_sections_only(load):
    case = load("time: {final_time: 1}\n")
    same = load("time: {final_time: 1.0}\ncompare: {grid: 7}\nfluid:\n")
    other = load("time: {final_time: 2}\n")
    sections = ["time", "fluid"]
    assert digest(case, sections) == digest(same, reversed(sections))
    assert digest(case, sections) != digest(other, sections)
    assert digest(case, ["fluid"]) == digest(other, ["fluid"])
    assert digest(case, ["compare"]) != digest(same, ["compare"])
    with pytest.raises(AttributeError, match="tiem"):
        digest(case, ["tiem"])


def test_a_value_that_is_the_default_says_nothing(load):
    given = load("psi: {order: 3}\nfluid: {mach_number: 0.1}\n")
    assert digest(given, ["psi", "fluid"]) == digest(load(""), ["psi", "fluid"])
    assert digest(load("psi: {order: 5}\n"), ["psi"]) != digest(given, ["psi"])


@pytest.mark.parametrize("kind", DEFAULTS)
def test_a_default_that_changed_has_a_version(kind):
    """Digests leave defaults out. A default that changes makes what there is of another case only
    if VERSIONS counts its section up; then the table in `defaults.json` is to be changed too."""
    table = json.loads((Path(__file__).parent / "defaults.json").read_text(encoding="utf-8"))
    today = Case.model_validate({"name": "x", "scene": {"kind": kind}}).model_dump(mode="json")
    for section, known in table[kind].items():
        assert known["version"] == VERSIONS.get(section, 1), section
        assert {key: today[section][key] for key in known["defaults"]} == known["defaults"], section
