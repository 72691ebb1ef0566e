"""Errors of one run against another: with and without the pressure's mean."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.compare.comparison_tables import error_row
from sphrom.metrics.histories import EQ41, PLACES, History, Series, compare
from sphrom.metrics.measures import Samples
from sphrom.plots.tables import flat
from sphrom.store.stored_run import probes_of

TIMES = np.array([0.0, 1.0, 2.0])


@pytest.fixture(scope="module")
def cavity(case_of):
    return probes_of(case_of("lid-driven-cavity", compare={"grid": 20, "line_points": 20}))


def _samples(probes, *, pressure_offset=0.0, error=None):
    """A flow that starts at rest, and an error of its velocity at chosen probes."""
    x, y = probes.all.T
    velocity = np.stack((np.sin(np.pi * x) * y, np.cos(np.pi * y) * x), axis=1)
    pressure = np.cos(np.pi * x) + y
    growth = TIMES[:, None]
    samples = Samples(TIMES, growth[..., None] * velocity, growth * (pressure + pressure_offset))
    if error is not None:
        samples.velocity[:, error] += 0.1
    return samples


NAMES = {"compared": "map", "against": "full", "parameters": "reynolds=1", "role": ""}


def _row(history):
    return flat(error_row(history, **NAMES))


def test_a_drifting_mean_is_an_error_of_the_pressure_in_eq41_alone(cavity):
    run, reference = _samples(cavity, pressure_offset=0.5), _samples(cavity)
    described = _row(compare(run, reference, cavity, 0.0))
    for place in ("line", "field"):
        assert described[f"pressure_{place}_eq41_by_field_range_mean"] > 10.0
        norm = described[f"pressure_{place}_relative_l2_peak"]
        assert norm == pytest.approx(0.0, abs=1e-12)
    assert described["velocity_field_relative_l2_peak"] == 0.0
    assert described["velocity_field_eq41_by_field_range_peak"] == 0.0


def _cornered(probes, error):
    """A pressure that is a thousand times larger in a corner than on the line, and an error."""
    x, y = probes.all.T
    line = np.sin(2.0 * np.pi * y)
    corner = 1000.0 * np.exp(-(((x - 1.0) ** 2 + (y - 1.0) ** 2) / 0.02))
    growth = TIMES[:, None]
    velocity = np.stack((y, x), axis=1)
    return Samples(TIMES, growth[..., None] * velocity, growth * (line + corner + error * line))


def test_a_range_of_corners_hides_no_error_on_the_line(cavity):
    """Pressure is half wrong all along the line: one measure says so, one hardly, one not."""
    described = _row(compare(_cornered(cavity, 0.5), _cornered(cavity, 0.0), cavity, 0.0))
    assert described["pressure_line_relative_l2"] == pytest.approx(50.0, rel=0.02)
    assert described["pressure_line_relative_l2_peak"] == pytest.approx(50.0, rel=0.02)
    expected = 100.0 * 0.5 * 2.0 / np.pi / 2.0
    assert described["pressure_line_eq41_by_line_range_mean"] == pytest.approx(expected, rel=0.05)
    assert 0.0 < described["pressure_line_eq41_by_field_range_mean"] < 0.1
    assert 0.0 < described["pressure_field_eq41_by_field_range_mean"] < 0.1
    assert described["pressure_field_eq41_by_line_range_mean"] == pytest.approx(expected, rel=0.2)
    assert described["pressure_field_relative_l2"] < 0.5


def test_the_norm_over_time_counts_instants_by_their_size(cavity):
    """An error that stays while the flow grows; the mean of instants' errors would be 0.75."""
    history = compare(_samples(cavity, error=cavity.on_grid), _samples(cavity), cavity, 0.0)
    described = _row(history)
    np.testing.assert_array_equal(history.time, [1.0, 2.0])  # not at rest
    first = history.places["velocity_field"].relative_l2[0]
    np.testing.assert_allclose(history.places["velocity_field"].relative_l2, [first, first / 2.0])
    assert described["velocity_field_relative_l2"] == pytest.approx(first * np.sqrt(2.0 / 5.0))
    # Relative to the flow's root mean square over time, the error stays, and is the figure itself.
    over_rms = history.places["velocity_field"].over_rms
    np.testing.assert_allclose(over_rms, described["velocity_field_relative_l2"])
    assert described["velocity_field_relative_l2_peak"] == pytest.approx(first)
    assert described["velocity_field_relative_l2_end"] == pytest.approx(first / 2.0)


def test_an_unstable_run_has_no_figures(cavity):
    history = compare(_samples(cavity), _samples(cavity), cavity, 0.0)
    lost = flat(error_row(history, **NAMES, status="unstable"))
    figures = {k: v for k, v in lost.items() if "_" in k and k != "n_modes"}
    assert len(figures) == 31
    assert set(figures.values()) == {None}


def test_stations_take_no_part_in_errors(case_of):
    probes = probes_of(case_of("open-cavity", compare={"grid": 20, "line_points": 20}))
    station = np.zeros(len(probes.all), dtype=bool)
    station[probes.at_stations] = True
    assert station.sum() == 1
    history = compare(_samples(probes, error=station), _samples(probes), probes, 0.0)
    assert _row(history)["velocity_field_relative_l2_peak"] == 0.0


SNAPSHOTS = 0.05 * np.arange(41)
PERIOD = 0.2


def _loud(probes, sound, *, bias=0.0):
    """A steady flow with sound of a whole number of waves in the period."""
    x, y = probes.all.T
    steady = x * y + bias * np.cos(np.pi * y)
    wave = np.cos(2.0 * np.pi / PERIOD * SNAPSHOTS)[:, None] * np.cos(np.pi * y)
    velocity = np.broadcast_to(np.stack((y, x), axis=1), (len(SNAPSHOTS), len(x), 2))
    return Samples(SNAPSHOTS, velocity.copy(), steady + sound * wave)


@pytest.mark.parametrize("bias", [0.0, 0.1])
def test_sound_is_no_error_of_the_pressure_without_sound_but_the_flow_is(cavity, bias):
    run = _loud(cavity, 0.0, bias=bias)
    silent = compare(run, _loud(cavity, 0.0), cavity, 0.0).places
    loud = compare(run, _loud(cavity, 0.3), cavity, 0.0, PERIOD)
    for place in ("pressure_line", "pressure_field"):
        assert loud.places[place].relative_l2.max() > 5.0
        found, expected = loud.without_sound[place], silent[place]
        pairs = [(found.eq41[name], values) for name, values in expected.eq41.items()]
        for each, values in [(found.relative_l2, expected.relative_l2), *pairs]:
            np.testing.assert_allclose(each, values[0], rtol=1e-7, atol=1e-10)


def test_share_of_sound_is_that_of_the_reference(cavity):
    steady, loud = _loud(cavity, 0.0), _loud(cavity, 0.3)
    fluctuations = [p - p.mean(axis=1, keepdims=True) for p in (
        steady.pressure[3:-3, cavity.on_grid], loud.pressure[3:-3, cavity.on_grid])]  # fmt: skip
    added = np.linalg.norm(fluctuations[1] - fluctuations[0])
    expected = 100.0 * added / np.linalg.norm(fluctuations[1])
    assert compare(steady, loud, cavity, 0.0, PERIOD).sound == pytest.approx(expected, rel=1e-6)
    assert compare(loud, steady, cavity, 0.0, PERIOD).sound == pytest.approx(0.0, abs=1e-6)
    # Snapshots a period apart cannot tell sound from flow.
    assert compare(loud, loud, cavity, 0.0, 0.05).sound is None


def test_pressure_without_sounds_need_the_whole_window(cavity):
    full = _loud(cavity, 0.1)
    n_half = 4
    whole = compare(full, full, cavity, 0.0, PERIOD).without_sound
    assert len(whole["pressure_line"].relative_l2) == len(SNAPSHOTS) - 2 * (n_half - 1)
    # Instants before the first that counts are averaged over, but don't count themselves.
    late = compare(full, full, cavity, 1.0, PERIOD).without_sound
    assert len(late["pressure_line"].relative_l2) == 21 - (n_half - 1)
    assert compare(full, full, cavity, 0.0, 1.1).without_sound == {}
    short = full.at(slice(6))
    assert compare(short, short, cavity, 0.0, PERIOD).without_sound == {}
    assert compare(full, full, cavity, 0.0).without_sound == {}


SHAPE = np.array([1.0, 4.0, 2.0])


def _series(k):
    eq41 = {name: n * 10.0**k * SHAPE for n, name in enumerate(EQ41, 2)}
    return Series(5.0 * 10.0**k, 10.0**k * SHAPE, SHAPE, eq41)


def _numbered():
    """A history of which no two series have a mean, a peak or an end in common."""
    return History(
        TIMES,
        {name: _series(k) for k, name in enumerate(PLACES)},
        without_sound={"pressure_line": _series(8), "pressure_field": _series(9)},
    )


def test_every_figure_is_of_its_own_series():
    described = _row(_numbered())
    quiet = (8, "pressure_line_without_sound"), (9, "pressure_field_without_sound")
    for k, name in (*enumerate(PLACES), *quiet):
        assert described[f"{name}_relative_l2"] == 5.0 * 10.0**k
        assert described[f"{name}_relative_l2_peak"] == 4.0 * 10.0**k
    for k, name in enumerate(PLACES):
        for factor, over in ((2.0, "line"), (3.0, "field")):
            found = [described[f"{name}_eq41_by_{over}_range_{s}"] for s in ("mean", "peak")]
            assert found == pytest.approx([7.0 / 3.0 * factor * 10.0**k, 4.0 * factor * 10.0**k])
    assert described["velocity_field_relative_l2_end"] == 2.0
    assert described["pressure_field_relative_l2_end"] == 200.0


@pytest.mark.parametrize("place", ["line", "field"])
def test_errors_on_the_line_and_on_the_grid_are_apart(cavity, place):
    """Of a run that is wrong in one of them only."""
    run, reference = _samples(cavity), _samples(cavity)
    chosen = cavity.on_line if place == "line" else cavity.on_grid
    run.pressure[:, chosen] += np.sin(7.0 * cavity.all[chosen, 1])
    run.velocity[:, chosen] += 0.1
    history = compare(run, reference, cavity, 0.0)
    other = "field" if place == "line" else "line"
    for quantity in ("velocity", "pressure"):
        wrong, right = (history.places[f"{quantity}_{p}"] for p in (place, other))
        assert wrong.relative_l2.min() > 0.1
        assert wrong.eq41["eq41_by_field_range"].min() > 0.1
        assert right.relative_l2.max() < 1e-12
        assert right.eq41["eq41_by_line_range"].max() < 1e-12
