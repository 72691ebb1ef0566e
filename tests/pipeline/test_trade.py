from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from sphrom.errors import UnstableError
from sphrom.trade import candidates, extremes

FEW = ("trade.repeats=1", "trade.n_modes=[2,3]", "trade.resolutions=[12,16]", "compare.plots=false")
REFERENCE = {"name": "fast", "evaluation": "operators", "n_modes": 3}


def options(*overrides: str) -> list[str]:
    settings = [f"--set={override}" for override in (*FEW, *overrides)]
    return ["tiny.yaml", "--threads", "1", *settings]


def rows_of(place: Path, name: str = "models") -> list[dict[str, str]]:
    with (place / "trade" / f"{name}.csv").open(newline="") as file:
        return [{k.partition(" ")[0]: v for k, v in row.items()} for row in csv.DictReader(file)]


def with_model(**keys: object) -> None:
    case = yaml.safe_load(Path("tiny.yaml").read_text())
    case["rom"].append({**REFERENCE, **keys})
    Path("tiny.yaml").write_text(yaml.safe_dump(case))


def written(place: Path, pattern: str = "*.h5") -> dict[Path, int]:
    """Return when files were written."""
    return {path: path.stat().st_mtime_ns for path in place.glob(pattern)}


@pytest.fixture
def weigh(sphrom):
    """Weigh the models of a case with some keys, and return the words in one line."""

    def command(keys: tuple[str, ...] = (), *arguments: str) -> str:
        result = sphrom("trade", *options(*keys), *arguments)
        assert result.exit_code == 0, result.output
        return " ".join(result.stdout.split())

    return command


def test_models_are_weighed(weigh, place):
    """Measured: reduced runs off by 1.0 % at most."""
    words = weigh((), "--tolerance", "90%,1000%")
    rows = rows_of(place)
    own, *full = [row for row in rows if row["kind"] == "full"]
    reduced = [row for row in rows if row["kind"] == "operators"]
    assert {(row["family"], row["n_modes"]) for row in reduced} == {
        (family, n_modes) for family in ("Galerkin", "APG") for n_modes in "23"
    }
    assert (place / "trade" / "operators.h5").exists()
    assert not (place / "operators.h5").exists()
    assert {"APG, M = 2", "Galerkin, M = 3"} <= {row["model"] for row in reduced}
    assert {row["resolution"] for row in full} == {"12", "16"}
    assert len({(row["resolution"], row["time_step"]) for row in full}) == len(full)
    assert (own["model"], own["velocity_line_relative_l2_peak"]) == ("full, as in the case", "0.0")
    assert all(0.0 < float(row["velocity_field_relative_l2"]) < 12.0 for row in full)
    for row in reduced:
        assert row["stable"] == "True"
        assert 0.0 < float(row["velocity_field_relative_l2"]) < 2.2
        assert float(row["training_seconds"]) < float(row["offline_seconds"])
        gain = float(own["online_seconds"]) / float(row["online_seconds"])
        assert float(row["speed_up"]) == pytest.approx(gain, rel=1e-6)
    fastest = min(rows, key=lambda row: float(row["online_seconds"]))
    assert (fastest["velocity_front"], fastest["pressure_front"]) == ("True", "True")
    assert "online is a run of 0.08 s" in words

    runs = rows_of(place, "runs")
    assert {row["parameters"] for row in runs} == {"reynolds=150"}
    assert {row["role"] for row in runs} == {"full", "predicted"}
    stored = json.loads((place / "trade" / "trade.json").read_text())
    assert [row["model"] for row in stored["models"]] == [row["model"] for row in rows]
    # In so short a run few modes are no better than a flow that doesn't change.
    assert len(stored["doing_nothing"]) == 3
    free = [row for row in stored["models"][1:] if row["beaten_by"] is None and row["keys"]]
    (chosen,) = (r for r in free if r["model"] == stored["recommendation"][0]["model"])
    assert chosen["online_seconds"] <= 1.1 * min(row["online_seconds"] for row in free)
    assert f"`- {chosen['keys']}` under `rom`" in words
    assert (place / "trade" / "trade.png").stat().st_size > 10_000


def test_further_full_runs_are_kept(weigh, place):
    weigh()
    before = written(place / "trade", "full-*/fom-reynolds150.h5")
    assert before
    weigh(("trade.n_modes=[2]",))
    assert written(place / "trade", "full-*/fom-reynolds150.h5") == before
    assert {row["n_modes"] for row in rows_of(place)} == {"", "2"}


@pytest.fixture
def vary(monkeypatch):
    """Choose the values that are varied; by default steps alone, at the greatest trained value."""

    def choose(reynolds: tuple[float, ...] = (1.0,), **changes: tuple[float, ...]) -> None:
        monkeypatch.setattr(candidates, "REYNOLDS_FACTORS", reynolds)
        for name, axis in extremes.AXES.items():
            default = () if axis.of_full_model else axis.values
            values = changes.get(name.split()[0].replace("/", "_"), default)
            monkeypatch.setitem(extremes.AXES, name, replace(axis, values=values))

    return choose


def of(rows: list[dict[str, str]], varied: str) -> list[dict[str, str]]:
    return [row for row in rows if row["varied"] == varied]


def test_extremes(weigh, place, vary):
    vary((0.1, 1.0), memory=())
    weigh((), "--extremes")
    rows = rows_of(place, "extremes")
    assert {row["varied"] for row in rows} == {"time step"}
    assert len(rows) == 2 * 2 * 8
    assert {row["parameters"] for row in rows} == {"reynolds=10", "reynolds=200"}
    assert {row["state"] for row in rows} <= {"stable", "inaccurate", "unstable"}
    small = [row for row in rows if float(row["step_factor"]) < 0.95]
    assert len(small) >= 12
    assert all(row["state"] != "unstable" for row in small)
    compared = {row["parameters"]: row["compared_with"] for row in rows}
    assert compared == {"reynolds=10": "full run, 8 across", "reynolds=200": "full run"}
    assert (place / "trade" / "extremes.png").stat().st_size > 10_000
    assert (place / "trade" / "extreme-8-reynolds10" / "fom-reynolds10.h5").exists()


@pytest.mark.slow
def test_extremes_of_memory_and_of_the_full_model(weigh, place, vary):
    vary(Mach=(0.05, 0.2), h_dx=(1.3, 4.0))
    before = written(place)
    words = weigh((), "--extremes")
    rows = rows_of(place, "extremes")
    steps, memories, mach, smoothing = (of(rows, name) for name in extremes.AXES)
    assert [len(some) for some in (steps, memories, mach, smoothing)] == [16, 18, 4, 4]

    assert {row["projection"] for row in memories} == {"apg"}
    ratios = [float(row["memory_length"]) / float(row["value"]) for row in memories[:9]]
    assert ratios == pytest.approx([ratios[0]] * 9)
    for row in (*memories[:5], *mach, *smoothing[:2]):
        assert row["state"] == "stable"
        assert 0.0 < float(row["velocity_error"]) < 10.0
        assert float(row["time_step"]) > 0.0
    assert len({row["velocity_error"] for row in mach}) == 4

    # A kernel wider than the box is a state too, and stops nothing.
    for row in smoothing[2:]:
        assert (row["state"], row["velocity_error"], row["time_step"]) == ("refused", "", "")
        assert "a support of radius" in row["detail"]
    assert "h/dx 4, refused: discretization.smoothing_length_ratio: a support of" in words
    assert {row["compared_with"] for row in (*mach, *smoothing[:2])} == {"full run, 8 across"}
    assert written(place) == before


def test_an_unstable_full_run_is_a_state(weigh, place, vary, monkeypatch):
    def explode(context: object) -> None:
        raise UnstableError("reynolds=100: it burst")

    monkeypatch.setattr("sphrom.offline.fom.run", explode)
    vary(Mach=(0.2,), memory=())
    words = weigh((), "--extremes")
    lost = of(rows_of(place, "extremes"), "Mach number")
    assert [row["state"] for row in lost] == ["full unstable"] * 2
    assert "Mach number 0.2, full unstable: reynolds=100: it burst" in words


@pytest.mark.parametrize("only", ["full_runs", "value"])
def test_the_full_model_is_varied_only_where_it_may_run(weigh, place, vary, only):
    vary((0.5, 1.0), Mach=(0.2,), memory=())
    if only == "full_runs":
        words = weigh(("trade.full_runs=false",), "--extremes")
    else:
        words = weigh((), "--extremes", "--only", "reynolds=50")
    assert {row["varied"] for row in rows_of(place, "extremes")} == {"time step"}
    assert ("trade.full_runs: false, Mach" in words) == (only == "full_runs")


@pytest.mark.slow
def test_extremes_are_of_calibrated_models_where_the_case_has_some(sphrom, weigh, place, vary):
    with_model(calibrated=True)
    vary(Mach=(0.2,))
    few = ("snapshots.every=1", "trade.n_modes=[2]")
    assert sphrom("run", *options(*few), "--force").exit_code == 0
    weigh(few, "--extremes")
    found = {(row["varied"], row["calibrated"]) for row in rows_of(place, "extremes")}
    assert found == {("time step", "True"), ("memory length", "False"), ("Mach number", "True")}


ONE = "basis.subsets={one: {reynolds: [100]}}"


@pytest.mark.parametrize(
    ("keys", "others", "words"),
    [
        (("rom=[]",), (), "rom: the case has no reduced models"),
        ((), ("--tolerance", "1%", "--extremes"), "--tolerance: is not for --extremes"),
        ((ONE, "basis.n_modes=8", "trade.n_modes=[8]", "rom.0.basis=one", "rom.0.n_modes=6"), (),
         "trade.n_modes: the basis one has 6 modes; got 8"),
    ],
)  # fmt: skip
def test_refusals(sphrom, place, keys, others, words):
    result = sphrom("trade", *options("trade.n_modes=null", *keys), *others)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: {words}")
    assert not (place / "trade").exists()


def test_operators_of_the_case_serve_where_they_are_enough(sphrom, weigh, place):
    with_model(name="closed", projection="apg", n_modes=2)
    assert sphrom("operators", *options()).exit_code == 0
    few = ("trade.full_runs=false", "trade.n_modes=[2]")
    weigh(few)
    assert not (place / "trade" / "operators.h5").exists()
    galerkin, apg = rows_of(place)[1:]
    assert float(galerkin["offline_seconds"]) < float(apg["offline_seconds"])
    weigh((*few, "trade.n_modes=null"))
    assert {row["n_modes"] for row in rows_of(place)[1:]} == {"2", "3"}
    assert (place / "trade" / "operators.h5").exists()
