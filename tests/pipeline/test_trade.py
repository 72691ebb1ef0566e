from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import yaml

from sphrom.case.points import REYNOLDS
from sphrom.errors import UnstableError
from sphrom.models.stable_ranges import MEMORY, STEP, TIME
from sphrom.trade import extremes

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
    assert "online is the time of a run of 0.08 s" in words

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
def few(monkeypatch):
    """Few values in maps of the extremes, and no others of the full model but the given."""
    values = {STEP: (1.0, 40.0), MEMORY: (1.0, 1e3), TIME: (1.0, 2.0), REYNOLDS: (0.5, 1.0, 5.0)}
    for name in values:
        monkeypatch.setitem(extremes.FACTORS, name, values[name])
        monkeypatch.setitem(extremes.QUICK, name, values[name])

    def choose(**values: tuple[float, ...]) -> None:
        for name, (section, key, _) in extremes.FULL_MODEL.items():
            found = values.get(key, ())
            monkeypatch.setitem(extremes.FULL_MODEL, name, (section, key, found))

    return choose


def of(rows: list[dict[str, str]], **wanted: str) -> list[dict[str, str]]:
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def test_quick_maps_say_where_models_are_stable_and_right(sphrom, weigh, place, few):
    with_model()
    few()
    assert sphrom("operators", *options()).exit_code == 0
    before = written(place)
    words = weigh((), "--extremes", "--quick")
    rows = rows_of(place, "extremes")
    assert {row["varied"] for row in rows} == {STEP, MEMORY, REYNOLDS, TIME}
    assert {row["kind"] for row in rows} == {"full", "particles", "fast"}
    assert written(place) == before
    assert (place / "trade" / "extreme-16-reynolds1000-1" / "fom-reynolds1000.h5").exists()
    assert (place / "trade" / "extremes.png").stat().st_size > 10_000
    assert f"{len(rows)} runs: " in words
    assert "right means errors of at most" in words

    (own,) = of(rows, varied=STEP, value="1.0", n_modes="3", steps="exponential", kind="fast",
                projection="galerkin")  # fmt: skip
    assert own["state"] == "right"
    # No sound limits exponential steps; it does others, where the eigenvalue says so.
    steps = of(rows, varied=STEP, kind="fast")
    assert all(row["state"] != "unstable" for row in of(steps, steps="exponential"))
    for row in of(steps, steps="runge-kutta") + of(rows, varied=STEP, kind="full"):
        if row["state"] == "unstable":
            assert float(row["value"]) > float(row["predicted"])
            assert row["mechanism"] == "sound"
            assert "t = " in row["reason"]
    assert of(rows, varied=STEP, kind="full", state="unstable")
    # What is right is so by its errors, and what isn't says why.
    for row in of(rows, kind="fast"):
        errors = [row["velocity_error"], row["pressure_error"]]
        allowed = [2.0 * float(own[name]) for name in ("velocity_error", "pressure_error")]
        if all(errors):
            within = all(float(e) <= a for e, a in zip(errors, allowed, strict=True))
            assert (row["state"] == "right") == within
        assert (row["state"] == "right") or row["mechanism"]
        assert (row["extrapolated"] == "True") == bool(row["told"])


@pytest.mark.slow
def test_maps_of_the_full_model_and_of_one_training_run(sphrom, weigh, place, few):
    with_model()
    assert sphrom("operators", *options()).exit_code == 0
    few(mach_number=(0.05, 0.2), smoothing_length_ratio=(1.3, 4.0), resolution=(8, 12, 40))
    words = weigh((), "--extremes")
    rows = rows_of(place, "extremes")
    ratios = {
        float(row["memory_length"]) / float(row["value"])
        for row in of(rows, varied=MEMORY, n_modes="3")
    }
    assert max(ratios) == pytest.approx(min(ratios))
    for varied in ("Mach number", "h/dx", "resolution", "reynolds, one training run"):
        fast = of(rows, varied=varied, kind="fast")
        assert fast
        assert all(0.0 < float(row["velocity_error"]) < 20.0 for row in fast)
    # A finer full model than the case's is not made.
    assert {row["value"] for row in rows if row["varied"] == "resolution"} == {"8", "12"}
    # A kernel wider than the box is a state too, and stops nothing.
    (refused,) = of(rows, varied="h/dx", value="4.0")
    assert (refused["state"], refused["velocity_error"]) == ("refused", "")
    assert "a support of radius" in refused["reason"]
    assert "discretization.resolution: a support" in words


def test_an_unstable_full_run_is_a_state(weigh, place, few, monkeypatch):
    def explode(context: object) -> None:
        raise UnstableError("reynolds=100: it burst")

    few(mach_number=(0.2,))
    monkeypatch.setattr("sphrom.models.fom.run", explode)
    weigh((), "--extremes")
    rows = rows_of(place, "extremes")
    (lost,) = of(rows, varied="Mach number")
    assert (lost["state"], lost["reason"]) == ("unstable", "reynolds=100: it burst")
    # Where there is no full run to compare with, nothing says that a model is right.
    outside = of(rows, varied=REYNOLDS, value="50.0", kind="fast")
    assert {row["state"] for row in outside} == {"stable"}


def test_runs_comparisons_and_trades_read_the_maps(sphrom, weigh, place, few):
    with_model()
    assert sphrom("operators", *options()).exit_code == 0
    weigh((), "--extremes", "--quick")
    path = place / "trade" / "extremes.json"
    document = json.loads(path.read_text())
    for row in document["ranges"]:
        if (row["varied"], row["kind"]) == (REYNOLDS, "fast"):
            row |= {"right_from": 160.0, "right_to": 200.0, "below": "extrapolated modes"}
    path.write_text(json.dumps(document))
    span = "a reynolds from 160 to 200; beyond: extrapolated modes"
    said = f"according to its map it is right for {span}"
    rom = sphrom("rom", *options(), "--only", "fast").output
    assert f"fast, reynolds=150: {said}" in " ".join(rom.split())
    compared = sphrom("compare", *options(), "--force").output
    assert f"This run is doubtful: {said}" in " ".join(compared.split())
    assert "maps of extremes: right for a" in weigh((), "--tolerance", "90%,1000%")
    # Maps of another basis say nothing.
    document["about"]["basis"] = "another"
    path.write_text(json.dumps(document))
    assert "to its map" not in sphrom("rom", *options(), "--only", "fast", "--force").output
    path.write_text("{")
    assert sphrom("rom", *options(), "--only", "fast", "--force").exit_code == 3


ONE = "basis.subsets={one: {reynolds: [100]}}"


@pytest.mark.parametrize(
    ("keys", "others", "words"),
    [
        (("rom=[]",), (), "rom: the case has no reduced models"),
        ((), ("--tolerance", "1%", "--extremes"), "--tolerance: can't be combined with --extremes"),
        ((), ("--quick",), "--quick: needs --extremes"),
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
