"""Full runs against reference profiles: scales, gauges, instants, and where there are none."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.case.points import ParameterPoint
from sphrom.compare.references import compare_with_references, profiles_of
from sphrom.scenes.reference_profiles import profiles_for
from sphrom.store.stored_run import probes_of

LENGTH, SPEED, DENSITY = 0.5, 2.0, 3.0
SCALED = {
    "scene": {"length": LENGTH},
    "fluid": {"reference_speed": SPEED, "reference_density": DENSITY},
}
RE100 = ParameterPoint(100.0)


@pytest.fixture
def case(case_of):
    """A cavity of other scales than the reference's."""
    return case_of("lid-driven-cavity", **SCALED)


def _lines(time):
    """The driven cavity's profiles at Re 100 by quantity; those of its start at a time."""
    known = profiles_for("lid-driven-cavity", "regularised", 100.0)
    return {p.quantity: p for p in known if p.time == time}


def _flow(profiles, pressure_offset=0.0, error=0.0):
    """A flow that has the profiles all over the box, in a cavity of other scales."""

    def flow(position, time):
        x, y = position.T / LENGTH
        u, v, p = (
            np.interp(along, profiles[q].coordinate, profiles[q].value)
            for q, along in (("u", y), ("v", x), ("p", y))
        )
        velocity = SPEED * np.stack((u + error, v), axis=1)
        return velocity, DENSITY * SPEED**2 * p + pressure_offset

    return flow


def _compared(case, trajectory, point=RE100):
    found = compare_with_references(case, point, trajectory, probes_of(case))
    return {(row.profile, row.state, row.reference_time): (row, profile) for row, profile in found}


def test_a_run_that_has_the_reference_profiles(case, made_up):
    """In the reference's scales, and whatever constant is added to the pressure."""
    run = made_up(case, _flow(_lines(None), pressure_offset=70.0), np.array([0.0, 9.0, 10.0]))
    compared = _compared(case, run)
    for name in ("u along y", "v along x", "p along y"):
        row, profile = compared[name, "steady", None]
        # Interpolated from particles 1/40 apart; u is steep at the lid.
        assert row.largest_error < 0.015
        assert row.rms_error < 0.003
        assert row.last_change == pytest.approx(0.0, abs=1e-12)
        assert row.settled
        assert (row.from_time, row.time, row.parameters) == (9.0, 10.0, "reynolds=100")
        # Points on the walls are not compared.
        assert 0.0 < profile.coordinate[0] < profile.coordinate[-1] < 1.0


def test_profiles_are_taken_on_the_reference_s_own_line(case, made_up):
    """A flow that has them there, and others beside it."""
    on_line = _flow(_lines(None))

    def flow(position, time):
        velocity, pressure = on_line(position, time)
        beside = 10.0 * (position / LENGTH - 0.5)
        return velocity * (1.0 + beside), pressure

    compared = _compared(case, made_up(case, flow, np.array([0.0, 10.0])))
    for name in ("u along y", "v along x"):
        assert compared[name, "steady", None][0].rms_error < 0.006


def test_an_error_is_seen_in_units_of_the_speed(case, made_up):
    compared = _compared(case, made_up(case, _flow(_lines(None), error=0.1), np.array([0.0, 10.0])))
    assert compared["u along y", "steady", None][0].rms_error == pytest.approx(0.1, abs=0.003)
    assert compared["v along x", "steady", None][0].largest_error < 0.015


def test_noise_of_an_instant_is_no_error_and_no_change(case, made_up):
    """Though the last instant is off by a tenth of the speed."""
    lines = _lines(None)

    def flow(position, time):
        """Add noise of zero mean in time, as sound and rearranging particles make it."""
        velocity, pressure = _flow(lines)(position, time)
        noise = 0.1 * np.cos(2.0 * np.pi * time / 0.5)
        return velocity + SPEED * noise, pressure + DENSITY * SPEED**2 * noise * position[:, 1]

    compared = _compared(case, made_up(case, flow, np.linspace(0.0, 10.0, 201)))
    for name in ("u along y", "v along x"):
        row = compared[name, "steady", None][0]
        assert row.largest_error < 0.03
        assert (row.from_time, row.time, row.n_snapshots) == (9.0, 10.0, 21)
        assert row.largest_scatter == pytest.approx(0.1 / np.sqrt(2.0), rel=0.2)
        assert row.last_change < 0.01
        assert row.settled


@pytest.mark.parametrize(
    ("end", "window"), [(0.5, (0.225, 0.275, 11)), (0.26, (0.24, 0.26, 5)), (0.25, (0.25, 0.25, 1))]
)
def test_a_window_about_an_instant_is_short_and_symmetric(case, made_up, end, window):
    """No longer than the longest sound wave's period, 0.05 s here, and cut where the run ends."""
    times = np.linspace(0.0, end, round(end / 0.005) + 1)
    compared = _compared(case, made_up(case, _flow(_lines(1.0)), times))
    row = compared["u along y", "transient", 0.25][0]
    assert (row.from_time, row.time, row.n_snapshots) == pytest.approx(window)


def test_instants_of_the_start(case, made_up):
    """t U / L = 1 and 5 are 0.25 and 1.25 s here; an instant not recorded is left out."""
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    compared = _compared(case, made_up(case, _flow(_lines(1.0)), times))
    assert {key[1:] for key in compared} == {("steady", None), ("transient", 0.25)}
    row = compared["u along y", "transient", 0.25][0]
    assert row.time in (0.2, 0.3)
    assert row.largest_error < 0.015


def test_pressure_of_the_start_has_no_mean(case, made_up):
    start = _lines(5.0)
    run = made_up(case, _flow(start, pressure_offset=-40.0), np.array([0.0, 1.25]))
    _, compared = _compared(case, run)["p along y", "transient", 1.25]
    middles = (np.arange(50) + 0.5) / 50
    mean = np.interp(middles, start["p"].coordinate, start["p"].value).mean()
    np.testing.assert_allclose(compared.value, compared.reference_value - mean, atol=2e-3)


def test_a_steady_flow_that_still_changes_says_so(case, made_up):
    def flow(position, time):
        velocity, pressure = _flow(_lines(None))(position, time)
        return velocity + SPEED * 0.02 * time, pressure

    compared = _compared(case, made_up(case, flow, np.linspace(0.0, 10.0, 11)))
    row = compared["u along y", "steady", None][0]
    # Between means over the last two snapshots, and over two a tenth of the run before.
    assert row.last_change == pytest.approx(0.02)
    # The pressure does not change, but no part of such a flow is steady.
    assert compared["p along y", "steady", None][0].last_change < 1e-9
    for row, _ in compared.values():
        assert row.settled == (row.state != "steady")


def test_mean_of_the_open_cavity_is_over_all_snapshots(case_of, made_up):
    case = case_of("open-cavity")
    (reference,) = profiles_for("open-cavity", None, 2400.0)

    def flow(position, time):
        u = 2.0 * np.interp(position[:, 1] / 0.2, reference.coordinate, reference.value)
        wave = np.sin(2.0 * np.pi * 5.0 * time)
        return np.stack((u + wave, 0.0 * u), axis=1), 0.0 * u

    times = 5.0 + np.arange(10) / 50.0
    point = ParameterPoint(2400.0)
    ((row, profile),) = _compared(case, made_up(case, flow, times), point).values()
    assert row.state == "time average"
    assert (row.from_time, row.time) == (5.0, 5.18)
    assert len(profile.coordinate) == len(reference.coordinate)
    assert row.largest_error < 0.05


def test_of_a_lid_with_a_ramp_the_steady_flow_alone_is_known(case_of):
    at_once, smoothly = (
        profiles_of(case_of("lid-driven-cavity", scene={"lid_ramp": ramp}), RE100)
        for ramp in (0.0, 0.3)
    )
    assert {profile.time for profile in at_once} == {None, 1.0, 5.0}
    assert smoothly == tuple(profile for profile in at_once if profile.time is None)


@pytest.mark.parametrize(
    ("kind", "sections", "reynolds"),
    [
        ("lid-driven-cavity", {}, 75.0),
        ("open-cavity", {"fluid": {"reference_speed": 1.0}}, 2400.0),
        ("open-cavity", {"scene": {"body_force": {"sustained_share": 0.001}}}, 2400.0),
    ],
)
def test_other_flows_have_no_reference(case_of, kind, sections, reynolds):
    assert profiles_of(case_of(kind, **sections), ParameterPoint(reynolds)) == ()
