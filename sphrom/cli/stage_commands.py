"""The commands of stages, of studies that run many models, and of import and export."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from sphrom.cli.cases import write_new
from sphrom.cli.options import (
    ALL,
    BY_POINT,
    WHOLE,
    WITHOUT_THREADS,
    Options,
    argument,
    command,
    option,
    parameters_of,
    run_stage,
    stage_command,
)
from sphrom.errors import CaseError
from sphrom.exchange.import_options import ImportOptions

stages = typer.Typer()
Scheduler = Annotated[
    str | None,
    option("ADDRESS", "Run on the workers of this Dask scheduler, such as tcp://node1:8786."),
]
Workers = Annotated[
    int | None,
    option("N", "Processes to run at once.  [default: all cores; while train chooses, one]", min=1),
]
OF_FILES = ("case", "out", "overrides", "force", "quiet", "only")
"""The options of commands that take or make other programs' files."""


@stage_command(stages, "fom", ALL)
def fom(options: Options) -> None:
    """Run the full model at every parameter value: fom-<parameters>.h5.

    A run that is stopped leaves a checkpoint beside its artifact; --resume continues it, to the
    same artifact bit for bit. The end of a spin-up is kept in spin-up-<parameters>.h5.

    \b
    Example, one value, and the same after it was stopped:
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --resume
    """


@stage_command(stages, "map", BY_POINT)
def map_(options: Options) -> None:
    """Map snapshots onto the reference space: map-<parameters>.h5.

    \b
    Example, in a folder that already holds the full runs:
      sphrom map cases/taylor_green_demo.yaml --out runs/demo
    """


@stage_command(stages, "pod")
def pod(options: Options) -> None:
    """Extract the trial basis from the mapped snapshots: pod.h5.

    \b
    Example, with 20 modes, writing over an earlier basis:
      sphrom pod cases/taylor_green_demo.yaml --set basis.n_modes=20 --force
    """


@stage_command(stages, "fit-psi")
def fit_psi(options: Options) -> None:
    """Fit splines to the modes: psi.h5.

    \b
    Example, with splines of a higher order:
      sphrom fit-psi cases/taylor_green_demo.yaml --set psi.order=5
    """


@stage_command(stages, "operators")
def operators(options: Options) -> None:
    """Project the right-hand side on the reference points onto the basis: operators.h5.

    For reduced models with evaluation: operators; their cost is independent of the number of
    particles.

    \b
    Example:
      sphrom operators cases/taylor_green_demo.yaml
    """


@stage_command(stages, "rom", ALL)
def rom(options: Options) -> None:
    """Run the reduced models: rom-<name>-<parameters>.h5.

    A model that isn't evaluated on particles may list values in its parameters at which no full
    run is made.

    \b
    Example, a value that the basis was not trained on, and one model alone:
      sphrom rom cases/taylor_green_demo.yaml --only reynolds=150
      sphrom rom cases/taylor_green_demo.yaml --only fast-m5
    """


@stage_command(stages, "compare")
def compare(options: Options) -> None:
    """Compare reduced with full runs: tables, figures, compare.h5.

    \b
    Example, leaving out the start, where the flow settles:
      sphrom compare cases/taylor_green_demo.yaml --set compare.from_time=0.1
    """


@stage_command(stages, "figures")
def figures(options: Options) -> None:
    """Draw the figures that a case asks for in compare.figures: figures/<name>.png.

    Runs and their comparison have to be there.

    \b
    Example, the paper's figures of the Taylor-Green vortex:
      sphrom run cases/taylor_green_paper.yaml
      sphrom figures cases/taylor_green_paper.yaml
    """


@stage_command(stages, "report")
def report(options: Options) -> None:
    """Write one HTML page of a case and its results: report.html.

    It shows what compare found, and trade, train and all sweeps of the folder where they have run;
    it needs no network to be read.

    \b
    Example:
      sphrom run cases/taylor_green_demo.yaml
      sphrom report cases/taylor_green_demo.yaml
    """


@stage_command(stages, "run", (*WHOLE, "resume", "checkpoint_every"))
def run(options: Options) -> None:
    """Run all stages that are needed, keeping what is there and valid.

    \b
    Example, the whole pipeline with a longer step, in a folder of its own:
      sphrom run cases/taylor_green_demo.yaml --out coarse --set time.step=0.01
    """


@command(stages, "trade", (*BY_POINT, "checkpoint_every"))
def trade(
    options: Options,
    tolerance: Annotated[
        str | None,
        option(
            "PERCENT", "Name the cheapest model within 1%, or 0.5%,3% of velocity and pressure."
        ),
    ] = None,
    extremes: Annotated[
        bool, typer.Option("--extremes", help="Map where models are stable, and where right.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="Map the extremes with fewer values and full runs.")
    ] = False,
) -> None:
    """Weigh speed against accuracy: run and time the models that the case lists.

    Writes tables and a plot with the Pareto front into the folder trade beside the artifacts, which
    have to be there. Further full runs are kept below it: the same command goes on from them.

    \b
    Example, after a run: the cheapest model that is wrong by at most one percent:
      sphrom trade cases/taylor_green_demo.yaml --tolerance 1%
    """
    if extremes and tolerance is not None:
        raise CaseError("--tolerance: is not for --extremes, which weighs no models")
    if quick and not extremes:
        raise CaseError("--quick: is for --extremes")
    if extremes:
        run_stage("extremes", options, quick=quick)
    else:
        run_stage("trade", options, tolerance=tolerance)


@command(stages, "sweep", WITHOUT_THREADS)
def sweep(
    options: Options,
    workers: Workers = None,
    scheduler: Scheduler = None,
    shard: Annotated[
        str | None, option("I/N", "Make the I-th of N shares only, as one job of a batch.")
    ] = None,
    collect: Annotated[
        bool, typer.Option("--collect", help="Make no runs: gather those of the shards.")
    ] = False,
) -> None:
    """Run one model at many parameter values: sweep-<name>.h5 and sweep-<name>.csv.

    The section sweep of the case names the model and the values. Finished runs are kept: the same
    command goes on where a sweep was stopped, and with more values makes the new runs only. A run
    that fails is recorded, and the others go on; exit code 4 says that one became unstable.

    With --scheduler the workers of a Dask cluster make the runs: `dask scheduler` on one machine,
    `dask worker ADDRESS --nworkers auto --nthreads 1` on each. With --shard, each of N jobs of a
    batch queue makes its share, and the last one gathers the results.

    \b
    Example, a thousand reduced runs after a run of the case:
      sphrom sweep cases/taylor_green_demo.yaml
    """
    share: tuple[int, ...] | None = None
    if shard is not None:
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
        share = tuple(map(int, found.groups())) if found else (0, 0)
        if not 1 <= share[0] <= share[1]:
            raise CaseError(f"--shard: must be like 1/8, up to 8/8; got {shard!r}")
    run_stage("sweep", options, workers=workers, scheduler=scheduler, shard=share, collect=collect)


@stage_command(stages, "fit", WITHOUT_THREADS)
def fit(
    options: Options,
    measurements: Annotated[
        Path,
        argument(
            "MEASUREMENTS",
            "Measured histories (CSV), a column for each, such as time, drag_force_x.",
        ),
    ],
    noise: Annotated[
        str | None,
        option("PERCENT", "Standard deviation of the noise over a history's range, such as 1%."),
    ] = None,
    name: Annotated[
        str | None,
        option("NAME", "Name of the files: fit-NAME.h5.  [default: as the measurements]"),
    ] = None,
) -> None:
    """Find parameters from measured histories: fit-<name>.h5, .csv and .png.

    A model with evaluation: operators is fitted to histories of probes, forces and flow rates: the
    case's own (time, wake_velocity_x, drag_force_x, ...), or of any place (time, x, y, velocity_x,
    ...). The section fit of the case says which parameters are looked for, and in which ranges.

    \b
    Example, with noise of 1 % of each history's range, the lid's speed known:
      sphrom fit cavity.yaml probes.csv --noise 1% --set fit.parameters.lid=0.8
    """


@stage_command(stages, "train")
def train(
    options: Options,
    tolerance: Annotated[str | None, option("PERCENT", "Error allowed, such as 1%.")] = None,
    budget: Annotated[int | None, option("N", "Most full runs to learn from.", min=2)] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    write_case: Annotated[
        Path | None,
        option(
            "FILE",
            "The case with the chosen points.  [default: training/case.yaml beside artifacts]",
        ),
    ] = None,
) -> None:
    """Choose the full runs that a model needs to be within a tolerance anywhere in a region.

    The section training of the case has the region, such as reynolds: [50, 1000]. The model's
    error is estimated at many points, the full model is run where it is worst, and the model
    learns from it, until the estimate is within the tolerance everywhere or the budget is spent.

    The same command goes on where it was stopped, also with another tolerance or budget. The case
    that it writes has the chosen points: run, sweep and trade go on with it. Exit code 4 says that
    a full run became unstable.

    \b
    Example, a model that is wrong by at most one percent, from eight full runs:
      sphrom train case.yaml --tolerance 1% --budget 8
    """


@command(stages, "import", (*OF_FILES, "threads"), own=parameters_of(ImportOptions).values())
def import_(
    options: Options,
    files: Annotated[
        list[Path],
        argument(
            "FILES",
            "One file a snapshot: PySPH's .hdf5, .vtu, .vtp, .vtk, .npz; or a .pvd or .vtkhdf.",
        ),
    ],
    write_case: Annotated[
        Path | None,
        option(
            "FILE", "Write a case with the files' times and resolution, and import for that one."
        ),
    ] = None,
    **own: Any,
) -> None:
    """Take another program's snapshots as a full run: fom-<parameters>.h5.

    The case says what was simulated: scene, fluid, particles, and the instants that are kept; map
    and the stages after it go on from there. A file at an instant is taken as it is; where there is
    none, snapshots are interpolated in time.

    \b
    Example, Taylor-Green of PySPH, whose origin is elsewhere; then files in mm:
      sphrom import vortex.yaml tg/*.hdf5 --only reynolds=100 --origin=-0.25,-0.25
      sphrom import vortex.yaml *.vtp --write-case theirs.yaml --units length=mm
    """
    about = ImportOptions(**own)
    if write_case is not None:
        from sphrom.exchange.import_ import fitted_case

        if write_case.suffix not in (".yaml", ".yml") or write_case.exists() > options.force:
            raise CaseError(f"{write_case}: must be a new case, or one that --force writes over")
        overrides = options.overrides or []
        text, keys = fitted_case(options.case, overrides, files, about, write_case.parent)
        options = replace(options, overrides=[*overrides, *keys])
    missing = ", ".join(run_stage("import", options, files=files, about=about))
    if write_case is not None:
        run = f"sphrom run {replace(options, case=write_case, overrides=None).words}"
        way = f"import {missing} for {write_case} ({run} would simulate them)" if missing else run
        write_new(write_case, text, f", with {' '.join(keys)}; next: {way}", force=options.force)


@stage_command(stages, "export", OF_FILES)
def export(
    options: Options,
    to: Annotated[
        str,
        option("FORMAT", "vtu: a .pvd that lists files for ParaView; csv: runs at some points."),
    ] = "vtu",
    into: Annotated[
        Path | None, option("DIR", "Folder of the files.  [default: export, beside the artifacts]")
    ] = None,
    at: Annotated[
        list[str] | None, option("X,Y", "A point [m] of csv; may be repeated.  [default: a line]")
    ] = None,
) -> None:
    """Write fields into files of their own, for ParaView and other programs.

    Any ParaView opens the .pvd files: runs step through their snapshots, pod.pvd through its modes.
    The fields of runs that store coordinates alone are computed on the way.

    \b
    Example, all that a case has, its runs at a point, and those of one model:
      sphrom export cases/taylor_green_demo.yaml
      sphrom export cases/taylor_green_demo.yaml --to csv --at 0.25,0.5
      sphrom export cases/taylor_green_demo.yaml --only fast-m5 --into vtu
    """
