"""What stages are said to need grows with what they hold, and room is asked for that alone."""

from __future__ import annotations

import shutil
import tracemalloc
from pathlib import Path

import pytest

from sphrom.case.loader import load_case
from sphrom.errors import ResourceError
from sphrom.setup import cost
from sphrom.setup.cost import needs, require_room


@pytest.fixture
def case(tmp_path, case_text):
    """The tiny case, with keys changed by `--set`."""

    def load(*overrides, **changes):
        path = tmp_path / "tiny.yaml"
        path.write_text(case_text(**changes))
        return load_case(path, overrides)

    return load


@pytest.fixture
def limits(monkeypatch):
    """Give the machine some memory and free disk [bytes]."""

    def limit(memory=10**15, free=10**15):
        monkeypatch.setattr(cost, "physical_ram", lambda: memory)
        usage = shutil._ntuple_diskusage(free, 0, free)
        monkeypatch.setattr(cost.shutil, "disk_usage", lambda folder: usage)

    return limit


@pytest.mark.parametrize("stage", ["fom", "map", "pod"])
def test_what_is_written_is_estimated_well(finished, stage):
    folder = finished[0]
    case = load_case(folder / "tiny.yaml")
    sizes = [
        path.stat().st_size - 20_000  # names, units, the case: what does not grow
        for pattern in needs(case)[stage].files
        for path in (folder / "runs" / "tiny").glob(pattern)
    ]
    needed = needs(case)[stage].disk
    assert sum(max(0, size) for size in sizes) < 1.2 * needed + 20_000
    assert needed < sum(sizes) + 30_000 * len(sizes)


def test_without_reduced_models_nothing_is_paid_for_them(case):
    assert set(needs(case(rom=[]))) == {"fom"}
    assert set(needs(case())) == {"fom", "map", "pod", "rom"}


def test_the_stage_that_needs_too_much_is_named(case, limits):
    limits(memory=300_000_000)
    hungry = case("snapshots.every=1", "discretization.resolution=800")
    with pytest.raises(ResourceError, match=r"memory in fom, .*: lower discretization"):
        require_room(hungry, Path("runs"))
    require_room(hungry, Path("runs"), stage="map")


def test_some_points_need_room_for_themselves_only(case, limits, tmp_path):
    tiny = case()
    need = needs(tiny, tiny.plan.points[:1])["fom"]
    one = need.disk
    assert one < needs(tiny)["fom"].disk
    limits(free=one + need.passing - 1)
    with pytest.raises(ResourceError, match="the disk of"):  # for checkpoints while it lasts
        require_room(tiny, tmp_path, tiny.plan.points[:1])
    limits(free=one + need.passing)
    require_room(tiny, tmp_path, tiny.plan.points[:1])
    for points in (None, tiny.plan.points, tiny.plan.points[:2]):
        with pytest.raises(ResourceError, match="the disk of"):
            require_room(tiny, tmp_path, points)


def test_what_is_there_needs_no_room_again(finished, limits):
    folder = finished[0]
    case = load_case(folder / "tiny.yaml")
    limits(free=0)
    require_room(case, folder / "runs" / "tiny", case.plan.points[:1])
    with pytest.raises(ResourceError):
        require_room(case, folder, case.plan.points[:1])


@pytest.mark.slow
def test_the_memory_that_is_estimated_is_taken(finished, tmp_path, case_text, sphrom):
    """Growth from one size to another, estimated over measured: 0.5 (operators) to 2.1 (fom).

    Between two sizes, all else cancels; `finished` has loaded the modules that are loaded late.
    """
    rom = [{"name": "fast", "n_modes": 3, "evaluation": "operators"}]
    rom.append({"name": "slow", "n_modes": 3})
    peaks: dict[str, list[int]] = {}
    estimates: dict[str, list[int]] = {}
    for size in (24, 40):
        path = tmp_path / f"{size}.yaml"
        path.write_text(
            case_text(
                discretization__resolution=size,
                time={"final_time": 0.02, "step": 0.002},
                snapshots={"every": 1},
                parameters={"train": {"reynolds": [100]}, "test": {"reynolds": []}},
                rom=rom,
                compare__grid=2 * size,
            )
        )
        for stage in ("fom", "map", "pod", "fit-psi", "operators"):
            tracemalloc.start()
            out = ("--out", tmp_path / str(size), "--quiet", "--threads", 1)
            sphrom(stage, path, *out, code=0)
            peaks.setdefault(stage, []).append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
            if stage in ("fom", "pod", "operators"):
                estimates.setdefault(stage, []).append(needs(load_case(path))[stage].ram)
    for stage, (small, large) in estimates.items():
        measured = peaks[stage][1] - peaks[stage][0]
        assert 0.25 < (large - small) / measured < 4.0, stage
