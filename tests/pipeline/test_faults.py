"""What is missing, damaged, foreign or changed is refused in one line that says what to do."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

NOBODY = 65534


def missing(command):
    """Return what is said of a missing artifact: how to make it, and all others that are."""
    return (
        f"is missing; make it with `sphrom {command} tiny.yaml`, or everything that is missing "
        "with `sphrom run tiny.yaml`"
    )


def remove(folder, pattern):
    for path in folder.glob(pattern):
        path.unlink()


def test_a_stage_out_of_order(empty, refused):
    for stage, name, command in (("rom", "pod", "pod"), ("compare", "fom-reynolds100", "fom")):
        line = refused(stage, "tiny.yaml")
        assert line == f"error: {empty}/{name}.h5 {missing(command)}"
    assert not empty.exists()


@pytest.mark.parametrize(
    ("stage", "results", "name", "command", "damage"),
    [
        ("map", "map-*.h5", "fom-reynolds100.h5", "fom", lambda path: os.truncate(path, 9_000)),
        ("pod", "pod.h5", "map-reynolds100.h5", "map", Path.unlink),
        ("fit-psi", "psi.h5", "pod.h5", "pod", lambda path: os.truncate(path, 0)),
        ("rom", "rom-*.h5", "psi.h5", "fit-psi", lambda path: path.write_text("not HDF5 at all")),
        ("compare", "compare.*", "rom-galerkin-reynolds100.h5", "rom", Path.unlink),
    ],
)
def test_an_input_is_missing_or_damaged(place, refused, stage, results, name, command, damage):
    """The file can't be done without; the command makes it."""
    remove(place, results)
    damage(place / name)
    before = sorted(place.iterdir())
    line = refused(stage, "tiny.yaml")
    if damage is Path.unlink:
        assert line == f"error: {place}/{name} {missing(command)}"
    else:
        assert line.startswith(f"error: {place}/{name} is ")
        assert (
            f"; make it with `sphrom {command} tiny.yaml --force`, or everything that is out"
            in line
        )
    assert sorted(place.iterdir()) == before


def test_run_with_force_makes_a_damaged_artifact_anew(place, sphrom, refused, flip, digests):
    before = digests(place)
    damaged = place / "rom-galerkin-reynolds150.h5"
    flip(damaged)
    line = refused("run", "tiny.yaml")
    assert line.startswith(f"error: {damaged} is damaged")
    result = sphrom("run", "tiny.yaml", "--force", "--threads", 1, "--verbose", code=0)
    assert f"{damaged.name}: made again, because it is damaged" in result.stdout
    assert "fom-reynolds100.h5: up to date, kept" in result.stdout
    assert result.stdout.count("wrote ") == 1  # what is compared has not changed
    assert digests(place) == before


def test_an_artifact_of_another_case(place, refused):
    other = ("--set", "discretization.resolution=18")
    for stage in ("run", "fom", "map", "pod", "fit-psi", "rom", "compare"):
        line = refused(stage, "tiny.yaml", *other)
        assert "discretization.resolution is 16 there, 18 here" in line
        assert line.startswith(f"error: {place}/packing.h5 was made with another case")


def test_run_with_force_takes_a_folder_over(place, sphrom, digests):
    other = ("--set", "discretization.resolution=18", "--set", "rom=[]", "--threads", 1)
    before = digests(place)
    sphrom("run", "tiny.yaml", *other, "--force", code=0)
    after = digests(place)
    made = {"packing.h5", *(f"fom-reynolds{re}.h5" for re in (100, 150, 200)), "compare.h5"}
    assert {name for name in before if before[name] != after[name]} == made
    again = sphrom("run", "tiny.yaml", *other, "--verbose")
    assert (again.exit_code, again.stdout.count("kept")) == (0, 4)


ELSEWHERE = ("name=other", "compare.grid=13", "trade.repeats=1", "sweep.reynolds=[110]")
MODELS = ("rom.0.n_modes=2", "rom.1.n_modes=2", "parameters.test.reynolds=[160]", "basis.n_modes=2")


@pytest.mark.parametrize(
    ("stage", "changes", "differs"),
    [
        (("fom", "--only=reynolds=100"), ("time.final_time=0.16", *MODELS),
         "time.final_time is 0.08 there, 0.16 here"),
        (("fom", "--only=reynolds=100"), ("parameters.test.reynolds=[0.5]",),
         "the step is 0.008 s there, 0.000487805 s here: it depends on the lowest Reynolds number "
         "of all points, and on their speeds"),
        (("fit-psi",), ("psi.order=5", "psi.polynomial_degree=2"),
         "psi.order is 3 there, 5 here; psi.polynomial_degree is 1 there, 2 here"),
        (("pod",), ("parameters.train.reynolds=[200, 100]",),
         "parameters.train.reynolds is [100, 200] there, [200, 100] here"),
        (("rom", "--only=reynolds=100"), ("rom.0.memory_length=1e-4", "rom.0.projection=apg"),
         "rom[0].projection is galerkin there, apg here; "
         "rom[0].memory_length is auto there, 0.0001 here"),
    ],
)  # fmt: skip
def test_only_what_matters_is_said_to_differ(place, refused, stage, changes, differs):
    settings = [part for change in (*ELSEWHERE, *changes) for part in ("--set", change)]
    line = refused(stage[0], "tiny.yaml", *settings, "--out", place, *stage[1:])
    assert f"was made with another case ({differs}); `--force` makes it again" in line


def test_a_file_under_another_name(place, refused):
    shutil.copy(place / "map-reynolds200.h5", place / "map-reynolds100.h5")
    remove(place, "pod.h5")
    line = refused("pod", "tiny.yaml")
    assert line.startswith(f"error: {place}/map-reynolds100.h5 was made with")
    shutil.copy(place / "fom-reynolds100.h5", place / "psi.h5")
    assert "holds 'sphrom/trajectory', not 'sphrom/spline'" in refused("fit-psi", "tiny.yaml")


def test_a_changed_parent(place, sphrom, refused):
    sphrom("pod", "tiny.yaml", "--set", "basis.n_modes=4", "--force", "--threads", 1, code=0)
    line = refused("fit-psi", "tiny.yaml", "--set", "basis.n_modes=4")
    assert line.startswith(f"error: {place}/psi.h5 was made ")
    assert "basis.n_modes is " in line


def test_large_files_may_go_once_they_are_used(place, sphrom, refused):
    for pattern in ("fom-*", "packing.h5", "rom-*", "compare.h5"):
        remove(place, pattern)
    for stage in ("map", "pod", "fit-psi"):
        assert "kept" in sphrom(stage, "tiny.yaml", code=0).stdout
    assert "make it with `sphrom fom tiny.yaml`" in refused("compare", "tiny.yaml")


def test_what_is_made_again_to_the_bit_changes_nothing(place, sphrom, digests):
    before = digests(place)
    for name in ("packing.h5", "fom-reynolds100.h5"):
        (place / name).unlink()
    result = sphrom("run", "tiny.yaml", "--threads", 1, "--verbose", code=0)
    assert result.stdout.count("wrote ") == 2
    assert digests(place) == before


@pytest.mark.parametrize("content", [None, "", '{"errors": [{}]}'])
def test_a_damaged_summary_is_told(place, refused, content):
    summary = place / "compare.json"
    if content is None:
        summary.unlink()
    else:
        summary.write_text(content)
    line = refused("compare", "tiny.yaml")
    assert line.startswith(f"error: {summary} is ")
    assert line.endswith("make it again with `sphrom compare tiny.yaml --force`")


def test_a_case_that_does_not_fit(empty, sphrom, refused):
    large = ("--set", "discretization.resolution=100000")
    line = refused("run", "tiny.yaml", *large, code=5)
    assert re.search(r"needs about \d+ GiB of memory in [a-z-]+, this machine has [\d.]+", line)
    assert "lower discretization.resolution" in line
    result = sphrom("case", "check", "tiny.yaml", *large, code=5)
    assert "3 full runs and 6 reduced runs" in result.stdout
    assert "needs about" in result.stderr
    assert not empty.exists()


def test_the_check_asks_the_disk_of_its_folder(empty, refused, monkeypatch):
    asked = []

    def usage(folder):
        asked.append(Path(folder))
        return shutil._ntuple_diskusage(10, 10, 0)

    monkeypatch.setattr("sphrom.setup.cost.shutil.disk_usage", usage)
    Path("other").mkdir()
    line = refused("case", "check", "tiny.yaml", "--out", "other/inside", code=5)
    assert "the disk of other/inside has 0 " in line
    assert [folder.resolve() for folder in asked] == [Path("other").resolve()]


def test_the_folder_is_a_file(empty, refused):
    Path("there").write_text("mine")
    for stage in ("run", "fom", "pod"):
        assert "there" in refused(stage, "tiny.yaml", "--out", "there")
    assert Path("there").read_text() == "mine"


@pytest.mark.parametrize("out", ["mine", "mine/inside"])
def test_a_read_only_folder(empty, sphrom, refused, out):
    sphrom("case", "check", "tiny.yaml", code=0)  # imports what nobody may read
    Path("mine").mkdir()
    Path("mine").chmod(0o555)
    Path.cwd().chmod(0o755)
    user = os.geteuid()
    os.seteuid(NOBODY if user == 0 else user)  # root may write everywhere
    try:
        line = refused("fom", "tiny.yaml", "--out", out)
    finally:
        os.seteuid(user)
        Path("mine").chmod(0o755)
    assert "ermission" in line
    assert "--out" in line
