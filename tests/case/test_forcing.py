"""What drives a flow, where fluid is and as fast as it changes: strips, periods, peaks, places."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.case.plan_times import STEPS_PER_PERIOD
from sphrom.errors import CaseError

STEP = {"step": {"rectangle": {"lower": [-2, 0], "upper": [0, 1]}}}
PROFILE = "6*(y - 1)*(2 - y)"
CHANNEL: dict[str, Any] = {
    "kind": "custom",
    "box": {"lower": [-2, 0], "upper": [2, 2], "periodic": ["x"]},
    "solids": STEP,
    "inflow": {"strip": {"from": -2, "to": -0.7}, "velocity": [PROFILE, 0]},
    "reference_length": 2.0,
}
TANK: dict[str, Any] = {
    "kind": "custom",
    "fluid": {"level": 0.5, "gravity": 1.0},
    "slip": "free",
    "constants": {"w": 3.0},
    "body_force": ["0.1*cos(w*t)", 0],
    "reference_length": 0.5,
}
PLAIN: dict[str, Any] = {
    "kind": "custom",
    "box": {"upper": [2, 1], "periodic": ["x"]},
    "reference_length": 1.0,
}


def case(scene: dict[str, Any], /, resolution: int = 16, **sections: Any) -> Case:
    cut = {"resolution": resolution}
    time = {"final_time": 10.0}
    given = {"name": "x", "scene": scene, "discretization": cut, "time": time, "rom": []}
    return load_case({**given, **sections})


def inflow(velocity: Any, **given: Any) -> dict[str, Any]:
    return {**CHANNEL, **given, "inflow": {**CHANNEL["inflow"], "velocity": velocity}}


def test_only_the_open_part_of_a_strip_counts() -> None:
    """Below the step the profile is 12 m/s in the other direction."""
    fluid = {"reference_speed": 1.5}
    strips, steps = [], []
    for velocity in (PROFILE, f"where(y >= 1, {PROFILE}, 0)"):
        found = case(inflow([velocity, 0]), fluid=fluid).plan
        strips.append(found.strip)
        steps.append(found.steps)
        assert found.scene.ramp == pytest.approx(4.0 / 1.5)
    assert strips[0] == strips[1]
    assert steps[0] == steps[1]
    assert strips[0] is not None
    assert strips[0].speed == 1.5


def test_an_inflow_is_not_evaluated_in_solids() -> None:
    found = case(inflow(["sqrt(y - 1)*sqrt(2 - y)", 0]))
    assert found.plan.strip is not None
    assert found.plan.strip.speed == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["U", "inflow"])
@pytest.mark.parametrize("own", [1.0, 2.0])
def test_a_strip_has_the_largest_speed_of_all_points(name: str, own: float) -> None:
    scene = inflow([f"U*{PROFILE}", 0], constants={"U": own if name == "U" else 1.0})
    given = {"train": {name: [0.5, 2.0]}, "test": {name: [1.0]}}
    plan = case(scene, parameters=given, fluid={"reference_speed": 1.5}).plan
    assert plan.strip is not None
    assert plan.strip.speed == pytest.approx(3.0)
    assert plan.scene.ramp == pytest.approx(4.0 / 3.0)
    for point in plan.points:  # all runs have one strip
        resistance = plan.flow(point).resistance
        assert resistance is not None
        assert resistance.strip == plan.strip


@pytest.mark.parametrize("rate", [3.0, 660.0, 1e5])
def test_steps_resolve_the_driving(rate: float) -> None:
    scene = {**TANK, "constants": {"w": rate}}
    found = case(scene, time={"final_time": 2.0})
    period = 2.0 * math.pi / rate
    assert found.plan.steps.time_step <= 1.01 * period / STEPS_PER_PERIOD
    if rate == 3.0:
        assert found.plan.shortest_period == math.inf
        assert not case_warnings(found)
    else:
        assert found.plan.shortest_period == pytest.approx(period, rel=0.01)
        assert found.plan.steps.time_step > 0.9 * period / STEPS_PER_PERIOD
        assert any("snapshots.every: snapshots" in told for told in case_warnings(found))
    longest = 0.5 * found.plan.limits.least
    if rate > 600.0:
        words = r"time\.step: the driving oscillates with a period of .* steps of at most"
        with pytest.raises(CaseError, match=words):
            case(scene, time={"final_time": 200 * longest, "step": longest})


def test_steps_resolve_the_fastest_driving_of_all_points() -> None:
    points = {"train": {"w": [3.0, 50.0]}, "test": {"w": [200.0]}}
    plan = case(TANK, parameters=points).plan
    assert plan.shortest_period == pytest.approx(2.0 * math.pi / 200.0, rel=0.01)
    periods = [plan.longest_step(point) * STEPS_PER_PERIOD for point in plan.points]
    assert periods[1:] == pytest.approx([2.0 * math.pi / 50.0, plan.shortest_period], rel=0.01)


@pytest.mark.parametrize("share", ["where(t < 1, 0, 1)", "where(t < 1, t, 1)", "tanh(50*(t - 1))"])
def test_jumps_and_ramps_are_no_oscillation(share: str) -> None:
    steady = case({**PLAIN, "body_force": ["0.1", 0]}).plan.steps
    plan = case({**PLAIN, "body_force": [f"0.1*{share}", 0]}).plan
    assert plan.shortest_period == math.inf
    assert plan.steps == steady


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ({"body_force": ["1/(t - 1)", 0]}, r"body_force: is not finite at t = 1 s"),
        ({"body_force": ["tan(0.5*t)", 0]}, r"body_force: is not finite at t = 3\.142 s"),
        ({"body_force": ["1/(x - 1.2345)**2", 0]}, r"body_force: is .* at \(1\.2345, "),
        (
            {"resistance": "1 - 3*exp(-((x - 1.012)/0.004)**2)"},
            r"resistance: is negative at \(1\.01",
        ),
        (
            {"resistance": "where(x > 1.002, where(x < 1.004, min(0, 1 - 2*y), 0), 0)"},
            r"resistance: is negative at \(1\.004, 0\.9",
        ),
        (
            {"resistance": "where(abs(x - 1.0037) + abs(y - 0.5033) < 1e-4, -5, 0)"},
            r"resistance: is negative at \(1\.00[34]\d*, 0\.503",
        ),
        (
            {"body_force": ["0/where(abs(x - 1.0037) < 1e-4, 0, 1)", 0]},
            r"body_force: is not a finite number at \(1\.003[678]",
        ),
        ({"initial": {"v": 1.0}}, r"initial: goes through the wall bottom at .* with 1 m/s"),
        ({"initial": {"u": 6.0}}, r"initial: reaches 6 m/s, 0\.6 times the speed of sound"),
        ({"initial": {"p": 1e6}}, r"initial\.p: 1e\+06 .* at 1 kg/m3 and .* check fluid"),
        ({"walls": {"top": {"velocity": [8, 0]}}}, r"walls\.top: reaches 8 m/s"),
    ],
)
def test_what_no_run_could_bear(scene: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        case({**PLAIN, **scene})


def test_a_spot_with_a_sudden_edge_between_samples_limits_the_step() -> None:
    """Its resistance is 125 /s, as that of a porous body in the same place."""
    found = case({**PLAIN, "resistance": "where(abs(x - 1.003) < 1e-3, 125, 0)"})
    assert found.plan.scene.largest_resistance(0.01) == 125.0
    assert found.plan.steps.time_step * 125.0 < 2.78


def test_a_thin_porous_body_is_told_and_its_resistance_limits_the_step() -> None:
    """It lies between samples, and hardly slows the flow; where it does, with nu/k = 125 /s."""
    body = {"rectangle": {"lower": [1.002, 0], "upper": [1.004, 1]}, "permeability": 8e-5}
    found = case({**PLAIN, "porous": {"plug": body}, "body_force": [1.0, 0]})
    assert found.plan.scene.largest_resistance(0.01) == pytest.approx(125.0)
    assert found.scene.porous_way == pytest.approx(0.002 / 8e-5)
    assert found.plan.steps.time_step * 125.0 < 2.78
    (told,) = (each for each in case_warnings(found) if "porous" in each)
    assert told.startswith("scene.porous.plug: is 0.002 m wide, less than the particle spacing")
    shared = {"plug": body, "half": {**body, "permeability": 1e-4}}
    both = case({**PLAIN, "porous": shared, "body_force": [1.0, 0]})
    assert both.plan.scene.largest_resistance(0.01) == pytest.approx(225.0)


@pytest.mark.parametrize(
    ("solids", "words"),
    [
        (
            {"a": {"circle": {"centre": [1, 0.3], "radius": 0.3}}},
            r"between a and bottom: let a dip into the wall, or leave [\d.]+ m between them",
        ),
        (
            {
                "a": {"circle": {"centre": [0.6, 0.5], "radius": 0.2}},
                "b": {"circle": {"centre": [1.01, 0.5], "radius": 0.2}},
            },
            r"at \(0\.805, 0\.5\) m, between a and b: let them overlap, join them into one solid",
        ),
    ],
)
def test_narrow_places_have_a_remedy(solids: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        case({**PLAIN, "solids": solids}, resolution=60)


def test_resolutions_that_would_do_are_near() -> None:
    disc = {"a": {"circle": {"centre": [1, 0.5], "radius": 0.3}}}
    with pytest.raises(CaseError, match=r"wide: \d+ would do"):
        case({**PLAIN, "solids": disc}, resolution=20)


def test_a_channel_that_is_blocked_or_winds() -> None:
    """The flow between two plates winds around their ends; one plate across blocks it."""
    plates = {
        "low": {"rectangle": {"lower": [0.3, 0], "upper": [0.5, 1.2]}},
        "high": {"rectangle": {"lower": [1.3, 0.8], "upper": [1.5, 2]}},
    }
    open_flow = inflow([1.0, 0], solids=plates)
    assert case(open_flow, resolution=40).plan.strip is not None
    across = {"low": {"rectangle": {"lower": [0.3, 0], "upper": [0.5, 2]}}}
    with pytest.raises(CaseError, match=r"scene\.inflow: solids block the flow along x"):
        case(inflow([1.0, 0], solids=across), resolution=40)


def test_places_of_particles_are_checked() -> None:
    """A row of particles lies at y = 0.5 + dx/2; no sample does."""
    narrow = "2*min(1, 1e4*abs(y - 0.5208333333333334)) - 1"
    with pytest.raises(
        CaseError, match=r"scene\.resistance: is negative at \(.*, 0\.520[78]\d+\) m"
    ):
        case({**PLAIN, "resistance": narrow}, resolution=24)
    assert np.isfinite(case({**PLAIN, "resistance": "1"}).plan.limits.least)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("body_force", ["sin(1e4*x)", 0], True),
        ("body_force", ["where(y > 0.4999, where(y < 0.5001, 1e3, 0), 0)", 0], True),
        ("body_force", ["sin(20*x)*cos(t)", 0], False),
        ("body_force", ["where(t < 2, t/2, 1)", 0], False),
        ("body_force", ["0.02*where(x > 0.51, 1, -1)", 0], False),
        ("resistance", "1 + sin(1e4*x)", True),
        ("resistance", "where(x > 1.5011, where(x < 1.5012, 50, 0), 0)", True),
        ("resistance", "where(x > 1.5, where(x < 1.6, 5, 0), 0)", False),
        ("resistance", "100*(x - 1)**8", False),
        ("inflow.velocity", ["1 + 0.9*sin(1e4*y)", 0], True),
        ("inflow.velocity", ["interp(y, 0, 0, 0.1, 1, 0.9, 1, 1, 0)", 0], False),
    ],
)
def test_fields_that_change_within_a_spacing_are_warned_of(key: str, value, told: bool) -> None:
    scene = PLAIN | ({key: value} if key != "inflow.velocity" else {})
    if key == "inflow.velocity":
        scene["inflow"] = {"strip": {"from": 0, "to": 0.9}, "velocity": value}
    found = [w for w in case_warnings(case(scene)) if "changes within a particle spacing" in w]
    assert [w.partition(": ")[0] for w in found] == [f"scene.{key}"] * told


def test_a_surface_force_that_is_narrow_is_warned_of() -> None:
    (told,) = case_warnings(case({**TANK, "body_force": ["x**1000", 0]}, fluid={}))
    assert told.startswith("scene.body_force: changes within a particle spacing of 0.03")
