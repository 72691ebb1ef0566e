"""How much a full run depends on its time step: the run again, with another one.

Starts where a stored full run does, after its spin-up if there is one, keeps the times of its
snapshots, and prints how far it comes from the stored run.

    python scripts/steps.py cases/open_cavity.yaml runs/reproduce/open-cavity/corrected \\
        --step 2.5e-5 --reynolds 2400 --until 5.2
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.console import Reporter
from sphrom.errors import CaseError, SphromError
from sphrom.kernels import ask_for_threads
from sphrom.metrics.histories import compare, errors_of, relative_l2
from sphrom.metrics.measures import Samples
from sphrom.models.starts import start
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.particles import sampler
from sphrom.sph.fluid import pressure_of
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.stored_run import probes_of
from sphrom.store.trajectory import snapshot_fields
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

SHOWN = (
    "velocity_field_relative_l2",
    "velocity_field_relative_l2_peak",
    "velocity_line_eq41_by_field_range_peak",
    "pressure_field_relative_l2",
    "pressure_field_relative_l2_peak",
    "pressure_line_eq41_by_field_range_peak",
)
LINES = 20
"""Lines that are printed as a run goes on."""


def main() -> int:
    """Run, and print the differences over time."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", type=Path)
    parser.add_argument("folder", type=Path, help="of the stored full run")
    parser.add_argument("--step", type=float, required=True, help="[s]")
    parser.add_argument("--reynolds", type=float, required=True)
    parser.add_argument("--until", type=float, metavar="TIME", help="[s], the end unless given")
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    ask_for_threads(arguments.threads)
    try:
        _print_differences(arguments)
    except SphromError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _print_differences(arguments: argparse.Namespace) -> None:
    case = load_case(arguments.case, [])
    quiet = Reporter(quiet=True)
    workspace = Workspace(StageContext(case, arguments.folder, False, None, quiet))
    point = next((p for p in case.plan.points if p.reynolds == arguments.reynolds), None)
    if point is None:
        runs = ", ".join(p.label for p in case.plan.points)
        raise CaseError(f"--reynolds {arguments.reynolds:g}: the case has {runs}")
    plan = case.plan.steps
    steps = _with_step(plan, arguments.step, arguments.until or plan.end_time)
    probes = probes_of(case)
    found, known = _both(workspace, point, steps, sampler(case, probes.all))
    errors = errors_of(compare(found, known, probes, from_time=plan.start_time))
    print(f"steps of {steps.time_step:g} s instead of {plan.time_step:g} s [%]")
    for name in SHOWN:
        print(f"{name:40} {errors[name]:.3g}")


def _with_step(plan: TimeSteps, step: float, end: float) -> TimeSteps:
    """Return steps that end at the times of a plan's snapshots, about as long as `step` [s].

    Raises CaseError where they don't fit between two snapshots, or end where nothing is stored.
    """
    if not 0.0 < step <= plan.snapshot_interval:
        raise CaseError(f"--step {step:g}: must be above 0 and at most {plan.snapshot_interval:g} "
                        "s, the time between snapshots")  # fmt: skip
    if not plan.start_time + plan.snapshot_interval <= end <= plan.end_time:
        raise CaseError(f"--until {end:g}: must be within what is recorded, {plan.start_time:g} s "
                        f"to {plan.end_time:g} s")  # fmt: skip
    every = round(plan.snapshot_interval / step)
    n_snapshots = round((end - plan.start_time) / plan.snapshot_interval)
    return TimeSteps(plan.snapshot_interval / every, n_snapshots * every, every, plan.start_time)


def _both(
    workspace: Workspace, point: ParameterPoint, steps: TimeSteps, sample: ReferenceMap
) -> tuple[Samples, Samples]:
    """Return the run with other steps, and the stored one, at the probes."""
    case, clock = workspace.case, Clock()
    begin = start(workspace, point)
    model = particles.functional(case, point)
    found: list[tuple[Array, Array]] = []
    known: list[tuple[Array, Array]] = []
    run = march(model, begin.state, steps, case.fluid.reference_density, clock, lambda _: None)
    with workspace.open(workspace.full_run(point)) as stored:
        for snapshot, (step, state) in enumerate(run):
            for fields, own in (
                (found, (state[:2].T, state[2], state[3:].T)),
                (known, snapshot_fields(stored, snapshot)),
            ):
                density, velocity = sample(*own)
                fields.append((velocity, pressure_of(density, case.plan.sound_speed)))
            if snapshot and snapshot % ceil(steps.n_snapshots / LINES) == 0:
                off = relative_l2(found[-1][0], known[-1][0], field_axes=2)
                print(f"t = {steps.time(step):.6g} s: velocity is off by {off:.3g} %, after "
                      f"{clock.seconds:.0f} s of computing", flush=True)  # fmt: skip
    times = np.array([steps.time(k * steps.every) for k in range(steps.n_snapshots)])
    return _samples(times, found), _samples(times, known)


def _samples(times: Array, snapshots: Sequence[tuple[Array, Array]]) -> Samples:
    velocity, pressure = (np.array(each) for each in zip(*snapshots, strict=True))
    return Samples(times, velocity, pressure)


if __name__ == "__main__":
    sys.exit(main())
