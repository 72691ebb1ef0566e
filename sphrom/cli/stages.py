"""The commands of the stages, and of the studies that run many models, or one many times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from sphrom.cli import commands
from sphrom.cli.options import BY_POINT, OF_RUNS, WHOLE, ForceRun, Options, command
from sphrom.errors import CaseError

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
"""The options and the help of stages that have no options of their own, by their commands."""
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Run on the workers of this Dask scheduler, such as tcp://node1:8786.",
    ),
]
ForceSweep = Annotated[
    bool, typer.Option("--force", help="Start anew; insist on a step beyond its limit.")
]
ForceTrain = Annotated[
    bool,
    typer.Option("--force", help="Choose anew; write over runs of another case; insist on a step."),
]
OF_RUN = (*WHOLE, "resume", "every")
WITHOUT_THREADS = tuple(name for name in WHOLE if name != "threads")
"""Options of a command whose workers have a thread each."""


def add_stages(app: typer.Typer) -> None:
    """Add the command of every stage and study, in the order in which help lists them."""
    for name, (taken, text) in _STAGES.items():
        command(app, name, taken, text)(_stage(name.replace("-", "_")))
    command(app, "run", OF_RUN, force=ForceRun)(run)
    command(app, "trade", (*BY_POINT, "every"))(trade)
    command(app, "sweep", WITHOUT_THREADS, force=ForceSweep)(sweep)
    command(app, "fit", WITHOUT_THREADS)(fit)
    command(app, "train", force=ForceTrain)(train)


def _stage(name: str) -> Callable[[Options], None]:
    def stage(options: Options) -> None:
        commands.run_stage(name, options)

    return stage


def run(options: Options) -> None:
    """Run all stages that are needed, keeping what is there and valid.

    \b
    Example, the whole pipeline on a coarser grid, in a folder of its own:
      sphrom run cases/taylor_green_demo.yaml --set discretization.resolution=40 --out runs/coarse
    """
    commands.run_stage("pipeline", options)


def trade(
    options: Options,
    tolerance: Annotated[
        str | None,
        typer.Option(
            "--tolerance",
            metavar="PERCENT",
            help="Name the cheapest model within it, such as 1% of velocity and pressure "
            "alike, or 0.5%,3% of each.",
        ),
    ] = None,
    extremes: Annotated[
        bool,
        typer.Option("--extremes", help="Map where models on the reference points are stable."),
    ] = False,
) -> None:
    """Weigh speed against accuracy: run and time the models that the case lists.

    Writes tables and a plot with the Pareto front into the folder trade of the case's artifacts,
    which have to be there. Full runs at other steps and resolutions are kept in folders below it:
    after a stop the same command goes on from them.

    \b
    Example, after a run of the case: the cheapest model that is wrong by no more than one percent:
      sphrom trade cases/taylor_green_demo.yaml --tolerance 1%
    """
    if not extremes:
        commands.run_stage("trade", options, tolerance=tolerance)
    elif tolerance is None:
        commands.run_stage("extremes", options)
    else:
        raise CaseError("--tolerance: is not for --extremes, which weighs no models")


def sweep(
    options: Options,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            min=1,
            metavar="N",
            help="Processes to run at once.  [default: one a core, as far as memory goes]",
        ),
    ] = None,
    scheduler: Scheduler = None,
    shard: Annotated[
        str | None,
        typer.Option(
            "--shard", metavar="I/N", help="Make the I-th of N shares only, as one job of a batch."
        ),
    ] = None,
    collect: Annotated[
        bool, typer.Option("--collect", help="Make no runs: gather those of the shards.")
    ] = False,
) -> None:
    """Run one model at many parameter values: sweep-<name>.h5 and sweep-<name>.csv.

    The section sweep of the case names the model and the values: a reduced model, whose runs on
    reference points take milliseconds, or the full one. Finished runs are kept: the same command
    goes on where a sweep was stopped, and with more values makes the new runs only. A run that
    fails is recorded, and the others go on; exit code 4 says that one became unstable.

    With --scheduler the workers of a Dask cluster make the runs; they need sphrom, and the folder
    of the artifacts under the same path: `dask scheduler` on one machine, `dask worker ADDRESS
    --nworkers auto --nthreads 1` on each. With --shard, each of N jobs of a batch queue makes its
    share, and the last one gathers the results.

    \b
    Example, a thousand reduced runs after a run of the case:
      sphrom sweep cases/taylor_green_demo.yaml
    """
    asked = {
        "workers": workers,
        "scheduler": scheduler,
        "shard": commands.parse_shard(shard),
        "collect": collect,
    }
    commands.run_stage("sweep", options, **{name: value for name, value in asked.items() if value})


def fit(
    options: Options,
    measurements: Annotated[
        Path,
        typer.Argument(
            metavar="MEASUREMENTS",
            help="Measured histories (CSV), a column for each, such as time, wake_u, drag_x.",
            show_default=False,
        ),
    ],
    noise: Annotated[
        str | None,
        typer.Option(
            "--noise",
            metavar="PERCENT",
            help="Standard deviation of the noise over each history's range, such as 1%, where no "
            "column says one.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            "--name",
            metavar="NAME",
            help="What the files are called: fit-NAME.h5.  [default: as the measurements]",
        ),
    ] = None,
) -> None:
    """Find parameters from measured histories: fit-<name>.h5, .csv and .png.

    A model with evaluation: operators is fitted to histories of probes, forces and flow rates: the
    case's own (time, wake_u, wake_v, drag_x, ...), or of any place (time, x, y, u, v, pressure).
    The section fit of the case says which parameters are looked for, and in which ranges: by
    default all that vary, where the model was trained. Estimates have 95 % intervals, in which the
    model's own errors count beside the noise; what the data don't determine is said.

    \b
    Example, with noise of 1 % of each history's range, the lid's speed known:
      sphrom fit cavity.yaml probes.csv --noise 1% --set fit.parameters.lid=0.8
    """
    commands.run_stage("fit", options, measurements=measurements, noise=noise, name=name)


def train(
    options: Options,
    tolerance: Annotated[
        str | None,
        typer.Option("--tolerance", metavar="PERCENT", help="Error allowed, such as 1%."),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option("--budget", min=2, metavar="N", help="Most full runs to learn from."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            min=1,
            metavar="N",
            help="Full runs to choose and make at once.  [default: the first ones on all cores, "
            "then one at a time, which takes the fewest]",
        ),
    ] = None,
    scheduler: Scheduler = None,
    write_case: Annotated[
        Path | None,
        typer.Option(
            "--write-case",
            metavar="FILE",
            help="Where the case with the chosen points goes.  [default: training/case.yaml beside "
            "the artifacts]",
        ),
    ] = None,
) -> None:
    """Choose the full runs that a model needs to be within a tolerance anywhere in a region.

    The section training of the case has the region, such as reynolds: [50, 1000]. The model's
    error is estimated at many points, the full model is run where it is worst, and the model
    learns from it, until the estimate is within the tolerance everywhere or the budget is spent.
    Every run is predicted before it is learnt from, which tests the estimate and corrects it.

    Full runs and maps are those of the case. The same command goes on where it was stopped, also
    with another tolerance or budget. The case that it writes has the chosen points: run, sweep and
    trade go on with it. Exit code 4 says that a full run became unstable; that the tolerance isn't
    reached, a warning.

    \b
    Example, a model that is wrong by no more than one percent, from at most eight full runs:
      sphrom train case.yaml --set 'training.reynolds=[50, 1000]' --tolerance 1% --budget 8
    """
    commands.run_stage(
        "train",
        options,
        tolerance=tolerance,
        budget=budget,
        workers=workers,
        scheduler=scheduler,
        write_case=write_case,
    )
