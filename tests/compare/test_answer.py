"""The answer of a case in sentences."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from sphrom.compare.answer import Answer, _by_preference
from sphrom.compare.comparison_tables import SLOW_PRESSURE, SOUND, ErrorRow, Tables
from sphrom.compare.costs import RunTiming, taking_turns
from sphrom.compare.measured import MeasureRow
from sphrom.metrics.histories import NO_ERRORS

TIMING = RunTiming("fast", "reynolds=150", 5, 0.01, 0.01, None, 0.1, 1e-5, 1e4, 1.0, 1.0)
ANSWER = Answer(
    row=ErrorRow("fast", "full", "reynolds=150", 5, "predicted", "complete", NO_ERRORS),
    n_points=1,
    error=(0.16, 1.9),
    best=(0.15, 1.8),
    estimate=(0.19, 2.3),
    timing=TIMING,
    offline_seconds=0.35,
    training_seconds=0.2,
    n_training=2,
)


def told(answer: Answer) -> str:
    return " ".join(answer.sentences())


def test_it_says_how_far_off_how_fast_and_when_it_pays() -> None:
    text = told(ANSWER)
    for part in ("0.16 % in velocity and 1.9 %", "nearest state in its basis: 0.15 % and 1.8 %",
                 "estimate: 0.19 %", "10,000 times as long", "takes 10 µs, the full run 100 ms",
                 "from 4 runs on"):  # fmt: skip
        assert part in text
    spread = replace(TIMING, least_speed_up=9.1e3, greatest_speed_up=1.23e4)
    several = "10,000 (9,100 to 12,000 over 5 repeats) times as long"
    assert several in told(replace(ANSWER, timing=spread))


def test_an_error_far_above_its_estimate_is_told_with_a_cure() -> None:
    text = told(replace(ANSWER, error=(0.16, 33.0), estimate=(0.19, 4.1)))
    assert "The error of the pressure is 8.0 times its estimate: add a training run" in text
    assert "times its estimate" not in told(ANSWER)


def test_it_tells_a_pressure_error_that_is_sound() -> None:
    def with_sound(sound: float | None) -> str:
        errors = {**NO_ERRORS, SOUND: sound, SLOW_PRESSURE: 0.4}
        return told(replace(ANSWER, row=replace(ANSWER.row, errors=errors)))

    assert "1.8 % is sound or particle noise" in with_sound(1.8)
    assert "the pressures differ by 0.40 %" in with_sound(1.8)
    for quiet in (with_sound(0.9), with_sound(None), told(ANSWER)):
        assert "sound" not in quiet


def test_nothing_is_divided_by_the_seconds_that_an_import_states() -> None:
    imported = replace(TIMING, full_step=None, full_seconds=7.0, speed_up=None)
    answer = replace(ANSWER, timing=imported)
    assert "The full run took 7 s, as stated at its import. No speed-up" in told(answer)
    assert "times as long" not in told(answer)
    assert answer.pays_from is None


def test_runs_are_timed_in_turns() -> None:
    calls: list[str] = []
    timers = {name: lambda name=name: calls.append(name) or len(calls) for name in "ab"}
    found = {name: each.tolist() for name, each in taking_turns(timers, 2).items()}
    assert (calls, found) == (list("ababab"), {"a": [3, 5], "b": [4, 6]})


def test_it_says_how_far_off_measured_forces_are() -> None:
    parts = {
        "unit": "N/m", "compared": "fast", "parameters": "", "n_modes": 5, "role": "", "mean": 0.0,
        "from_time": 2.0, "least": 0.0, "greatest": 0.0, "vector_relative_l2": 9.7, "remark": "",
        "relative_l2_peak": None, "vector_estimated": None, "rms_error": 49.0,
        "without_sound": 0.9, "sound": 1.3,
    }  # fmt: skip
    along = MeasureRow("drag", "force_x", relative_l2=1.5, estimated=8.0, **parts)
    parts["remark"] = "only noise"
    across = MeasureRow("drag", "force_y", relative_l2=None, estimated=None, **parts)
    best = (replace(along, relative_l2=0.87),)
    text = told(replace(ANSWER, loads=(along, across), nearest_loads=best, times="late: drag"))
    assert "Late: drag. The measured force (drag) differs over time, as a vector by 9.7 %, " in text
    assert "force x by 1.5 % (without sound 0.90 %, share of sound 1.3 %, nearest " in text
    assert " nearest state 0.87 %, estimate 8.0 %); force y: only noise " in text
    assert "in the full run, the difference is 49 N/m." in text


def test_it_is_about_values_between_training_then_about_the_worst_outside() -> None:
    text = told(replace(ANSWER, outside=(2, "reynolds=400", (12.0, 34.0))))
    between = text.index("At reynolds=150, which was not simulated for training, fast")
    outside = text.index(
        "At reynolds=400, which lies outside of the trained values, the worst of 2 such values, it "
        "differs by 12 % in velocity and 34 % in pressure."
    )
    assert between < outside


def test_an_unphysical_full_run_is_told_first() -> None:
    assert told(replace(ANSWER, unphysical=("The run is unphysical.",))).startswith("The run is un")


def errors_of(velocity: float, pressure: float) -> dict[str, float | None]:
    own = {"velocity_field_relative_l2": velocity, "pressure_field_relative_l2": pressure}
    return {**NO_ERRORS, **own}


def test_the_recommended_model_is_the_fastest_of_the_most_accurate() -> None:
    """Between the training values; errors outside don't count, and within a tenth are alike."""
    figures = {
        "coarse": ("predicted", 0.5, 9.0, 1e-6, True),
        "slow": ("predicted", 0.1, 3.0, 1e-4, True),
        "quick": ("predicted", 0.2, 3.2, 1e-5, True),
        "particles": ("predicted", 0.01, 1.0, 1e-1, False),
    }
    tables, rom = Tables(), []
    for name, (role, velocity, pressure, seconds, fast) in figures.items():
        row = replace(ANSWER.row, compared=name, role=role, errors=errors_of(velocity, pressure))
        far = replace(row, role="extrapolated", errors=errors_of(50.0 / pressure, 99.0))
        tables.errors.extend([row, far])
        tables.timings.append(replace(TIMING, model=name, reduced_seconds=seconds))
        rom.append(SimpleNamespace(name=name, family="points" if fast else "particles"))
    case = SimpleNamespace(rom=rom, plan=SimpleNamespace(family=lambda model: model.family))
    names = [model.name for model in _by_preference(case, tables)]
    assert names == ["quick", "slow", "coarse", "particles"]
    tables.errors.append(replace(tables.errors[4], status="unstable", errors=NO_ERRORS))
    assert _by_preference(case, tables)[0].name == "slow"
