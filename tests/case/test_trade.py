from __future__ import annotations

from sphrom.case.checks import coarser_resolution


def test_walls_stay_on_the_lattice(refusal):
    base = "name: small\nscene:\n  kind: open-cavity\n"
    (line,) = refusal("trade: {resolutions: [41]}\n", base=base)
    assert "trade.resolutions: 41: a spacing of" in line


def test_half_the_resolution_where_it_fits(load):
    coarse = "discretization: {resolution: 20, smoothing_length_ratio: 2.0}\n"
    assert coarser_resolution(load(coarse)) == 10
    assert coarser_resolution(load(coarse, "discretization.resolution=14")) is None
    assert coarser_resolution(load("discretization: {resolution: 17}\n")) is None
