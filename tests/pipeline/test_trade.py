from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import yaml

from sphrom.artifacts import open_artifact

FEW = ("trade.repeats=1", "trade.n_modes=[2,3]", "trade.resolutions=[12,16]", "compare.plots=false")
REFERENCE = {"name": "fast", "frame": "reference", "n_modes": 3}


def options(*overrides: str) -> list[str]:
    settings = [f"--set={override}" for override in (*FEW, *overrides)]
    return ["tiny.yaml", "--threads", "1", *settings]


def rows_of(place: Path, name: str = "models") -> list[dict[str, str]]:
    with (place / "trade" / f"{name}.csv").open(newline="") as file:
        return [{k.partition(" ")[0]: v for k, v in row.items()} for row in csv.DictReader(file)]


def one_line(text: str) -> str:
    return " ".join(text.split())


def test_models_are_weighed(sphrom, place):
    result = sphrom("trade", *options(), "--tolerance", "90%,1000%")
    assert result.exit_code == 0, result.output
    rows = rows_of(place)
    full = [row for row in rows if row["kind"] == "full"]
    reduced = [row for row in rows if row["kind"] == "reference"]
    assert len(rows) == len(full) + len(reduced)
    assert {row["n_modes"] for row in reduced} == {"2", "3"}
    assert {row["resolution"] for row in full} == {"12", "16"}
    assert len({(row["resolution"], row["time_step"]) for row in full}) == len(full)

    own = full[0]
    assert (own["model"], float(own["velocity_line_peak"])) == ("full, as in the case", 0.0)
    assert float(own["speed_up"]) == 1.0
    for row in full[1:]:
        assert 0.0 < float(row["velocity_line_mean"]) <= float(row["velocity_line_peak"]) < 100.0
        assert row["break_even_runs"] == ""
    for row in reduced:
        assert row["stable"] == "True"
        assert 0.0 < float(row["velocity_field_mean"]) < 50.0
        assert float(row["training_seconds"]) < float(row["offline_seconds"])
        assert float(row["speed_up"]) > 10.0
        gain = float(row["speed_up"]) / float(row["speed_up_largest_step"])
        assert gain >= 1.0
        assert row["break_even_runs"] == "" or int(row["break_even_runs"]) >= 1
    fastest = min(rows, key=lambda row: float(row["online_seconds"]))
    assert (fastest["velocity_front"], fastest["pressure_front"]) == ("True", "True")

    runs = rows_of(place, "runs")
    assert {row["parameters"] for row in runs} == {"reynolds=150"}
    assert {row["role"] for row in runs} == {"full", "predicted"}
    stored = json.loads((place / "trade" / "trade.json").read_text())
    assert [row["model"] for row in stored["models"]] == [row["model"] for row in rows]
    (advice,) = stored["recommendation"]
    assert advice["model"] == fastest["model"]
    assert f"the cheapest is {fastest['model']}:" in one_line(result.stdout)
    assert (place / "trade" / "trade.png").stat().st_size > 10_000


def test_further_full_runs_are_kept(sphrom, place):
    assert sphrom("trade", *options()).exit_code == 0
    found = sorted((place / "trade").glob("full-*/fom-reynolds150.h5"))
    assert found
    identities = {}
    for path in found:
        with open_artifact(path, "sphrom/trajectory", made_by="") as artifact:
            identities[path] = artifact.identity
            assert len(artifact.dataset("time")) == 6
    again = sphrom("trade", *options("trade.n_modes=[2]"))
    assert again.exit_code == 0, again.output
    for path in found:
        with open_artifact(path, "sphrom/trajectory", made_by="") as artifact:
            assert artifact.identity == identities[path]
    assert {row["n_modes"] for row in rows_of(place)} == {"", "2"}


def test_particles_and_training_values_if_listed(sphrom, place):
    result = sphrom(
        "trade",
        *options(
            "trade.frames=[particles]", "trade.projections=[galerkin,apg]", "trade.n_modes=[2]",
            "trade.step_factors=[1]", "trade.courant_numbers=[]", "trade.parameters=[100]",
        ),
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    reduced = [row for row in rows_of(place) if row["kind"] == "particles"]
    assert [row["projection"] for row in reduced] == ["galerkin", "apg"]
    assert all(0.0 < float(row["velocity_line_mean"]) < 50.0 for row in reduced)
    assert {row["role"] for row in rows_of(place, "runs")} == {"trained"}
    assert not (place / "operators.h5").exists()


def test_no_model_within_a_tolerance_is_said(sphrom, place):
    result = sphrom("trade", *options("trade.courant_numbers=[]"), "--tolerance", "1e-9%")
    assert result.exit_code == 0
    assert "no model is within 1e-09 %" in one_line(result.stdout)
    stored = json.loads((place / "trade" / "trade.json").read_text())
    assert stored["recommendation"][0]["model"] is None


def test_extremes(sphrom, place):
    few = "trade.extremes={n_modes: [2, 3], step_factors: [0.5, 4], reynolds_factors: [0.1, 1]}"
    result = sphrom("trade", *options(few, "snapshots.every=2"), "--extremes")
    assert result.exit_code == 0, result.output
    rows = rows_of(place, "extremes")
    assert len(rows) == 8
    assert {row["parameters"] for row in rows} == {"reynolds=10", "reynolds=200"}
    assert {row["state"] for row in rows} <= {"stable", "inaccurate", "unstable"}
    small = [row for row in rows if float(row["step_factor"]) < 1.0]
    assert all(row["state"] != "unstable" for row in small)
    compared = {row["parameters"]: row["compared_with"] for row in rows}
    assert compared == {"reynolds=10": "full run, 8 across", "reynolds=200": "full run"}
    assert "Mach number" in result.stdout
    assert (place / "trade" / "extremes.png").stat().st_size > 10_000
    assert (place / "trade" / "extreme-8-reynolds10" / "fom-reynolds10.h5").exists()


def test_a_missing_artifact_names_its_command(sphrom, place):
    (place / "psi.h5").unlink()
    result = sphrom("trade", *options())
    assert result.exit_code == 3
    assert "psi.h5 is missing; make it with `sphrom fit-psi CASE`" in result.stderr


def test_missing_operators_name_their_command(sphrom, place):
    case = yaml.safe_load(Path("tiny.yaml").read_text())
    case["rom"].append(REFERENCE)
    Path("tiny.yaml").write_text(yaml.safe_dump(case))
    result = sphrom("trade", *options())
    assert result.exit_code == 3
    assert "operators.h5 is missing; make it with `sphrom operators CASE`" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--set=rom=[]",), "error: rom: the case has no reduced models"),
        (("--tolerance", "none"), "error: --tolerance: must be a percentage above zero"),
        (("--tolerance", "1%", "--extremes"), "error: --tolerance: is not for --extremes"),
        (("--set=trade.frames=[particles]", "--extremes"), "error: trade.frames: stability"),
    ],
)
def test_refusals(sphrom, place, arguments, words):
    result = sphrom("trade", *options("trade.n_modes=null"), *arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(words)
    assert not (place / "trade").exists()


def test_closures_that_the_case_has_are_weighed(sphrom, place):
    case = yaml.safe_load(Path("tiny.yaml").read_text())
    closed = {**REFERENCE, "name": "closed", "projection": "apg", "n_modes": 2}
    case["rom"] += [REFERENCE, closed]
    Path("tiny.yaml").write_text(yaml.safe_dump(case))
    assert sphrom("operators", *options()).exit_code == 0
    few = ("trade.n_modes=null", "trade.courant_numbers=[]", "trade.step_factors=[1]")
    result = sphrom("trade", *options(*few))
    assert result.exit_code == 0, result.output
    reduced = [(r["projection"], r["n_modes"]) for r in rows_of(place) if r["kind"] != "full"]
    assert reduced == [("galerkin", "2"), ("galerkin", "3"), ("apg", "2")]


def test_closures_that_have_no_operators_are_refused(sphrom, place):
    case = yaml.safe_load(Path("tiny.yaml").read_text())
    case["rom"].append(REFERENCE)
    Path("tiny.yaml").write_text(yaml.safe_dump(case))
    result = sphrom("trade", *options("trade.projections=[apg]"))
    assert result.exit_code == 2
    assert "there is none with 2, 3" in result.stderr
