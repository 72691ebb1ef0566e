"""`sphrom run`, and the stages one by one, when all is well."""

from __future__ import annotations

import json

import pytest

from sphrom.artifacts import open_artifact
from sphrom.case.scenes import DEFAULTS

STAGES = ("fom", "map", "pod", "fit-psi", "rom", "compare")


def test_run_makes_every_artifact(finished, digests, made_by):
    folder = finished[0] / "runs" / "tiny"
    assert set(digests(folder)) == set(made_by)
    assert not list(folder.rglob(".*"))
    for name, (schema, stage) in made_by.items():
        with open_artifact(folder / name, f"sphrom/{schema}", made_by=stage) as artifact:
            assert artifact.text("stage") == stage
            assert artifact.number("wall_seconds") > 0.0
            assert "name: tiny\n" in artifact.case_text


def test_run_tells_errors_that_are_small(finished, peaks, errors_of):
    folder, result = finished
    out = folder / "runs" / "tiny"
    for model in ("galerkin", "apg"):
        velocity, pressure = peaks(out, model)
        assert 0.0 < velocity < 2.0
        assert 0.0 < pressure < 12.0
    (full,) = [
        row
        for row in errors_of(out)
        if (row["compared"], row["against"], row["parameters"]) == ("full", "exact", "reynolds=150")
    ]
    assert 0.0 < float(full["velocity_field_relative_l2_peak"]) < 4.0
    predicted = {row["parameters"] for row in errors_of(out) if row["role"] == "predicted"}
    assert predicted == {"reynolds=150"}
    lines = result.stdout.splitlines()
    assert "compression factor" not in result.stdout  # tables are for --verbose, and in files
    answer = next(n for n, line in enumerate(lines) if line.startswith("At reynolds=150, which"))
    assert len(lines) - answer <= 10
    assert "galerkin (3 modes) differs from the full run" in " ".join(lines[answer:])
    log = (out / "sphrom.log").read_text()
    assert "compression factor" in log
    assert all(line in log for line in lines)


def test_run_writes_tables(finished):
    out = finished[0] / "runs" / "tiny"
    figures = json.loads((out / "compare.json").read_text())
    assert len(figures["timings"]) == 6
    assert all(0.9 < row["ratio"] < 1.05 for row in figures["decay"])
    shares = [row["share"] for row in figures["singular_values"]]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(100.0)
    tables = {path.stem for path in (out / "tables").glob("*.csv")}
    assert tables == {"errors", "timings", "decay", "singular_values", "stages"}


def test_a_second_run_keeps_everything_and_says_so(place, sphrom, made_by):
    stamps = {path: path.stat().st_mtime_ns for path in place.glob("*.h5")}
    result = sphrom("run", "tiny.yaml", "--verbose", code=0)
    for name in set(made_by) - {"packing.h5"}:
        assert f"{name}: up to date, kept\n" in result.stdout
    assert stamps == {path: path.stat().st_mtime_ns for path in place.glob("*.h5")}


def test_stages_alone_on_two_threads_make_the_same_to_the_bit(empty, sphrom, finished, digests):
    for stage in STAGES:
        sphrom(stage, "tiny.yaml", "--threads", 2, code=0)
    assert digests(empty) == digests(finished[0] / "runs" / "tiny")


def test_a_changed_model_remakes_what_depends_on_it(place, sphrom, refused, digests):
    change = ("--set", "rom.1.n_modes=2")
    before = digests(place)
    assert "rom[1].n_modes is 3 there, 2 here" in refused("run", "tiny.yaml", *change)
    assert digests(place) == before
    made = sphrom("run", "tiny.yaml", *change, "--force", "--threads", 1, code=0)
    after = digests(place)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {*(f"rom-apg-reynolds{re}.h5" for re in (100, 150, 200)), "compare.h5"}
    assert "rom-apg-reynolds100.h5: made again, because it was made with" in made.stdout
    assert made.stdout.count("made again") == 1


def test_a_run_is_refused_before_anything_is_computed(place, refused, digests):
    before = digests(place)
    line = refused("run", "tiny.yaml", "--set", "parameters.train.reynolds=[100, 120, 200]")
    assert "reynolds is [100, 200] there, [100, 120, 200] here" in line
    assert digests(place) == before


def test_only_one_value(empty, sphrom, refused):
    one = ("tiny.yaml", "--threads", 1, "--only", "reynolds=100")
    for stage in ("fom", "map"):
        sphrom(stage, *one, code=0)
    made = {path.name for path in empty.glob("*.h5")}
    assert made == {"packing.h5", "fom-reynolds100.h5", "map-reynolds100.h5"}
    assert f"{empty}/map-reynolds200.h5 is missing" in refused("pod", "tiny.yaml")


@pytest.mark.parametrize("kind", DEFAULTS)
def test_every_kind_of_scene_can_be_started_from(tmp_path, monkeypatch, sphrom, kind):
    monkeypatch.chdir(tmp_path)
    described = " ".join(sphrom("case", "new", "--help").stdout.split())
    assert kind in described.partition("Arguments:")[2]
    sphrom("case", "new", kind, "-o", "mine.yaml", code=0)
    result = sphrom("case", "check", "mine.yaml")
    assert (result.exit_code, result.stderr) == (0, "")
    assert ("no particles resolve" in result.stdout.replace("\n", " ")) == (kind == "open-cavity")
    assert "3 full runs and 3 reduced runs: about " in result.stdout


def test_what_is_kept_needs_no_kernels(place, printed) -> None:
    """Loading the compiler takes longer than all the rest."""
    code = (
        "import sys; from sphrom.cli.app import app; "
        "app(['rom', 'tiny.yaml'], standalone_mode=False); print('numba' in sys.modules)"
    )
    text = printed(code)
    assert text.count("kept") == 6
    assert text.endswith("\nFalse\n")
