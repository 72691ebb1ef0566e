"""Arguments of calls from Python: each wrong kind gives CaseError, in every public function."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import sphrom
from sphrom.errors import ArtifactError, CaseError

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity", "measure": {"drag": {"force_on": "top"}}},
    "discretization": {"resolution": 12},
    "time": {"final_time": 0.3},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}},
    "operators": {"error_estimate": False},
    "sweep": {"reynolds": [120]},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 2}],
}
HUGE = 10**400
NOTHING_VALID: tuple[Any, ...] = (
    [], [[]], [None], [1, "a"], {1: 2}, {None: 1}, 1j, b"b", object(), np.array(["a"]), ...,
    np.array([None] * 3), np.array([1 + 2j] * 3), np.array(["2020"], "M8[Y]"), [[1, 2], [3]],
    np.array([np.nan] * 3), [HUGE] * 3, np.ma.masked_all(3), slice(1), np.zeros((2, 0)),
)  # fmt: skip
"""Values that are valid for no argument."""
NUMBERS: tuple[Any, ...] = (np.nan, np.inf, -np.inf, HUGE, -HUGE, True, "a", "1", "")
WRONG: dict[str, tuple[Any, ...]] = {
    "number": NUMBERS,
    "text": (1.0, None, True, ("a",)),
    "flag": (None, 1, "true", np.nan),
    "path": (None, 1.0, "", "a\0b", "\ud800"),
    "array": (*NUMBERS, -1.0, 0, 1e308, np.zeros((3, 3)), [1e308, 1e308]),
}
"""Values that are wrong for arguments of a kind."""


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """An object of each public class."""
    out = tmp_path_factory.mktemp("arguments")
    study = sphrom.Study(CASE, out=out, threads=1, quiet=True)
    study.run(until="operators")
    model = study.model("fast", reynolds=150)
    run = model.run()
    columns = {"time": run.time[1:], "drag_force_x": run.measures.drag_force.values[1:, 0]}
    fit = model.fit(columns, noise="1%")
    slopes = model.sensitivities()
    return {"s": study, "m": model, "r": run, "d": slopes, "f": fit, "c": columns, "o": out}


A = np.zeros(2)
Call = Callable[[dict[str, Any], Any], object]
CALLS: dict[str, tuple[str, Call]] = {
    "Study case": ("path", lambda o, v: sphrom.Study(v)),
    "Study set": ("text", lambda o, v: sphrom.Study(CASE, set=v)),
    "Study set=value": ("text", lambda o, v: sphrom.Study(CASE, set={"scene.kind": v})),
    "Study out": ("path", lambda o, v: sphrom.Study(CASE, out=v)),
    "Study force": ("flag", lambda o, v: sphrom.Study(CASE, force=v)),
    "Study quiet": ("flag", lambda o, v: sphrom.Study(CASE, quiet=v)),
    "Study threads": ("number", lambda o, v: sphrom.Study(CASE, threads=v)),
    "Study report": ("text", lambda o, v: sphrom.Study(CASE, report=v)),
    "Study **": ("number", lambda o, v: sphrom.Study(CASE, resolution=v)),
    "Study.run until": ("text", lambda o, v: o["s"].run(until=v)),
    "Study.run resume": ("flag", lambda o, v: o["s"].run("fom", resume=v)),
    "Study.run checkpoint_every": ("number", lambda o, v: o["s"].run("fom", checkpoint_every=v)),
    "Study.run workers": ("number", lambda o, v: o["s"].run("fom", workers=v)),
    "Study.run scheduler": ("text", lambda o, v: o["s"].run("fom", scheduler=v)),
    "Study.run_stage stage": ("text", lambda o, v: o["s"].run_stage(v)),
    "Study.run_stage only": ("text", lambda o, v: o["s"].run_stage("fom", only=v)),
    "Study.run_stage resume": ("flag", lambda o, v: o["s"].run_stage("fom", resume=v)),
    "Study.run_stage every": ("number", lambda o, v: o["s"].run_stage("fom", checkpoint_every=v)),
    "Study.run_stage unknown": ("number", lambda o, v: o["s"].run_stage("fom", tolerance=v)),
    **{
        f"Study.run_stage {stage} {name}": (kind, lambda o, v, s=stage, n=name: _staged(o, v, s, n))
        for stage, name, kind in (
            ("fom", "workers", "number"), ("fom", "scheduler", "text"),
            ("trade", "tolerance", "text"), ("train", "tolerance", "text"),
            ("train", "budget", "number"), ("train", "workers", "number"),
            ("train", "write_case", "path"), ("sweep", "workers", "number"),
            ("sweep", "scheduler", "text"), ("sweep", "shard", "number"),
            ("sweep", "collect", "flag"), ("fit", "measurements", "path"),
            ("fit", "noise", "array"), ("fit", "name", "text"), ("export", "to", "text"),
            ("export", "into", "path"), ("export", "at", "text"),
            ("export", "columns", "number"),
        )
    },
    "Study.model name": ("text", lambda o, v: o["s"].model(v, reynolds=150)),
    "Study.model **": ("number", lambda o, v: o["s"].model("fast", reynolds=v)),
    "Study.model unknown": ("number", lambda o, v: o["s"].model("fast", speed=v)),
    "Model.at **": ("number", lambda o, v: o["m"].at(reynolds=v)),
    "Model.run final_time": ("number", lambda o, v: o["m"].run(v)),
    "Model.run_many": ("array", lambda o, v: o["m"].run_many(v)),
    "Model.run_many values": ("number", lambda o, v: o["m"].run_many({"reynolds": v})),
    "Model.run_many unknown": ("number", lambda o, v: o["m"].run_many({"speed": v})),
    "Model.sensitivities": ("text", lambda o, v: o["m"].sensitivities(v)),
    "Model.sensitivities final_time": ("number", lambda o, v: o["m"].sensitivities(final_time=v)),
    "Model.sensitivities step_factor": ("number", lambda o, v: o["m"].sensitivities(step_factor=v)),
    "Model.fit": ("path", lambda o, v: o["m"].fit(v)),
    "Model.fit columns": ("text", lambda o, v: o["m"].fit({**o["c"], "time": v})),
    "Model.fit unknown": ("text", lambda o, v: o["m"].fit({**o["c"], "speed": v})),
    "Model.fit names": ("text", lambda o, v: o["m"].fit(o["c"], v, noise="1%")),
    "Model.fit noise": ("array", lambda o, v: o["m"].fit(o["c"], noise=v)),
    **{
        f"Model.{name}": ("array", lambda o, v, n=name: getattr(o["m"], n)(v))
        for name in ("rates", "jacobian", "steady", "measures")
    },
    **{
        f"Model.{name} time": ("number", lambda o, v, n=name: getattr(o["m"], n)(A, v))
        for name in ("rates", "jacobian", "measures")
    },
    "Model.function inputs": ("text", lambda o, v: o["m"].function(v, ["drag_force_x"])),
    "Model.function outputs": ("text", lambda o, v: o["m"].function(["reynolds"], v)),
    "Model.function time": (
        "number", lambda o, v: o["m"].function(["reynolds"], ["drag_force_x"], v)
    ),
    "Function.jacobian": ("array", lambda o, v: _function(o).jacobian(v)),
    "Function()": ("array", lambda o, v: _function(o)(v)),
    "Result.fields": ("array", lambda o, v: o["r"].fields(v)),
    "Sensitivities.fields": ("array", lambda o, v: o["d"].fields(v)),
    "Fit[]": ("text", lambda o, v: o["f"][v]),
    "Fit.draw path": ("path", lambda o, v: o["f"].draw(v)),
    "Fit.draw place": ("text", lambda o, v: o["f"].draw(o["o"] / "x.png", v)),
    "open path": ("path", lambda o, v: sphrom.open(v)),
    "open group": ("text", lambda o, v: sphrom.open(o["o"] / "pod.h5", v)),
}  # fmt: skip
"""A call for each argument of the public functions."""


DEFAULTED = "set out report until budget write_case scheduler shard to into final_time time"
VALID = {
    **dict.fromkeys((*DEFAULTED.split(), "name", "fit", "collect"), ("None",)),
    **dict.fromkeys(("noise", "tolerance"), ("None", "'1'")),
    **dict.fromkeys(("only", "at"), ("None", "[]")),
    **dict.fromkeys(("threads", "workers"), ("None", repr(HUGE))),
    "place": ("True",),
}
"""Values that are defaults of an argument, or have a meaning, as Python writes them."""


def _function(objects: dict[str, Any]) -> sphrom.Function:
    model: sphrom.Model = objects["m"]
    return model.function(["reynolds"], ["drag_force_x"])


def _staged(objects: dict[str, Any], value: Any, stage: str, name: str) -> None:
    known = {"measurements": objects["c"]} if stage == "fit" else {}
    objects["s"].run_stage(stage, **{**known, name: value})


@pytest.mark.parametrize("name", CALLS)
def test_arguments_of_wrong_kinds(objects, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kind, call = CALLS[name]
    accepted, messages = [], []
    for value in (*NOTHING_VALID, *WRONG[kind]):
        if repr(value) in VALID.get(name.split()[-1], ()):
            continue
        try:
            call(objects, value)
            accepted.append(value)
        except (CaseError, ArtifactError) as error:
            messages.append(str(error))
    assert not accepted
    assert all(messages)
    assert not list(tmp_path.iterdir())


def test_every_public_function_is_tried():
    tried = {name.partition(" ")[0] for name in CALLS}
    results = (sphrom.Function, sphrom.Result, sphrom.Sensitivities, sphrom.Fit)
    for owner in (sphrom.Study, sphrom.Model, *results):
        for name, function in inspect.getmembers(owner, inspect.isfunction):
            own = function.__module__ == owner.__module__ and not name.startswith("_")
            if own and len(inspect.signature(function).parameters) > 1:
                assert f"{owner.__name__}.{name}" in tried


def test_paths_and_numbers_of_all_kinds_are_accepted(objects, tmp_path):
    objects["s"].run_stage("export", to="csv", at=["0.5,0.5"], into=str(tmp_path / "tables"))
    assert list((tmp_path / "tables").glob("*.csv"))
    for end in (0.3, np.float32(0.3), np.array(0.3)):
        assert len(objects["m"].run(float(f"{end:.3g}")).time) == len(objects["r"].time)
    assert objects["m"].run_many({"reynolds": np.array([120, 140], object)}).sizes["run"] == 2
