"""Errors of models of schedules by the schedules that trained them, in the tutorial's channel.

The tested schedules have six random knots between -0.3 and 0.7 m/s2. Prints the largest errors of
the velocity and of the flow rate, relative L2 norms [%].

    python scripts/schedules.py
"""

from __future__ import annotations

import argparse
import csv
import re
from pathlib import Path

import numpy as np
import yaml

from sphrom.api.study import Study

PAGE = Path(__file__).parents[1] / "docs" / "tutorials" / "control.md"
SCHEDULES = [
    [0.2, 0.4, 0.4, 0.4, 0.4, 0.4],
    [0.6, 0.0, -0.3, 0.0, 0.5, 0.6],
    [-0.2, 0.4, 0.6, 0.4, 0.0, -0.2],
    [0.4, 0.0, 0.0, 0.4, 0.6, 0.0],
    [-0.3, 0.2, -0.3, 0.7, 0.2, -0.3],
    [0.7, 0.7, 0.2, -0.3, -0.3, 0.5],
]
"""A steady push, and others that swell and fade [m/s2]."""
N_TRAINED = (1, 2, 4, 6)
TESTED = np.random.default_rng(1).uniform(-0.3, 0.7, (3, 6)).round(3).tolist()


def points_of(schedules: list[list[float]]) -> dict[str, object]:
    """Return the points of schedules."""
    rows = [{f"f{n}": knot for n, knot in enumerate(knots, 1)} for knots in schedules]
    return {"points": [{"reynolds": 40.0, **row} for row in rows]}


def largest(table: Path, column: str, **chosen: str) -> float:
    """Return the largest value of a column in rows of tested schedules."""
    with table.open(encoding="utf-8") as lines:
        rows = [
            row
            for row in csv.DictReader(lines)
            if row["role"] not in ("", "trained")
            and all(row[key] == value for key, value in chosen.items())
        ]
    return max(float(row[column]) for row in rows)


def main() -> None:
    """Run the models, and print their errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/schedules"))
    out = parser.parse_args().out
    found = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    case = yaml.safe_load(found[1])
    for number in N_TRAINED:
        case["parameters"] = {"train": points_of(SCHEDULES[:number]), "test": points_of(TESTED)}
        study = Study(case, out=out / str(number), quiet=True)
        study.run()
        tables = study.folder / "tables"
        column = "relative_l2 [%]"
        velocity = largest(tables / "errors.csv", f"velocity_field_{column}", compared="fast")
        flux = largest(tables / "measures.csv", column, compared="fast", measured="flux")
        print(f"{number} schedules: velocity {velocity:.2g} %, flow rate {flux:.2g} %")


if __name__ == "__main__":
    main()
