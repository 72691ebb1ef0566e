"""The summary of a sweep's runs."""

from __future__ import annotations

from sphrom.case.points import ParameterPoint
from sphrom.sweep.records import RunRecord
from sphrom.sweep.results import _summary


def test_a_figure_has_its_extremes_where_they_are_and_its_mean() -> None:
    values = {100.0: 2.0, 200.0: 7.0, 300.0: 3.0, 400.0: None}
    records = [RunRecord(ParameterPoint(reynolds), 0) for reynolds in values]
    rows = [{"kinetic_energy": value} for value in values.values()]
    ((words, least, at_least, mean, greatest, at_greatest),) = _summary(
        records, rows, {"kinetic_energy": "J/m"}
    )
    assert words == "kinetic energy [J/m]"
    assert (least, mean, greatest) == ("2.00", "4.00", "7.00")
    assert (at_least, at_greatest) == ("reynolds=100", "reynolds=200")
