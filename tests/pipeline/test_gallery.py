"""The gallery: each case is short, loads without a warning, and runs; here coarser and shorter."""

from __future__ import annotations

from pathlib import Path

import pytest

import sphrom
from sphrom.api.study import Study
from sphrom.case.hints import case_warnings
from sphrom.case.loader import load_case

GALLERY = Path(sphrom.__file__).parents[1] / "cases" / "gallery"
RESOLUTIONS = {
    "cavity_with_fin": 30,
    "cylinder": 8,
    "cylinder_array": 20,
    "dam_break": 12,
    "eccentric_cylinder": 24,
    "kolmogorov": 16,
    "l_shaped_cavity": 20,
    "oscillating_drop": 10,
    "sloshing": 8,
    "standing_wave": 12,
    "taylor_couette": 12,
    "wake": 8,
}
"""Coarse ones that leave gaps two supports wide and solids one."""
FULL = "dam_break", "oscillating_drop", "standing_wave"
"""Those of the full model alone."""
N_STEPS = 6


def test_cases_are_short_and_right():
    paths = {path.stem: path for path in GALLERY.glob("*.yaml")}
    assert sorted(paths) == sorted(RESOLUTIONS)
    for name, path in paths.items():
        assert len(path.read_text().splitlines()) <= 40
        case = load_case(path)
        assert case.name == name
        assert case_warnings(case) == []
        assert [model.evaluation for model in case.rom] == ["operators"] * (name not in FULL)


@pytest.mark.parametrize(
    "name", [name if name == "cylinder" else pytest.param(name, marks=pytest.mark.slow)
             for name in RESOLUTIONS if name not in FULL]
)  # fmt: skip
def test_a_case_runs(sphrom, tmp_path, name):
    path = GALLERY / f"{name}.yaml"
    case = load_case(path)
    resolution, first = RESOLUTIONS[name], case.plan.train_points[0]
    step = load_case(path, {"discretization.resolution": resolution}).plan.steps.time_step
    settings = {
        "discretization.resolution": resolution,
        "time.final_time": N_STEPS * step,
        "discretization.packing.tolerance": 0.1,
        "time.spin_up": 0,
        "snapshots.every": 1,
        "parameters.train.reynolds": [first.reynolds],
        "parameters.test.reynolds": [],
        "rom.0.n_modes": 2,
        "rom.0.calibrated": "auto",  # so short a run has no period
        "compare.grid": 16,
    }
    if name == "wake":
        settings["scene.initial.u"] = 1  # there is no time for a ramp
    if name == "sloshing":
        settings["scene.measure"] = {}
    if name == "cylinder":
        options = [word for key in settings for word in ("--set", f"{key}={settings[key]}")]
        sphrom("run", path, *options, "--out", tmp_path, "--threads", 1, "--quiet", code=0)
    else:
        Study(path, out=tmp_path, set=settings, threads=1, quiet=True).run(until="rom")
    assert list(tmp_path.glob("rom-fast-*.h5"))
    assert bool(list(tmp_path.glob("plots/overview-*.png"))) == (name == "cylinder")


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) for name in FULL])
def test_a_full_run_of_a_surface_runs(sphrom, tmp_path, name):
    path, resolution = GALLERY / f"{name}.yaml", f"discretization.resolution={RESOLUTIONS[name]}"
    step = load_case(path, [resolution]).plan.steps.time_step
    options = ("--set", resolution, "--set", f"time.final_time={N_STEPS * step}")
    options += ("--set", "snapshots.every=1")
    sphrom("fom", path, *options, "--out", tmp_path, "--threads", 1, "--quiet", code=0)
