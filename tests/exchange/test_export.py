"""Files for ParaView hold what the artifact does, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.artifacts.paraview import views
from sphrom.exchange.export import write_vtu
from sphrom.exchange.foreign_files import read_foreign, snapshots_in


@pytest.mark.parametrize(("n", "digits"), [(1, 1), (10, 1), (11, 2)])
def test_steps_have_names_of_one_length(tmp_path, n, digits) -> None:
    pytest.importorskip("vtkmodules", reason="VTK is not installed")
    random = np.random.default_rng(n)
    series = {
        "time": np.arange(float(n)),
        "position": random.random((n, 5, 2)),
        "velocity": random.random((n, 5, 2)),
        "pressure": random.random((n, 5)),
    }
    view = views("sphrom/trajectory", {name: values.shape for name, values in series.items()})[""]
    write_vtu(tmp_path / "a.pvd", series, view, force=False)
    names = [f"a-{step:0{digits}}.vtu" for step in range(n)]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == sorted(names)
    listed = snapshots_in(tmp_path / "a.pvd")
    assert [stored.path.name for stored in listed] == names
    last = read_foreign(listed[-1].path)
    assert last.time == listed[-1].time == n - 1
    for name, values in {"x": series["position"], "velocity.x": series["velocity"]}.items():
        assert np.array_equal(last.fields[name], values[-1, :, 0])
    assert np.array_equal(last.fields["pressure"], series["pressure"][-1])
