"""The commands that run stages and studies, and those for import and export."""

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
    SHARED_OUT,
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
OF_FILES = ("case", "out", "overrides", "force", "quiet", "only")
"""The options of commands that read or write other programs' files."""


@stage_command(stages, "fom", ALL)
def fom(options: Options) -> None:
    """Run the full model at every parameter value: fom-<parameters>.h5.

    A stopped run leaves a checkpoint; --resume continues it, and the artifact is the same bit for
    bit. With a later time.final_time, --resume continues finished runs too. The file
    spin-up-<parameters>.h5 stores the final state of a spin-up.

    \b
    Example, one value, then the same run resumed after a stop:
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --resume
    """


@stage_command(stages, "map", (*BY_POINT, *SHARED_OUT))
def map_(options: Options) -> None:
    """Map snapshots onto the reference space: map-<parameters>.h5.

    \b
    Example, with full runs in a folder of their own:
      sphrom fom cases/taylor_green_demo.yaml --out runs/demo
      sphrom map cases/taylor_green_demo.yaml --out runs/demo
    """


@stage_command(stages, "pod")
def pod(options: Options) -> None:
    """Extract the trial basis from the mapped snapshots: pod.h5.

    \b
    Example, with 20 modes, overwriting an earlier basis:
      sphrom pod cases/taylor_green_demo.yaml --set basis.n_modes=20 --force
    """


@stage_command(stages, "fit-psi")
def fit_psi(options: Options) -> None:
    """Fit splines to the modes: psi.h5.

    \b
    Example, with polynomials of a higher degree:
      sphrom fit-psi cases/taylor_green_demo.yaml --set psi.polynomial_degree=2
    """


@stage_command(stages, "operators")
def operators(options: Options) -> None:
    """Project the equations on the reference points, and train models: operators.h5, model-*.h5.

    Reduced models with `evaluation: operators` need this stage. Their cost does not depend on the
    number of particles. From Python, `sphrom.load` needs only the file of a model.

    \b
    Example:
      sphrom operators cases/taylor_green_demo.yaml
    """


@stage_command(stages, "rom", ALL)
def rom(options: Options) -> None:
    """Run the reduced models: rom-<name>-<parameters>.h5.

    A model that isn't evaluated on particles may also run at parameter values without a full run,
    which its key `parameters` lists.

    \b
    Example, one parameter value, then a single model:
      sphrom rom cases/taylor_green_demo.yaml --only reynolds=150
      sphrom rom cases/taylor_green_demo.yaml --only fast-m5
    """


@stage_command(stages, "compare")
def compare(options: Options) -> None:
    """Compare reduced runs with full runs: tables, figures, compare.h5.

    \b
    Example, on a finer grid, overwriting an earlier comparison:
      sphrom compare cases/taylor_green_demo.yaml --set compare.grid=90 --force
    """


@stage_command(stages, "figures")
def figures(options: Options) -> None:
    """Draw the figures that compare.figures of a case lists: figures/<name>.png.

    The runs and their comparison must exist already.

    \b
    Example, the paper's figures of the Taylor-Green vortex:
      sphrom run cases/taylor_green_paper.yaml
      sphrom figures cases/taylor_green_paper.yaml
    """


@stage_command(stages, "report")
def report(options: Options) -> None:
    """Write one HTML page of a case and its results: report.html.

    It shows the comparison and, if they have run, trade, train and all sweeps. The page can be read
    without a network.

    \b
    Example:
      sphrom run cases/taylor_green_demo.yaml
      sphrom report cases/taylor_green_demo.yaml
    """


@stage_command(stages, "run", (*WHOLE, *ALL[len(BY_POINT) :]))
def run(options: Options) -> None:
    """Run all stages that a case needs, keeping valid artifacts.

    \b
    Example, with a longer time step, into a folder of its own:
      sphrom run cases/taylor_green_demo.yaml --out coarse --set time.step=0.01
    """


@command(stages, "trade", (*BY_POINT, "checkpoint_every", *SHARED_OUT))
def trade(
    options: Options,
    tolerance: Annotated[
        str | None,
        option(
            "PERCENT", "Name the cheapest model within 1%, or within 0.5%,3% (velocity, pressure)."
        ),
    ] = None,
    extremes: Annotated[
        bool, typer.Option("--extremes", help="Map where models are stable and accurate instead.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="With --extremes: fewer values and full runs.")
    ] = False,
) -> None:
    """Weigh speed against accuracy: run and time the models that the case lists.

    The artifacts of the case must exist. Tables and a plot of the Pareto front go into the folder
    `trade` beside them, and so do further full runs. After a stop, the same command continues.

    \b
    Example, the cheapest model with an error of at most one percent:
      sphrom trade cases/taylor_green_demo.yaml --tolerance 1%
    """
    if extremes and tolerance is not None:
        raise CaseError("--tolerance: can't be combined with --extremes, which compares no models")
    if quick and not extremes:
        raise CaseError("--quick: needs --extremes")
    if extremes:
        run_stage("extremes", options, quick=quick)
    else:
        run_stage("trade", options, tolerance=tolerance)


@command(stages, "sweep", (*WITHOUT_THREADS, *SHARED_OUT))
def sweep(
    options: Options,
    shard: Annotated[
        str | None, option("I/N", "Run the I-th of N shares only, as one job of a batch queue.")
    ] = None,
    collect: Annotated[
        bool, typer.Option("--collect", help="Run nothing: gather the runs of all shares.")
    ] = False,
) -> None:
    """Run one model at many parameter values: sweep-<name>.h5 and sweep-<name>.csv.

    The section `sweep` of the case names the model and the parameter values. Finished runs are
    kept, so the same command continues a stopped sweep, and more values add runs. A failed run is
    recorded and the others continue; exit code 4 means that a run became unstable.

    With --scheduler, the workers of a Dask cluster do the runs: start `dask scheduler` on one
    machine and `dask worker ADDRESS --nworkers auto --nthreads 1` on each. With --shard, each of N
    jobs of a batch queue does its share, and the last job gathers the results.

    \b
    Example, a thousand reduced runs of a case that has run:
      sphrom sweep cases/taylor_green_demo.yaml
    """
    share: tuple[int, ...] | None = None
    if shard is not None:
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
        share = tuple(map(int, match.groups())) if match else (0, 0)
        if not 1 <= share[0] <= share[1]:
            raise CaseError(f"--shard: must be like 1/8, up to 8/8; got {shard!r}")
    run_stage("sweep", options, shard=share, collect=collect)


@stage_command(stages, "fit", WITHOUT_THREADS)
def fit(
    options: Options,
    measurements: Annotated[
        Path,
        argument(
            "MEASUREMENTS", "Measured histories (CSV), one per column, such as time, drag_force_x."
        ),
    ],
    noise: Annotated[
        str | None,
        option("PERCENT", "Standard deviation of the noise, in percent of a history's range."),
    ] = None,
    name: Annotated[
        str | None,
        option("NAME", "Name of the results, fit-NAME.h5.  [default: that of the measurements]"),
    ] = None,
) -> None:
    """Estimate parameters from measured histories: fit-<name>.h5, .csv and .png.

    A model with `evaluation: operators` is fitted to histories of probes, forces and flow rates.
    These are the case's own (time, wake_velocity_x, drag_force_x, ...), or velocities at any place
    (time, x, y, velocity_x, ...). The section `fit` of the case gives the parameters and ranges.

    \b
    Example, with noise of 1 % of a history's range and a known speed of the lid:
      sphrom fit cavity.yaml probes.csv --noise 1% --set fit.parameters.lid=0.8
    """


@stage_command(stages, "train", (*WHOLE, *SHARED_OUT))
def train(
    options: Options,
    tolerance: Annotated[str | None, option("PERCENT", "Allowed error, such as 1%.")] = None,
    budget: Annotated[int | None, option("N", "Largest number of training runs.", min=2)] = None,
    write_case: Annotated[
        Path | None,
        option(
            "FILE", "Case with the chosen runs.  [default: training/case.yaml beside the artifacts]"
        ),
    ] = None,
) -> None:
    """Choose training runs until a model is within a tolerance everywhere in a region.

    The section `training` of the case gives the region, such as reynolds: [50, 1000]. The error of
    the model is estimated at many points. The full model runs where the estimate is largest, and
    the run is added to the training runs, until the estimate is within the tolerance everywhere or
    the budget is spent.

    The same command continues after a stop, also with another tolerance or budget. It writes a case
    with the chosen runs for run, sweep and trade. Exit code 4 means that a full run became
    unstable.

    \b
    Example, an error of at most one percent from at most eight full runs:
      sphrom train case.yaml --tolerance 1% --budget 8
    """


@command(stages, "import", (*OF_FILES, "threads"), more=parameters_of(ImportOptions).values())
def import_(
    options: Options,
    files: Annotated[
        list[Path],
        argument(
            "FILES",
            "One file per snapshot (PySPH's .hdf5, .vtu, .vtp, .vtk, .npz), a .pvd or a .vtkhdf.",
        ),
    ],
    write_case: Annotated[
        Path | None,
        option(
            "FILE",
            "Write a case with the files' times and resolution, and import the files for it.",
        ),
    ] = None,
    **fields: Any,
) -> None:
    """Import another program's snapshots as a full run: fom-<parameters>.h5.

    The case describes the simulation: scene, fluid, particles and snapshot times. The stages from
    map on then use the imported run. A file at a snapshot time is used unchanged; between files,
    snapshots are interpolated in time.

    \b
    Example, PySPH's Taylor-Green vortex with another origin, then files in mm:
      sphrom import vortex.yaml tg/*.hdf5 --only reynolds=100 --origin=-0.25,-0.25
      sphrom import vortex.yaml *.vtp --write-case theirs.yaml --units length=mm
    """
    reading = ImportOptions(**fields)
    if write_case is not None:
        from sphrom.exchange.conversion import fitted_case

        if write_case.suffix not in (".yaml", ".yml") or write_case.exists() > options.force:
            raise CaseError(f"{write_case}: must be a new .yaml file; --force overwrites one")
        overrides = options.overrides or []
        text, keys = fitted_case(options.case, overrides, files, reading, write_case.parent)
        options = replace(options, overrides=[*overrides, *keys])
    missing = ", ".join(run_stage("import", options, files=files, fields=reading))
    if write_case is not None:
        run = f"sphrom run {replace(options, case=write_case, overrides=None).words}"
        step = f"import {missing} for {write_case} ({run} would simulate them)" if missing else run
        write_new(write_case, text, f", with {' '.join(keys)}; next: {step}", force=options.force)


@stage_command(stages, "export", OF_FILES)
def export(
    options: Options,
    to: Annotated[
        str,
        option(
            "FORMAT",
            "vtu: files for ParaView and a .pvd list; csv: histories at points; model: trained "
            "models as JSON for other programs; fmu: as units for system simulation; page: as "
            "HTML pages that run them.",
        ),
    ] = "vtu",
    into: Annotated[
        Path | None, option("DIR", "Folder to write to.  [default: export, beside the artifacts]")
    ] = None,
    at: Annotated[
        list[str] | None, option("X,Y", "A point [m] for csv; may be repeated.  [default: a line]")
    ] = None,
    columns: Annotated[
        int | None,
        option("N", "Grid columns of the pictures on a page. [default: by size of the page]"),
    ] = None,
) -> None:
    """Export fields, or trained models, to files for other programs.

    All versions of ParaView open the .pvd files. Those of runs step through the snapshots, and
    pod.pvd steps through the modes. Fields that a run does not store are computed from its modes.

    \b
    Example, all runs, histories at a point, the runs of a model, and the model:
      sphrom export cases/taylor_green_demo.yaml
      sphrom export cases/taylor_green_demo.yaml --to csv --at 0.25,0.5
      sphrom export cases/taylor_green_demo.yaml --only fast-m5 --into vtu
      sphrom export cases/taylor_green_demo.yaml --only fast-m5 --to model
      sphrom export cases/taylor_green_demo.yaml --only fast-m5 --to page
    """
