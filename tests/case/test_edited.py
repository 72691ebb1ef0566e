"""Keys are changed in a case file's text; all else stays as its author wrote it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from sphrom.case.edited import retrained, with_value
from sphrom.case.loader import load_case

DEMOS = sorted(Path(__file__).parents[2].glob("cases/*.yaml"))
TRAIN = {"reynolds": [50.0, 1000.0, 223.6]}
POINTS = {"points": [{"reynolds": 50.0, "lid": 0.5}, {"reynolds": 100.0, "lid": 1.0}]}


@pytest.mark.parametrize("demo", DEMOS, ids=lambda path: path.stem)
def test_of_a_case_only_the_values_to_train_at_change(demo: Path) -> None:
    before, text = demo.read_text(), retrained(demo, [], TRAIN)
    expected = yaml.safe_load(before)
    expected.setdefault("parameters", {})["train"] = TRAIN
    assert yaml.safe_load(text) == yaml.safe_load(yaml.safe_dump(expected))
    comments = [line.partition("#")[2] for line in before.splitlines() if "#" in line]
    kept = [line.partition("#")[2] for line in text.splitlines() if "#" in line]
    assert kept == comments


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (
            "name: a # x\n# end",
            "name: a # x\nparameters:\n  train:\n    reynolds: [50, 1000, 223.6]\n# end",
        ),
        (
            "parameters:\n  train:\n    reynolds:  # why\n    - 3\n    - 4  # four\n  # test\n"
            "  test: {reynolds: [5]}\n",
            "parameters:\n  train:\n    reynolds: [50, 1000, 223.6]  # four\n  # test\n"
            "  test: {reynolds: [5]}\n",
        ),
        (
            "parameters: {train: {reynolds: [1]}, test: {reynolds: [2]}}\nrom: []\n",
            "parameters:\n  train:\n    reynolds: [50, 1000, 223.6]\n  test:\n    reynolds: [2]\n"
            "rom: []\n",
        ),
        (
            "parameters:\n  train:\nrom: []\n",
            "parameters:\n  train:\n    reynolds: [50, 1000, 223.6]\nrom: []\n",
        ),
    ],
)
def test_how_values_are_written(before: str, after: str) -> None:
    assert with_value(before, ["parameters", "train"], TRAIN) == after


def test_points_stand_in_lines_of_their_own() -> None:
    text = with_value("name: a\n", ["parameters", "train"], POINTS)
    assert "      - {reynolds: 50, lid: 0.5}\n      - {reynolds: 100, lid: 1}\n" in text
    assert yaml.safe_load(text)["parameters"]["train"] == POINTS


@pytest.mark.parametrize(
    "head",
    [
        "{name: a, scene: {kind: taylor-green}}",
        "base: &b\n  kind: taylor-green\nname: a\nscene: *b\n",
        '"name": a\nscene: {kind: taylor-green}\n"parameters": {}\n',
    ],
)
def test_a_file_that_is_written_in_another_way_has_the_same_values(
    tmp_path: Path, head: str
) -> None:
    (tmp_path / "a.yaml").write_text(head)
    text = retrained(tmp_path / "a.yaml", [], TRAIN)
    expected = yaml.safe_load(head)
    assert yaml.safe_load(text) == {**expected, "parameters": {"train": TRAIN}}


def test_keys_that_were_overridden_are_in_the_text(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("name: a\nscene: {kind: taylor-green}\nrom:\n- name: fast  # m\n")
    overrides = ["discretization.resolution=30", "rom.0.n_modes=3"]
    text = retrained(path, overrides[:1], TRAIN)
    assert "# m" in text
    both = tmp_path / "b.yaml"
    both.write_text(retrained(path, overrides, TRAIN))
    case = load_case(both)
    assert case == load_case(path, [*overrides, "parameters.train.reynolds=[50,1000,223.6]"])
