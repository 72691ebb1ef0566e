"""The command line: arguments, help, and exit codes."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sphrom import __version__
from sphrom.cli import commands, other_programs
from sphrom.cli.case_app import case_app
from sphrom.cli.commands import Options
from sphrom.cli.console import tell
from sphrom.cli.interrupts import (
    exit_of,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)
from sphrom.cli.options import (
    CaseFile,
    CheckpointEvery,
    Force,
    ForceRun,
    Only,
    Out,
    Quiet,
    Resume,
    Set,
    Threads,
)
from sphrom.errors import ArtifactError, ResourceError, SphromError
from sphrom.text import visible

UsageError: Any = typer.BadParameter.__base__
"""What typer raises for arguments that it can't take; it exports only some kinds of it."""
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG}


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        with _visible_usage():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        try:
            with termination_interrupts(), interrupts_come_again(), _visible_usage():
                return super().invoke(ctx)
        except SphromError as error:
            _fail(error, str(error))
        except (KeyboardInterrupt, SystemError) as error:
            interrupt = interrupt_behind(error)
            if interrupt is None:
                raise
            code, word = exit_of(interrupt)
            tell(word, error=True)
            raise typer.Exit(code) from None
        except MemoryError:
            _fail(ResourceError(), "out of memory; `sphrom case check` tells what a case needs")
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise
            kind = ResourceError() if error.errno in _FULL else ArtifactError()
            _fail(kind, f"{error.filename or 'a file'}: {error.strerror or error}")


@contextmanager
def _visible_usage() -> Iterator[None]:
    """Make visible what typer's messages about usage repeat of the arguments."""
    try:
        yield
    except UsageError as error:
        error.message = visible(error.message, keep="\n")
        raise


def _fail(error: SphromError, text: str) -> None:
    for line in text.split("\n"):
        tell(f"error: {line}", error=True)
    raise typer.Exit(error.exit_code)


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(case_app, name="case")


def _version(asked: bool) -> None:
    if asked:
        tell(f"sphrom {__version__}")
        raise typer.Exit()


@app.callback()
def sphrom(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Turn a smoothed-particle-hydrodynamics simulation into a reduced model.

    The stages in their order: fom, map, pod, fit-psi, operators, rom, compare; run does all of
    them. Each reads artifacts (HDF5) from runs/<name of the case>/ and writes its own there. What
    a model's speed costs in accuracy, trade tells; thousands of runs of it, sweep makes.

    \b
    Example, from a case file to a comparison:
      sphrom case new taylor-green -o vortex.yaml
      sphrom case check vortex.yaml
      sphrom run vortex.yaml

    \b
    Exit codes: 0 done, 2 wrong usage or invalid case, 3 an artifact is missing or damaged,
    4 a run became unstable, 5 it would not fit this machine, 130 interrupted, 143 terminated.
    """


def _add_stage(name: str, stage: str, text: str) -> None:
    """Add the command of a stage that takes the whole case."""

    def command(
        case: CaseFile,
        out: Out = None,
        set_: Set = None,
        force: Force = False,
        threads: Threads = None,
        quiet: Quiet = False,
    ) -> None:
        commands.run_stage(stage, Options(case, out, set_ or (), force, threads, quiet))

    app.command(name, help=text)(command)


def _add_stage_by_point(name: str, stage: str, text: str) -> None:
    """Add the command of a stage that may be run at some parameter values only."""

    def command(
        case: CaseFile,
        out: Out = None,
        set_: Set = None,
        force: Force = False,
        threads: Threads = None,
        quiet: Quiet = False,
        only: Only = None,
    ) -> None:
        commands.run_stage(stage, Options(case, out, set_ or (), force, threads, quiet, only or ()))

    app.command(name, help=text)(command)


def _add_stage_of_runs(name: str, stage: str, text: str) -> None:
    """Add the command of a stage of long runs, which may be stopped and go on."""

    def command(
        case: CaseFile,
        out: Out = None,
        set_: Set = None,
        force: Force = False,
        threads: Threads = None,
        quiet: Quiet = False,
        only: Only = None,
        resume: Resume = False,
        checkpoint_every: CheckpointEvery = 60.0,
    ) -> None:
        options = Options(case, out, set_ or (), force, threads, quiet, only or ())
        commands.run_stage(stage, replace(options, resume=resume, every=checkpoint_every))

    app.command(name, help=text)(command)


_add_stage_of_runs(
    "fom",
    "fom",
    """Run the full model at every parameter value: fom-<parameters>.h5.

    Where the case has a spin-up, its end is kept in spin-up-<parameters>.h5, and what is recorded
    after it can be run again from there. A run that is stopped leaves a checkpoint beside its
    artifact; --resume continues it, to the same artifact bit for bit.

    \b
    Example, one value on two threads, and the same after it was stopped:
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --threads 2
      sphrom fom cases/taylor_green_demo.yaml --only reynolds=100 --threads 2 --resume
    """,
)
_add_stage_by_point(
    "map",
    "map",
    """Map snapshots onto the reference space: map-<parameters>.h5.

    \b
    Example, with the Shepard filter, into a folder that already holds the full runs:
      sphrom map cases/taylor_green_demo.yaml --out runs/demo --set reference.method=shepard
    """,
)
_add_stage(
    "pod",
    "pod",
    """Extract the trial basis from the mapped snapshots: pod.h5.

    \b
    Example, with 20 modes, writing over an earlier basis:
      sphrom pod cases/taylor_green_demo.yaml --set basis.n_modes=20 --force
    """,
)
_add_stage(
    "fit-psi",
    "fit_psi",
    """Fit splines to the modes: psi.h5.

    \b
    Example, with splines of a higher order:
      sphrom fit-psi cases/taylor_green_demo.yaml --set psi.order=5 --set psi.polynomial_degree=2
    """,
)
_add_stage(
    "operators",
    "operators",
    """Project the right-hand side on the reference points onto the basis: operators.h5.

    For reduced models with evaluation: operators; their cost is independent of the number of
    particles.

    \b
    Example, with derivatives of the modes by sums over neighbours:
      sphrom operators cases/taylor_green_demo.yaml --set operators.advection=sph
    """,
)
_add_stage_of_runs(
    "rom",
    "rom",
    """Run the reduced models: rom-<name>-<parameters>.h5.

    \b
    Example, a value that the basis was not trained on; it may be one that a model with frame:
    reference lists in its parameters, and no full run is made at:
      sphrom rom cases/taylor_green_demo.yaml --only reynolds=150
    """,
)
_add_stage(
    "compare",
    "compare",
    """Compare reduced with full runs: tables, figures, compare.h5.

    \b
    Example, leaving out the start, where the flow settles:
      sphrom compare cases/taylor_green_demo.yaml --set compare.from_time=0.1
    """,
)


@app.command("run")
def run(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: ForceRun = False,
    threads: Threads = None,
    quiet: Quiet = False,
    resume: Resume = False,
    checkpoint_every: CheckpointEvery = 60.0,
) -> None:
    """Run all stages that are needed, keeping what is there and valid.

    \b
    Example, the whole pipeline on a coarser grid, in a folder of its own:
      sphrom run cases/taylor_green_demo.yaml --set discretization.resolution=40 --out runs/coarse
    """
    options = Options(case, out, set_ or (), force, threads, quiet)
    commands.run_stage("pipeline", replace(options, resume=resume, every=checkpoint_every))


@app.command("trade")
def trade(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
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
    resume: Resume = False,
    checkpoint_every: CheckpointEvery = 60.0,
) -> None:
    """Weigh speed against accuracy: run and time the models that the case lists.

    Writes tables and a plot with the Pareto front into the folder trade of the case's artifacts,
    which have to be there. Full runs at other steps and resolutions are kept in folders below it.

    \b
    Example, after a run of the case: the cheapest model that is wrong by no more than one percent:
      sphrom trade cases/taylor_green_demo.yaml --tolerance 1%
    """
    asked = {"tolerance": tolerance, "extremes": extremes}
    options = Options(case, out, set_ or (), force, threads, quiet, only or ())
    options = replace(options, resume=resume, every=checkpoint_every)
    commands.run_stage("trade", options, **{name: value for name, value in asked.items() if value})


@app.command("sweep")
def sweep(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: Annotated[
        bool, typer.Option("--force", help="Start anew; insist on a step beyond its limit.")
    ] = False,
    quiet: Quiet = False,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            min=1,
            metavar="N",
            help="Processes to run at once.  [default: one a core, as far as memory goes]",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run on the workers of this Dask scheduler, such as tcp://node1:8786.",
        ),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            "--shard", metavar="I/N", help="Do the I-th of N shares only, as one job of a batch."
        ),
    ] = None,
    collect: Annotated[
        bool, typer.Option("--collect", help="Run nothing: gather what shards have done.")
    ] = False,
) -> None:
    """Run one model at many parameter values: sweep-<name>.h5 and sweep-<name>.csv.

    Which, the section sweep of the case says: a reduced model, whose runs on reference points take
    milliseconds, or the full one. What is done is kept as it is done: the same command goes on
    where a sweep was stopped, and with more values runs those only. A run that fails is recorded,
    and the others go on; exit code 4 says that one became unstable.

    With --scheduler runs are done by the workers of a Dask cluster, which need sphrom and have to
    see the folder of the artifacts under the same path: `dask scheduler` on one machine, `dask
    worker ADDRESS --nworkers auto --nthreads 1` on each. With --shard, each of N jobs of a batch
    queue does its share, and the last one gathers the results.

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
        Options(case, out, set_ or (), force, None, quiet),
        **{name: value for name, value in asked.items() if value},
    )


_add_stage(
    "report",
    "report",
    """Write one HTML page of a case and its results: report.html.

    It shows what compare found, and trade where that has run; it needs no network to be read.

    \b
    Example:
      sphrom run cases/taylor_green_demo.yaml
      sphrom report cases/taylor_green_demo.yaml
    """,
)


app.command("import")(other_programs.import_)
app.command("export")(other_programs.export)
