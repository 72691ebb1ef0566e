"""The commands that run many models, or one model many times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from sphrom.cli import commands
from sphrom.cli.commands import Options
from sphrom.cli.options import (
    CaseFile,
    CheckpointEvery,
    Force,
    Log,
    Only,
    Out,
    Quiet,
    Set,
    Threads,
    Verbose,
)
from sphrom.errors import CaseError

Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Run on the workers of this Dask scheduler, such as tcp://node1:8786.",
    ),
]


def trade(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    log: Log = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            "--tolerance",
            metavar="PERCENT",
            help="Name the cheapest model within it, such as 1% of velocity and pressure "
            "alike, or 0.5%,3% of each.",
        ),
    ] = None,
    only: Only = None,
    extremes: Annotated[
        bool,
        typer.Option("--extremes", help="Map where models on the reference points are stable."),
    ] = False,
    checkpoint_every: CheckpointEvery = 60.0,
) -> None:
    """Weigh speed against accuracy: run and time the models that the case lists.

    Writes tables and a plot with the Pareto front into the folder trade of the case's artifacts,
    which have to be there. Full runs at other steps and resolutions are kept in folders below it:
    after a stop the same command goes on from them.

    \b
    Example, after a run of the case: the cheapest model that is wrong by no more than one percent:
      sphrom trade cases/taylor_green_demo.yaml --tolerance 1%
    """
    options = Options(case, out, set_ or (), force, threads, quiet, only or ())
    options = replace(options, verbose=verbose, log=log, every=checkpoint_every)
    if not extremes:
        commands.run_stage("trade", options, tolerance=tolerance)
    elif tolerance is None:
        commands.run_stage("extremes", options)
    else:
        raise CaseError("--tolerance: is not for --extremes, which weighs no models")


def sweep(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: Annotated[
        bool, typer.Option("--force", help="Start anew; insist on a step beyond its limit.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    log: Log = None,
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
    commands.run_stage(
        "sweep",
        Options(case, out, set_ or (), force, None, quiet, verbose=verbose, log=log),
        **{name: value for name, value in asked.items() if value},
    )


def fit(
    case: CaseFile,
    measurements: Annotated[
        Path,
        typer.Argument(
            metavar="MEASUREMENTS",
            help="Measured histories (CSV), a column for each, such as time, wake_u, drag_x.",
            show_default=False,
        ),
    ],
    out: Out = None,
    set_: Set = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    log: Log = None,
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
    """Find parameters from measured histories: fit-<name>.h5, .csv, .json and .png.

    A model with evaluation: operators is fitted to histories of probes, forces and flow rates: the
    case's own (time, wake_u, wake_v, drag_x, ...), or of any place (time, x, y, u, v, pressure).
    The section fit of the case says which parameters are looked for, and in which ranges: by
    default all that vary, where the model was trained. Estimates have 95 % intervals, in which the
    model's own errors count beside the noise; what the data don't determine is said.

    \b
    Example, with noise of 1 % of each history's range, the lid's speed known:
      sphrom fit cavity.yaml probes.csv --noise 1% --set fit.parameters.lid=0.8
    """
    commands.run_stage(
        "fit",
        Options(case, out, set_ or (), force, None, quiet, verbose=verbose, log=log),
        measurements=measurements,
        noise=noise,
        name=name,
    )


def train(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Choose anew; write over runs of another case; insist on a step."
        ),
    ] = False,
    threads: Threads = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    log: Log = None,
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
        Options(case, out, set_ or (), force, threads, quiet, verbose=verbose, log=log),
        tolerance=tolerance,
        budget=budget,
        workers=workers,
        scheduler=scheduler,
        write_case=write_case,
    )
