from __future__ import annotations

import pytest

from sphrom.case.trade_checks import coarser_resolution


def test_every_key_has_a_default(load):
    section = load("").trade
    assert section.evaluations == ("operators",)
    assert (section.n_modes, section.resolutions, section.projections) == (None, None, None)
    assert section.extremes.full_runs


def test_overrides(load):
    section = load("", "trade.courant_numbers=[]", "trade.extremes.mach_numbers=[0.05]").trade
    assert section.courant_numbers == ()
    assert section.extremes.mach_numbers == (0.05,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("trade: {parameters: [150]}", "reynolds=150 is in neither parameters.train nor"),
        ("trade: {parameters: test}", "there are no test values"),
        ("trade: {n_modes: [6]}", "the basis keeps 5 modes; got 6"),
        ("trade: {bases: [al]}", "no basis has the name al; did you mean all?"),
        ("trade: {bases: [all, low]}", "no basis has the name low"),
        ("trade: {resolutions: [10]}", "10: a support of radius"),
        ("trade: {evaluations: [particle]}", "did you mean particles?"),
        ("trade: {evaluations: []}", "must be a list of one or more"),
        ("trade: {step_factors: [0]}", "from 0.01 to 100"),
        ("trade: {courant_numbers: [2]}", "from 0.001 to 1.5"),
        ("trade: {repeats: 0}", "from 1 to 1000"),
        ("trade: {modes: [2]}", "unknown key; did you mean"),
    ],
)
def test_refusals(refusal, text, words):
    (line,) = refusal(text + "\n")
    assert line.startswith("case.yaml:4: trade")
    assert words in line


def test_walls_stay_on_the_lattice(refusal):
    base = "name: small\nscene:\n  kind: open-cavity\n"
    (line,) = refusal("trade: {resolutions: [41]}\n", base=base)
    assert "trade.resolutions: 41: a spacing of" in line


def test_half_the_resolution_where_it_fits(load):
    coarse = "discretization: {resolution: 20, smoothing_length_ratio: 2.0}\n"
    assert coarser_resolution(load(coarse)) == 10
    assert coarser_resolution(load(coarse, "discretization.resolution=14")) is None
    assert coarser_resolution(load("discretization: {resolution: 17}\n")) is None
