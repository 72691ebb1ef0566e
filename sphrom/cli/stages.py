"""The commands of the stages, which differ in their options and help alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, Signature
from typing import Any

import typer

from sphrom.cli import commands, options
from sphrom.cli.commands import Options

_OPTIONS: Mapping[str, tuple[Any, object]] = {
    "case": (options.CaseFile, Parameter.empty),
    "out": (options.Out, None),
    "overrides": (options.Set, None),
    "force": (options.Force, False),
    "threads": (options.Threads, None),
    "quiet": (options.Quiet, False),
    "verbose": (options.Verbose, False),
    "log": (options.Log, None),
    "only": (options.Only, None),
    "resume": (options.Resume, False),
    "every": (options.CheckpointEvery, 60.0),
}
"""Options of stages, with their defaults, by the fields of `commands.Options`."""
WHOLE = tuple(_OPTIONS)[:8]
"""Options of a stage that takes the whole case."""
BY_POINT = (*WHOLE, "only")
"""The same of one that may be run at some parameter values only."""
OF_RUNS = tuple(_OPTIONS)
"""The same of one whose long runs may be stopped and resumed."""
_STAGES: Mapping[str, tuple[Sequence[str], str]] = {
    "fom": (
        OF_RUNS,
        """Run the full model at every parameter value: fom-<parameters>.h5.

    Where the case has a spin-up, its end is kept in spin-up-<parameters>.h5, and what is recorded
    after it can be run again from there. A run that is stopped leaves a checkpoint beside its
    artifact; --resume continues it, to the same artifact bit for bit.

    \b
    Example, one value on two threads, and the same after it was stopped:
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --threads 2
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --threads 2 --resume
    """,
    ),
    "map": (
        BY_POINT,
        """Map snapshots onto the reference space: map-<parameters>.h5.

    \b
    Example, with the Shepard filter, into a folder that already holds the full runs:
      sphrom map cases/taylor_green_demo.yaml --out runs/demo --set reference.method=shepard
    """,
    ),
    "pod": (
        WHOLE,
        """Extract the trial basis from the mapped snapshots: pod.h5.

    \b
    Example, with 20 modes, writing over an earlier basis:
      sphrom pod cases/taylor_green_demo.yaml --set basis.n_modes=20 --force
    """,
    ),
    "fit-psi": (
        WHOLE,
        """Fit splines to the modes: psi.h5.

    \b
    Example, with splines of a higher order:
      sphrom fit-psi cases/taylor_green_demo.yaml --set psi.order=5 --set psi.polynomial_degree=2
    """,
    ),
    "operators": (
        WHOLE,
        """Project the right-hand side on the reference points onto the basis: operators.h5.

    For reduced models with evaluation: operators; their cost is independent of the number of
    particles.

    \b
    Example, without the data for error estimates:
      sphrom operators cases/taylor_green_demo.yaml --set operators.error_estimate=false
    """,
    ),
    "rom": (
        OF_RUNS,
        """Run the reduced models: rom-<name>-<parameters>.h5.

    A model that isn't evaluated on particles may list values in its parameters at which no full
    run is made.

    \b
    Example, a value that the basis was not trained on, and one model alone:
      sphrom rom cases/taylor_green_demo.yaml --only reynolds=150
      sphrom rom cases/taylor_green_demo.yaml --only fast-m5
    """,
    ),
    "compare": (
        WHOLE,
        """Compare reduced with full runs: tables, figures, compare.h5.

    \b
    Example, leaving out the start, where the flow settles:
      sphrom compare cases/taylor_green_demo.yaml --set compare.from_time=0.1
    """,
    ),
    "figures": (
        WHOLE,
        """Draw the figures that a case asks for in compare.figures: figures/<name>.png.

    Fields of particles as they are at an instant, profiles, errors over time by Eq. 4.1, singular
    values and modes. Runs and their comparison have to be there.

    \b
    Example, the paper's figures of the Taylor-Green vortex on a coarse grid:
      sphrom run cases/taylor_green.yaml --set discretization.resolution=40 --out runs/coarse
      sphrom figures cases/taylor_green.yaml --set discretization.resolution=40 --out runs/coarse
    """,
    ),
    "report": (
        WHOLE,
        """Write one HTML page of a case and its results: report.html.

    It shows what compare found, and trade where that has run; it needs no network to be read.

    \b
    Example:
      sphrom run cases/taylor_green_demo.yaml
      sphrom report cases/taylor_green_demo.yaml
    """,
    ),
}
"""The options and the help of the stages, by the names of their commands."""


def add_stages(app: typer.Typer) -> None:
    """Add the command of every stage."""
    for name, (taken, text) in _STAGES.items():
        app.command(name, help=text)(_command(name.replace("-", "_"), taken))


def _command(stage: str, taken: Sequence[str]) -> Callable[..., None]:
    """Return the command of a stage that has some of the options."""

    def command(**given: Any) -> None:
        for key in {"overrides", "only"} & given.keys():
            given[key] = given[key] or ()
        commands.run_stage(stage, Options(**given))

    command.__signature__ = Signature(  # type: ignore[attr-defined]
        [
            Parameter(key, Parameter.KEYWORD_ONLY, annotation=kind, default=default)
            for key, (kind, default) in _OPTIONS.items()
            if key in taken
        ]
    )
    return command
