"""What a tank with a free surface measures, from its runs to tables, exports and Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import sphrom as package
from tests.pipeline.conftest import rows

CASE: dict[str, Any] = {
    "name": "tank",
    "scene": {
        "kind": "custom",
        "fluid": {"level": 0.5, "gravity": 1.0},
        "slip": "free",
        "reference_length": 0.5,
        "constants": {"a": 0.3},
        "body_force": ["a*sin(2*t)", 0],
        "measure": {
            "gauge": {"elevation": 0.25},
            "tank": {"of_fluid": "energy"},
            "middle": {"of_fluid": "centre_of_mass"},
            "wall": {"probe": [0, 0.25]},
            "high": {"probe": [0.5, 0.9]},
            "flux": {"flow_rate": {"from": [0.5, 0], "to": [0.5, 1]}},
            "beat": {"frequency": {"of": "gauge_elevation"}},
        },
    },
    "fluid": {"reference_density": 1.0, "reference_speed": 0.7},
    "discretization": {"resolution": 8},
    "time": {"final_time": 1.0},
    "snapshots": {"every": 10},
    "parameters": {"train": {"reynolds": [100], "a": [0.3]}},
    "sweep": {"model": "full", "reynolds": [100], "parameters": {"a": [0.3]}},
    "compare": {"plots": False, "grid": 12, "line_points": 21},
    "rom": [],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case's artifacts and tables."""
    folder = tmp_path_factory.mktemp("tank")
    (folder / "case.yaml").write_text(yaml.safe_dump(CASE))
    for command in (("fom", "--threads", 1), ("compare",), ("sweep",), ("export", "--to", "csv")):
        sphrom(*command, folder / "case.yaml", "--out", folder / "runs", code=0)
    return folder / "runs"


def test_tables_have_what_is_measured(made: Path) -> None:
    found = {(r["measured"], r["quantity"]): r for r in rows(made / "tables/measures.csv")}
    assert found["gauge", "elevation"]["unit"] == "m"
    assert 0.4 < float(found["gauge", "elevation"]["mean"]) < 0.6
    assert found["tank", "potential_energy"]["unit"] == "J/m"
    assert float(found["tank", "kinetic_energy"]["greatest"]) > 0.0
    assert ("middle", "centre_of_mass_x") in found
    assert float(found["high", "pressure"]["greatest"]) == 0.0
    (swept,) = rows(made / "sweep-full.csv")
    same = "gauge_elevation_greatest [m]", "middle_centre_of_mass_y_mean [m]"
    keys = ("gauge", "elevation", "greatest"), ("middle", "centre_of_mass_y", "mean")
    for column, (name, quantity, figure) in zip(same, keys, strict=True):
        assert float(swept[column]) == pytest.approx(float(found[name, quantity][figure]))
    assert "beat_mean [m]" in swept


def test_exports_are_zero_above_the_surface_and_artifacts_have_names(made: Path) -> None:
    (exported,) = (made / "export").glob("fom-*.csv")
    above = [row for row in rows(exported) if float(row["y [m]"]) > 0.75]
    assert above
    assert not any(float(row["pressure [Pa]"]) for row in above)
    with package.open(made / "fom-reynolds100-a0.3.h5") as run:
        assert run["gauge_elevation"].dims == ("snapshot",)
        assert run["middle_centre_of_mass"].dims == ("snapshot", "component")
        assert np.isfinite(run["tank_potential_energy"]).all()
