"""Fast models against interpolation of mapped training runs, at the test points of a case.

The case has two training values of the Reynolds number, and its stages have been made by
`sphrom run`. Errors are relative root mean squares over all reference points and snapshots, of
pressures less their mean: interpolation in 1/Re and log Re with ten modes and without a basis, the
nearest state of ten modes, and every model from operators, with the pressure that it has chosen.
Costs are processor times: of the stages, the largest of their runs, as stored, and of a run of each
model, the least of several, without and with fields at all snapshots and reference points.

    python scripts/space_interpolation.py CASE [--out FOLDER]
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sphrom.arrays import Array
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.console import SilentReporter
from sphrom.models.points.fast_model import FastModel
from sphrom.models.reference.stored import read_basis
from sphrom.reduction.trial_basis import project, reconstruct, truncate, weighted_mean
from sphrom.setup.context import StageContext
from sphrom.stages import folder_of
from sphrom.store.workspace import Workspace

N_MODES = 10
"""Number of modes in which runs are interpolated."""
N_TIMES = 5
Fields = tuple[Array, Array]
"""Density fluctuations (n_snapshots, n_points) and velocities (n_snapshots, n_points, n_dim)."""


def errors(found: Fields, exact: Fields, weights: Array) -> str:
    """Return the errors of velocity and pressure in words."""
    pairs = [(found[1], exact[1])]
    pairs += [tuple(f[0] - weighted_mean(f[0], weights)[:, None] for f in (found, exact))]
    shares = [100.0 * np.linalg.norm(f - e) / np.linalg.norm(e) for f, e in pairs]
    return "velocity {:.2f} %, pressure {:.2f} %".format(*shares)


def least_seconds(run: Callable[[], object], repeats: int) -> float:
    """Return the least of several processor times [s] of a run that is repeated without a break."""
    found = []
    for _ in range(N_TIMES):
        began = time.process_time()
        for _ in range(repeats):
            run()
        found.append((time.process_time() - began) / repeats)
    return min(found)


def show_costs(workspace: Workspace) -> None:
    """Print the processor times of stages and of fast models at the first test point."""
    case = workspace.case
    points = case.plan.points
    models = [section for section in case.rom if section.from_operators]
    stages = {
        "full run": [workspace.full_run(point) for point in points],
        "map": [workspace.mapped(point) for point in points],
        "pod": [workspace.basis()],
        "fit-psi": [workspace.splines()],
        "operators": [workspace.operators()],
        "training": [workspace.model(section) for section in models],
    }
    for name, targets in stages.items():
        seconds = []
        for target in targets:
            with workspace.open(target) as artifact:
                seconds.append(artifact.number("timing/processor"))
        print(f"  {name}: {max(seconds):.2g} s")
    point = case.plan.test_points[0]
    for section in models:
        model = FastModel(workspace, section)
        run = model.runner(point)
        basis = model.at_point(point).whole
        steps = least_seconds(run, 1000)
        fields = least_seconds(lambda m=model, b=basis: reconstruct(b, m.run(point).states), 1)
        print(f"  {section.name}: {1e6 * steps:.3g} us, with fields {1e3 * fields:.3g} ms")


def main() -> None:
    """Print the errors, and the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    case = load_case(given.case)
    folder = folder_of(case, given.out)
    workspace = Workspace(StageContext(case, folder, False, 1, SilentReporter()))
    plan = case.plan

    def mapped(point: ParameterPoint) -> Fields:
        with workspace.open(workspace.mapped(point)) as artifact:
            return artifact.read("density_fluctuation"), artifact.read("velocity")

    name = plan.reference_bases[0]
    basis = truncate(read_basis(workspace, name), N_MODES)
    low, high = plan.bases[name]
    ends = mapped(low), mapped(high)
    coordinates = [project(basis, *end) for end in ends]
    for point in plan.points:
        if point in (low, high):
            continue
        exact = mapped(point)

        def show(what: str, found: Fields, exact: Fields = exact) -> None:
            print(f"  {what}: {errors(found, exact, basis.weights)}")

        print(point.label)
        for what, scale in (("1/Re", lambda reynolds: 1.0 / reynolds), ("log Re", math.log)):
            at, start, end = (scale(p.reynolds) for p in (point, low, high))
            share = (at - start) / (end - start)
            first, last = coordinates
            states = (1.0 - share) * first + share * last
            show(f"{what}, {N_MODES} modes", reconstruct(basis, states))
            show(what, tuple((1.0 - share) * a + share * b for a, b in zip(*ends, strict=True)))
        show(f"nearest state, {N_MODES} modes", reconstruct(basis, project(basis, *exact)))
        for section in case.rom:
            if section.from_operators:
                model = FastModel(workspace, section)
                run = model.run(point)
                chosen = ", ".join(model.at_point(point).trained.pressure)
                words = f"{section.name}, pressure {chosen or 'joint'}"
                show(words, reconstruct(model.at_point(point).whole, run.states))
    show_costs(workspace)


if __name__ == "__main__":
    main()
