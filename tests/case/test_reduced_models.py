"""Keys of reduced models on particles and on the reference points, and what a user is told."""

from __future__ import annotations

import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.points import ParameterPoint

TRAINED = "parameters: {train: {reynolds: [100, 200]}}\n"
LID = "name: small\nscene:\n  kind: lid-driven-cavity\n"
OPEN = "name: small\nscene:\n  kind: open-cavity\n"
OUTSIDE = (
    "rom.0.parameters: reynolds=300 is outside of the trained range, 100 to 200 of reynolds: a "
    "reduced model extrapolates there"
)


def fast(**keys: object) -> str:
    """Return a list with one model on the reference points."""
    given = "".join(f", {key}: {value}" for key, value in keys.items())
    return f"rom: [{{name: x, evaluation: operators{given}}}]\n"


@pytest.mark.parametrize(
    ("base", "key", "given", "needed"),
    [
        (None, "viscosity", "paper", "laplacian"),
        (OPEN, "walls.kind", "normal", "mirrored or adjoint"),
        (LID, "walls.kind", "printed", "mirrored or adjoint"),
    ],
)
def test_readings_that_fixed_points_do_not_have(load, refusal, base, key, given, needed):
    bases = {} if base is None else {"base": base}
    override = f"discretization.{key}={given}"
    (line,) = refusal(fast(), override, **bases)
    assert line.startswith(f"--set: discretization.{key}: must be {needed} for models with")
    assert not load("rom: [{name: x}]\n", override, **bases).rom[0].from_operators


def test_values_without_a_full_run_are_for_the_reference_points(load):
    case = load(TRAINED + fast(parameters=[100, 150]))
    assert case.plan.rom_points(case.rom[0]) == (ParameterPoint(100.0), ParameterPoint(150.0))
    assert case.plan.points == (ParameterPoint(100.0), ParameterPoint(200.0))
    assert case_warnings(case) == []


def test_values_without_a_spin_up_start_from_the_nearest_that_has_one(load):
    case = load(TRAINED + fast(parameters=[100, 130, 170, 300]), base=OPEN)
    starts = [case.plan.start_point(point).reynolds for point in case.plan.rom_points(case.rom[0])]
    assert starts == [100.0, 100.0, 200.0, 200.0]
    told = [warning for warning in case_warnings(case) if "spin-up" in warning]
    assert told[0] == (
        "rom.0.parameters: reynolds=130 has no spin-up of its own, so its run starts from the "
        "spin-up of the nearest training run, reynolds=100"
    )
    assert len(told) == 3
    assert OUTSIDE in case_warnings(case)


def test_sound_can_grow_in_the_raw_product(load):
    raw = "basis: {inner_product: raw}\n"
    assert case_warnings(load(raw + "rom: [{name: x}]\n")) == []
    (warning,) = case_warnings(load(raw + fast()))
    assert warning.startswith("basis.inner_product: with the raw product, sound may grow")


def test_closures_are_made_for_each_basis_and_size_once(load):
    case = load(
        TRAINED + "basis: {subsets: {low: {reynolds: [100]}}}\n"
        "rom:\n"
        "- {name: a, evaluation: operators, projection: apg, n_modes: 4}\n"
        "- {name: b, evaluation: operators, projection: apg, n_modes: 4, memory_length: 0}\n"
        "- {name: c, evaluation: operators, projection: apg, n_modes: 3, basis: low}\n"
        "- {name: d, evaluation: operators, n_modes: 5}\n"
        "- {name: e, projection: apg, n_modes: 2}\n"
    )
    assert case.plan.memory_models == (("all", 4), ("low", 3))
    assert case.plan.reference_bases == ("all", "low")


def test_only_bases_of_models_that_are_taught_keep_their_training_runs(load):
    basis = "basis: {subsets: {low: {reynolds: [100]}, high: {reynolds: [200]}}}\n"
    plain = "evaluation: operators, calibrated: false"
    case = load(
        TRAINED + basis + "rom:\n"
        f"- {{name: a, {plain}, corrected: false}}\n"
        "- {name: b, evaluation: operators, basis: high}\n"
        f"- {{name: c, {plain}, basis: low}}\n"
    )
    assert case.plan.corrected_bases == ("high",)
    assert load(TRAINED + basis + f"rom: [{{name: a, {plain}}}]\n").plan.corrected_bases == ("all",)
    assert load("rom: [{name: particles}]\n").plan.corrected_bases == ()


def test_as_many_modes_as_are_best_are_at_most_those_of_the_basis(load):
    model = "rom: [{name: x, evaluation: operators, n_modes: auto}]\n"
    case = load(TRAINED + model)
    assert (case.plan.n_modes, case.plan.sized_bases) == (20, ("all",))
    assert load(TRAINED + model + "basis: {n_modes: 12}\n").plan.n_modes == 12
    assert load(TRAINED + model.replace("auto", "7")).plan.sized_bases == ()
    with pytest.raises(ValueError, match="auto"):
        case.rom[0].size  # noqa: B018


def test_runs_may_end_later_than_full_runs(load, refusal):
    model = "rom: [{name: x, evaluation: operators, until: %s}]\n"
    time = "time: {final_time: 1.0, step: 2e-3}\nsnapshots: {every: 25}\n"
    case = load(time + model % 10)
    assert case.plan.model_steps(case.rom[0]).n_snapshots == 201
    assert not case.plan.ends_with_case(case.rom[0])
    assert load(time + model % 1).plan.ends_with_case(case.rom[0].model_copy(update={"until": 1.0}))
    (warning,) = (text for text in case_warnings(case) if "rom.0.until" in text)
    assert warning == "rom.0.until: after 1 s the run is beyond the trained time"
    rounded = load(time + model % 10.02)
    assert rounded.plan.model_steps(rounded.rom[0]) == case.plan.model_steps(case.rom[0])
    moved = "rom.0.until: runs end at 10 s, not 10.02 s, because snapshots are 0.05 s apart"
    assert moved in case_warnings(rounded)
    (line,) = refusal(time + model % 0.02)
    assert "rom.0.until: must be 0.05 s, the time of the second snapshot, or later" in line
    (line,) = refusal(time + "rom: [{name: x, until: 2}]\n")
    assert "rom.0.until: is only for evaluation: operators" in line
