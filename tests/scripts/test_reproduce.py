"""The paper's experiments: coarser cases, costs that are told, and claims that can be looked up."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

import sphrom
from sphrom.case.loader import load_case
from sphrom.case.yaml_reader import dump_yaml, read_yaml

ROOT = Path(sphrom.__file__).parents[1]
SCENES = ("taylor_green", "lid_driven_cavity", "open_cavity")
KINDS = {"share": "space basis modes", "compression": "run reynolds", "error": "run quantity",
         "frequency": "run reynolds", "phase": "run reynolds", "exact": "quantity reynolds",
         "reference": "profile state reynolds", "amplitude": "run quantity time reynolds",
         "trough": "run quantity time between reynolds", "seen": "", "reynolds": "length reynolds",
         "roughness": "run quantity time between reynolds", "density": "reynolds"}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_every_claim_can_be_looked_up(scene):
    corrected, printed = (load_case(ROOT / f"cases/{scene}{end}.yaml") for end in ("", "_paper"))
    names = {model.name: model for model in corrected.rom}
    claims = (ROOT / "scripts" / "paper_claims" / f"{scene}.yaml").read_text()
    for claim in yaml.safe_load(claims):
        assert {"where", "what", "paper"} <= claim.keys()
        assert set(KINDS[claim["find"]].split()) <= claim.keys(), claim["what"]
        assert claim.get("seen", {}).keys() <= {"as printed", "corrected"}
        assert claim.get("basis", "all") in corrected.plan.bases
        assert claim.get("modes", 1) <= corrected.plan.n_modes
        if "run" in claim:
            assert not names[claim["run"]].from_operators
            assert names[claim["fast"]].from_operators
            assert claim["run"] in {model.name for model in printed.rom}
            run_at = {point.reynolds for point in corrected.plan.rom_points(names[claim["run"]])}
            assert set(claim["reynolds"]) <= run_at


@pytest.mark.parametrize("scene", SCENES)
def test_every_figure_of_the_paper_is_asked_for(scene):
    numbers = {"taylor_green": range(4, 17), "lid_driven_cavity": range(17, 30),
               "open_cavity": range(30, 37)}[scene]  # fmt: skip
    for end in ("", "_paper"):
        figures = load_case(ROOT / f"cases/{scene}{end}.yaml").compare.figures
        assert [figure.name for figure in figures] == [f"figure-{n:02d}" for n in numbers]


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("factor", [2.0, 5.0])
def test_a_coarser_case_keeps_its_snapshots(scene, factor, tmp_path, script):
    coarser = script("reproduce").coarser
    for end in ("", "_paper"):
        path = ROOT / f"cases/{scene}{end}.yaml"
        whole = load_case(path)
        file = tmp_path / path.name
        file.write_text(dump_yaml(coarser(read_yaml(path.read_text()).value, factor)))
        case = load_case(file)
        assert case.discretization.resolution == whole.discretization.resolution / factor
        assert case.plan.steps.n_snapshots == whole.plan.steps.n_snapshots
        interval = whole.plan.steps.snapshot_interval
        assert case.plan.steps.snapshot_interval == pytest.approx(interval, rel=1e-12)
        assert case.plan.steps.time_step > 1.4 * whole.plan.steps.time_step


def test_what_it_costs_is_told_and_refused_where_it_is_too_much(
    tmp_path, monkeypatch, capsys, script
):
    reproduce = script("reproduce")
    arguments = ["reproduce.py", "open-cavity", "--coarser", "10", "--out", str(tmp_path)]
    monkeypatch.setattr(
        reproduce, "full_seconds", lambda case, n_runs: 1e-3 * case.plan.steps.n_steps
    )
    monkeypatch.setattr(sys, "argv", [*arguments, "--dry"])
    with pytest.raises(SystemExit) as stopped:
        reproduce.main()
    told = capsys.readouterr().out
    assert stopped.value.code == 0
    assert "open_cavity_paper, as printed: about" in told
    assert "GB at a time" in told
    monkeypatch.setattr(sys, "argv", [*arguments, "--disk", "1e-3"])
    assert reproduce.main() == 5
    assert "--keep results" in capsys.readouterr().err
