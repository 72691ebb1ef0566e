"""Figures that a case asks for, from runs that are there; which runs a change of models keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from sphrom.case.loader import load_case
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.models.stored_run import StoredRun
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

FIGURES = [
    {"name": "snapshot", "kind": "fields", "time": 0.04, "runs": [["full"], ["galerkin"]]},
    {"name": "line", "kind": "lines", "time": 0.04, "runs": [["galerkin", "apg"]]},
    {"name": "errors", "kind": "errors", "runs": [["galerkin"], ["apg"]], "range": "field"},
    {"name": "values", "kind": "singular-values", "modes": [1, 3]},
    {"name": "modes", "kind": "modes", "modes": [1, 3], "field": "y-velocity"},
]


@pytest.fixture
def case_with(place):
    """Change the sections of the case's file, and return it."""

    def change(**changes):
        path = Path("tiny.yaml")
        case = yaml.safe_load(path.read_text())
        for section, values in changes.items():
            case[section] = {**case[section], **values} if isinstance(values, dict) else values
        path.write_text(yaml.safe_dump(case, sort_keys=False))
        return path

    return change


def test_every_kind_is_drawn_and_asking_makes_nothing_another_case_s(
    sphrom, place, refused, case_with, digests
):
    result = sphrom("figures", "tiny.yaml", "--out", place)
    assert (result.exit_code, "lists no figures" in result.output) == (0, True)
    before = digests(place)
    path = case_with(compare={"figures": FIGURES})
    sphrom("figures", path, "--out", place, code=0)
    found = {file.name for file in (place / "figures").iterdir()}
    assert found == {f"{figure['name']}.png" for figure in FIGURES}
    for file in (place / "figures").iterdir():
        assert file.read_bytes().startswith(b"\x89PNG")
        assert file.stat().st_size > 10_000
    sphrom("run", path, "--out", place, code=0)
    assert digests(place) == before
    (place / "rom-galerkin-reynolds100.h5").unlink()
    assert "rom-galerkin-reynolds100.h5" in refused("figures", path, "--out", place)


def test_stored_errors_and_fields_are_those_of_the_runs(place):
    case = load_case(Path("tiny.yaml"))
    workspace, point = Workspace(StageContext(case, place, False, 1, None)), case.plan.points[0]
    with StoredComparison.of(workspace) as stored:
        series = stored.errors("galerkin", point)
        for quantity, told in (("speed", "velocity"), ("pressure", "pressure")):
            for over in ("line", "field"):
                time, error = stored.discrepancy("galerkin", point, quantity, over)
                expected = series.eq41[f"{told}_line_eq41_by_{over}_range"]
                np.testing.assert_allclose(error, expected)
                np.testing.assert_array_equal(time, series.time)
        assert stored.errors("unheard-of", point) is None
        where, line = stored.samples("galerkin", point)
    with StoredRun.opened(workspace, point, case.rom[0]) as run:
        some = run.sampled(where, [0, 2])
        np.testing.assert_array_equal(some.time, line.time[[0, 2]])
        np.testing.assert_array_equal(some.velocity, line.velocity[[0, 2]])


@pytest.mark.parametrize(
    ("figure", "told"),
    [
        ({"runs": [["galerkin", "gone"]]}, "no run has the name gone"),
        ({"time": 0.5}, "within the recorded time, 0 s to 0.08 s; got 0.5"),
        ({"reynolds": [125]}, "galerkin: not run at 125 beside a full run"),
        ({"kind": "modes", "runs": None, "time": None, "modes": [4]}, "at most basis.n_modes, 3"),
        ({"kind": "singular-values", "runs": None, "time": None, "modes": [2], "basis": "a"},
         "no basis has the name a"),
    ],
)  # fmt: skip
def test_figures_of_what_is_not_there_are_refused(place, refused, case_with, figure, told):
    given = {"name": "x", "kind": "fields", "time": 0.04, "runs": [["galerkin"]], **figure}
    wanted = {key: value for key, value in given.items() if value is not None}
    line = refused("figures", case_with(compare={"figures": [wanted]}), code=2)
    assert told in line
    assert "compare.figures" in line


def test_a_change_of_models_keeps_the_runs_that_stand(sphrom, place, refused, case_with):
    """Fewer or smaller models need no other basis, and so none of its runs is of another case."""
    untouched = {p: p.stat().st_mtime_ns for p in place.glob("*.h5") if p.name != "compare.h5"}
    models = [{"name": "apg", "projection": "apg", "n_modes": 3}, {"name": "small", "n_modes": 2}]
    sphrom("run", case_with(rom=models), "--out", place, "--force", code=0)
    assert {p: p.stat().st_mtime_ns for p in untouched} == untouched
    assert (place / "rom-small-reynolds150.h5").exists()
    larger = case_with(rom=[{"name": "large", "n_modes": 4}])
    assert "pod.h5 holds 3 of the 4" in refused("run", larger, "--out", place)
