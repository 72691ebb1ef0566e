"""Tables of measured histories: what they hold, and what is refused."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphrom.case.loader import load_case
from sphrom.errors import CaseError
from sphrom.fit.measurements import Measurements, read_measurements

CASE = load_case(
    {
        "name": "lid",
        "scene": {
            "kind": "lid-driven-cavity",
            "measure": {
                "wake": {"probe": [0.5, 0.8]},
                "drag": {"force_on": "top"},
                "flux": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1.0]}},
                "profile": {"line": {"from": [0.5, 0.0], "to": [0.5, 1.0], "points": 5}},
            },
        },
        "discretization": {"resolution": 10},
        "time": {"final_time": 0.5},
        "snapshots": {"every": 5},
    }
)


def read(tmp_path: Path, text: str, noise: float | None = None) -> Measurements:
    """Return the measurements of a file with a text."""
    path = tmp_path / "lab.csv"
    path.write_text(text)
    return read_measurements(path, CASE, CASE.plan.steps, noise)


def test_columns_are_measurements_of_the_case(tmp_path):
    text = (
        "# the first run\n"
        "time [s], wake_velocity_x [m/s],wake_velocity_x_noise,drag_torque [N],flux_flow_rate\n"
        "0.2,0.3,0.01,1.0,nan\n\n0.1,0.1,0.02,3.0,0.7\n0.3,,,2.0,0.9\n"
    )
    found = read(tmp_path, text, noise=10.0)
    assert [h.name for h in found.histories] == ["wake_velocity_x", "drag_torque", "flux_flow_rate"]
    wake, torque, flux = found.histories
    assert (wake.measure, wake.quantity, wake.component) == ("wake", "velocity", 0)
    assert wake.time.tolist() == [0.1, 0.2]
    assert wake.value.tolist() == [0.1, 0.3]
    assert wake.noise.tolist() == [0.02, 0.01]
    assert (torque.quantity, torque.component) == ("torque", None)
    assert torque.noise == pytest.approx(np.full(3, 0.2))
    assert flux.time.tolist() == [0.1, 0.3]
    assert flux.noise == pytest.approx(np.full(2, 0.02))


def test_rows_may_have_places(tmp_path):
    text = (
        "time [s],x [m],y [m],pressure [Pa],velocity_y [m/s],velocity_x [m/s],pressure_noise\n"
        "0.1,0.2,0.3,1,2,,0.1\n0.2,0.2,0.3,1.5,2.5,7,0.1\n0.1,0.4,0.3,1,,,0.1\n"
    )
    found = read(tmp_path, text.replace(",7,", ",,"), noise=1.0).histories
    names = ("pressure", 0.2), ("velocity_y", 0.2), ("pressure", 0.4)
    assert [h.name for h in found] == [f"{q} at ({x}, 0.3)" for q, x in names]
    assert [h.place for h in found] == [(0.2, 0.3), (0.2, 0.3), (0.4, 0.3)]
    assert {h.measure for h in found} == {""}
    assert found[1].noise == pytest.approx(np.full(2, 0.005))


def test_a_table_with_semicolons_and_decimal_commas(tmp_path):
    text = "time [s];wake_pressure [Pa];wake_pressure_noise\n0,1;2,5;1e-1\n0,2;-1,25e1;0,5\n"
    (found,) = read(tmp_path, text).histories
    assert (found.time.tolist(), found.value.tolist()) == ([0.1, 0.2], [2.5, -12.5])
    assert found.noise.tolist() == [0.1, 0.5]


def test_columns_from_python_are_those_of_a_file():
    value = np.array([1.0, np.nan])
    columns = {"time": [0.1, 0.2], "drag_torque": value, "drag_torque_noise": [0.1, 0.2]}
    (found,) = read_measurements(columns, CASE, CASE.plan.steps, None).histories
    assert (found.time.tolist(), found.noise.tolist()) == ([0.1], [0.1])
    with pytest.raises(CaseError, match="equal lengths"):
        read_measurements({"time": [0.1], "wake_pressure": [1.0, 2.0]}, CASE, CASE.plan.steps, 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "its first row must name the columns"),
        ("time,wake_pressure\n0.1,\n0.2,NaN\n", "has no values"),
        ("time,wake_pressure,wake_pressure\n0,1,1\n", "each once"),
        ("time,x,pressure\n0,1,1\n", "x and y where rows have places"),
        ("time,wakes_pressure\n0,1\n", "did you mean wake_pressure"),
        ("time,profile_velocity_x\n0,1\n", "pressure need columns x and y"),
        ("time,velocity_x\n0,1\n", "column velocity_x needs a place"),
        ("time,x,y,u\n0,1,1,1\n", "known: velocity_x, velocity_y, pressure, wake_velocity_x"),
        ("time [ms],wake_pressure\n0,1\n", "column time must be in s; got [ms]"),
        ("time,wake_pressure,drag_torque_noise\n0,1,1\n", "has no column 'drag_torque'"),
        ("time,wake_pressure\n0.1,1\n0.2,fast\n", "line 3: wake_pressure must be a number"),
        ("time,x,y,pressure\n0.1,0.5,,1\n", "line 2: has a value but no time, or no place"),
        ("time,wake_pressure\n0,1,2\n", "line 2: has 3 cells for 2 columns"),
        ("time,wake_pressure\n0,1,2,5\n", "decimal commas need semicolons between cells"),
        ("time;wake_pressure\n0,1;2,5\n0.2;1\n", "line 2 has decimal commas, and line 3 points"),
        ("time,wake_pressure\n0.1,1\n0.7,2\n", "at 0.7 s is outside of the model's times"),
        ("time,wake_pressure\n0.1,1\n0.2,1\n", "give a column wake_pressure_noise"),
        ("time,x,y,pressure\n0.1,0.5,1.5,1\n", "(0.5, 1.5) m is outside of the box"),
        ("time,wake_pressure\n0.1,1\x00\x1b[31m\n", "line 2: wake_pressure must be a number"),
    ],
)
def test_what_is_refused(tmp_path, text, said):
    with pytest.raises(CaseError) as error:
        read(tmp_path, text, noise=1.0)
    assert said in str(error.value)
    assert not {"\n", "\x1b"} & set(str(error.value))


def test_noise_has_to_be_known(tmp_path):
    with pytest.raises(CaseError, match="give a column wake_pressure_noise, or a share"):
        read(tmp_path, "time,wake_pressure,wake_pressure_noise\n0.1,1,0.1\n0.2,2,\n")


def test_files_that_can_not_be_read(tmp_path):
    path = tmp_path / "lab.csv"
    for said in ("can't be read: No such file", "is not a file"):
        with pytest.raises(CaseError, match=said):
            read_measurements(path, CASE, CASE.plan.steps, 1.0)
        path.mkdir(exist_ok=True)
    path.rmdir()
    path.write_bytes(b"time,wake_pressure\n0,\xff\xfe\n")
    with pytest.raises(CaseError, match="is not UTF-8"):
        read_measurements(path, CASE, CASE.plan.steps, 1.0)


CELLS = st.sampled_from(
    ["", "nan", "0.1", "0.2", "1e300", "x", '"', "-1", "wake_pressure", "time", "\x00"]
)
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=5).map(",".join), max_size=6)


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(["time,wake_pressure\n", "time,x,y,pressure,pressure_noise\n", ""]),
    ROWS | st.text().map(str.split),
)
def test_any_text_is_read_or_refused_in_words(tmp_path_factory, head, rows):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text(head + "\n".join(rows), encoding="utf-8", errors="replace")
    with suppress(CaseError):  # nothing else may come of it
        found = read_measurements(path, CASE, CASE.plan.steps, 1.0)
        assert np.isfinite(found.values).all()
        assert (found.noise > 0.0).all()
