"""The estimated times of studies."""

from __future__ import annotations

import itertools
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from sphrom.case.models import Case
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds
from sphrom.stages import STUDIES, run_stage
from sphrom.study_times import times_of_study

FAST = {"name": "x", "evaluation": "operators", "n_modes": 3}


def context(**sections: object) -> StageContext:
    case = {"name": "x", "scene": {"kind": "taylor-green"}, "time": {"final_time": 1.0}}
    case |= {"discretization": {"resolution": 20}, "parameters": {"train": {"reynolds": [50, 100]}}}
    return StageContext(
        Case.model_validate(case | sections), Path("nowhere"), False, None, Mock(), workers=1
    )


def test_a_sweep_takes_the_time_of_its_runs_and_of_the_start_of_processes() -> None:
    alone = context(sweep={"reynolds": {"low": 50, "high": 100, "count": 16}}, rom=[])
    by_workers = {
        number: times_of_study(replace(alone, workers=number), "sweep", {})["sweep"]
        for number in (1, 4, 8)
    }
    for number, time in by_workers.items():
        assert time.items["sweep full"] == pytest.approx(16 * full_seconds(alone.case, 1) / number)
        assert time.seconds - time.uncounted == pytest.approx(time.items["sweep full"])
        assert time.at_once == number
    assert by_workers[1].uncounted < by_workers[4].uncounted
    half = times_of_study(alone, "sweep", {"shard": (1, 2)})["sweep"]
    assert half.items["sweep full"] == pytest.approx(by_workers[1].items["sweep full"] / 2)


def test_a_training_has_a_part_for_each_number_of_full_runs() -> None:
    """The first runs are certain, the others are made only until the model is good enough."""
    trained = context(training={"reynolds": [50, 100], "budget": 4}, rom=[FAST])
    parts = times_of_study(trained, "train", {})
    assert [*parts] == ["first full runs", *(f"model of {n} full runs" for n in (2, 3, 4))]
    assert [part.is_limit for part in parts.values()] == [False, True, True, True]
    longer = times_of_study(trained, "train", {"budget": 6})
    more = sum(part.seconds for part in longer.values()) - sum(p.seconds for p in parts.values())
    assert more > 2 * full_seconds(trained.case, 1)


def test_workers_that_python_asks_for_count(monkeypatch) -> None:
    estimated = []
    report = Mock()
    report.whole.side_effect = lambda times: nullcontext(estimated.append(times()) or report)
    report.stage.return_value = nullcontext()
    monkeypatch.setattr("sphrom.sweep.sweep.run", lambda context: context.workers)
    alone = replace(
        context(sweep={"reynolds": {"low": 50, "high": 100, "count": 16}}, rom=[]), report=report
    )
    assert run_stage("sweep", alone, workers=4) == 4
    assert [times["sweep"].at_once for times in estimated] == [4]


@pytest.mark.parametrize("stage", STUDIES)
def test_items_are_parts_of_the_time(stage: str) -> None:
    of_case = context(training={"reynolds": [50, 100]}, sweep={"reynolds": [60, 70]}, rom=[FAST])
    parts = times_of_study(of_case, stage, {})
    assert parts
    for part, item in itertools.product(parts.values(), (0, -1)):
        assert 0.0 <= part.uncounted <= part.seconds
        assert not part.items or [*part.items.values()][item] <= part.seconds
