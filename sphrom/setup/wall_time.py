"""How long all stages of a case take, from a step of the full model that was timed here.

What a stage takes in steps was measured on the three demo cases; it is right within a factor of
two or so, as far as the stage goes with the number of particles.
"""

from __future__ import annotations

from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.case.studies import sweep_model, sweep_points

MAP_STEPS = 0.25
"""Mapping or sampling a snapshot, in steps of the full model."""
BASIS_STEPS = 20.0
"""The basis and its splines."""
OPERATOR_STEPS = 5.0
"""Operators of a basis, for each mode."""
PARTICLE_STEPS = 2.5
"""A step of a reduced model on particles."""
POINT_STEPS = 1.5
"""A step of one that evaluates the rates at all reference points."""
FAST_SECONDS = 0.1
"""A run from operators, its estimates and its file [s]."""
SWEPT_SECONDS = 5e-3
"""The same in a sweep [s]."""
FIGURE_SECONDS = 0.8
"""Drawing a figure [s]."""
FIGURES_OF_POINT, FIGURES_OF_BASIS = 4, 2


def full_seconds(case: Case, step: float, n_runs: int) -> float:
    """Return how long full runs take [s], a step taking `step` [s]."""
    plan = step_plan(case)
    return step * (plan.n_steps + plan.n_spin_up_steps) * n_runs


def wall_times(case: Case, step: float) -> dict[str, float]:
    """Return how long each stage takes [s] by its name, a step of the full model `step` [s]."""
    plan, points = step_plan(case), case.points
    times = {"fom": full_seconds(case, step, len(points))}
    if case.rom:
        columns = sum(
            max(_most_modes(case, model) for model in case.rom if model.on_points)
            for _ in case.reference_bases
        )
        times |= {
            "map": MAP_STEPS * step * plan.n_snapshots * len(points),
            "pod": BASIS_STEPS * step * len(case.bases),
            "operators": OPERATOR_STEPS * step * columns,
            "rom": sum(_reduced_seconds(case, model, step) for model in case.rom),
        }
    n_runs = sum(len(case.rom_points(model)) for model in case.rom)
    n_sampled = n_runs + (3 if case.rom else 1) * len(points)
    times["compare"] = MAP_STEPS * step * plan.n_snapshots * n_sampled
    if case.compare.plots:
        measured = len(case.scene.measure)
        n_figures = (FIGURES_OF_POINT + measured) * len(points)
        times["compare"] += FIGURE_SECONDS * (n_figures + FIGURES_OF_BASIS * len(case.bases))
    return times


def _most_modes(case: Case, model: ReducedModelSection) -> int:
    """Return the modes of a model, as many as it may have where training runs choose."""
    return case.n_modes if model.n_modes == AUTO else model.size


def _reduced_seconds(case: Case, model: ReducedModelSection, step: float) -> float:
    """Return how long all runs of a reduced model take [s]."""
    n_runs = len(case.rom_points(model))
    if model.from_operators:
        return FAST_SECONDS * n_runs
    plan = step_plan(case)
    number = plan.n_steps
    if not isinstance(model.time_step, str):
        number = round(plan.n_steps * plan.time_step / model.time_step)
    return (PARTICLE_STEPS if model.on_particles else POINT_STEPS) * step * number * n_runs


def sweep_seconds(case: Case, step: float) -> float:
    """Return how long the runs of a case's sweep take one after the other [s]."""
    model, number = sweep_model(case), len(sweep_points(case))
    if model is None:
        return full_seconds(case, step, number)
    if model.from_operators:
        return SWEPT_SECONDS * number
    return _reduced_seconds(case, model, step) / len(case.rom_points(model)) * number
