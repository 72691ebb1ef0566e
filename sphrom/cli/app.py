"""The command line: arguments, help, and exit codes."""

from __future__ import annotations

import errno
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sphrom import __version__
from sphrom.cli import commands, completion
from sphrom.cli.commands import Options
from sphrom.cli.interrupts import (
    exit_of,
    interrupt_behind,
    interrupts_come_again,
    termination_interrupts,
)
from sphrom.errors import ArtifactError, ResourceError, SphromError

KINDS = f"The kind of scene: {', '.join(completion.KINDS[:-1])} or {completion.KINDS[-1]}."
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG}


class Commands(TyperGroup):
    """Shows errors that a user can act on as lines, and turns them into exit codes."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with termination_interrupts(), interrupts_come_again():
                return super().invoke(ctx)
        except SphromError as error:
            _fail(error, str(error))
        except (KeyboardInterrupt, SystemError) as error:
            interrupt = interrupt_behind(error)
            if interrupt is None:
                raise
            code, word = exit_of(interrupt)
            print(word, file=sys.stderr)
            raise typer.Exit(code) from None
        except MemoryError:
            _fail(ResourceError(), "out of memory; `sphrom case check` tells what a case needs")
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise
            kind = ResourceError() if error.errno in _FULL else ArtifactError()
            _fail(kind, f"{error.filename or 'a file'}: {error.strerror or error}")


def _fail(error: SphromError, text: str) -> None:
    for line in text.splitlines():
        print(f"error: {line}", file=sys.stderr)
    raise typer.Exit(error.exit_code)


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
case_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Write, check and describe case files."
)
app.add_typer(case_app, name="case")

CaseFile = Annotated[
    Path,
    typer.Argument(
        metavar="CASE",
        help="The case file (YAML).",
        show_default=False,
        autocompletion=completion.case_files,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="Folder of the artifacts.  [default: runs/<name of the case>]"
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the case, such as time.step=1e-3.",
        autocompletion=completion.keys,
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Write over artifacts; insist on a step beyond its limit."),
]
ForceRun = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Make again what no longer belongs to the case, and only that; insist on a step "
        "beyond its limit.",
    ),
]
ForceCheck = Annotated[
    bool, typer.Option("--force", help="Insist on a step beyond its limit, as stages do.")
]
OutCheck = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Folder whose disk has to have room.  [default: runs/<name of the case>]",
    ),
]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, metavar="N", help="Threads to use.  [default: all cores]"),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show warnings and results only.")]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Go on from the checkpoints of runs that were stopped."),
]
CheckpointEvery = Annotated[
    float,
    typer.Option(
        "--checkpoint-every",
        min=0.0,
        metavar="SECONDS",
        help="Time from one checkpoint of a run to the next, more where writing takes long; 0 is "
        "after every step.",
    ),
]
Only = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        metavar="NAME=VALUE",
        help="Run at this parameter value only; may be repeated.",
        autocompletion=completion.values,
    ),
]


def _version(asked: bool) -> None:
    if asked:
        print(f"sphrom {__version__}")
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
    """Fit local polyharmonic splines to the modes: psi.h5.

    \b
    Example, with splines of a higher order:
      sphrom fit-psi cases/taylor_green_demo.yaml --set psi.order=5 --set psi.polynomial_degree=2
    """,
)
_add_stage(
    "operators",
    "operators",
    """Project the right-hand side on the reference points onto the basis: operators.h5.

    For reduced models with frame: reference, whose cost does not depend on the number of particles.

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
            help="Name the cheapest model within it, such as 1%, or 0.5%,3% of velocity and "
            "pressure.",
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


@app.command("import")
def import_(
    case: CaseFile,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES",
            help="One file for each snapshot: PySPH's .hdf5, .vtu, .vtk, .npz; or a .pvd.",
            show_default=False,
        ),
    ],
    array: Annotated[
        str | None,
        typer.Option("--array", metavar="NAME", help="PySPH's name of the particles to take."),
    ] = None,
    position: Annotated[
        str, typer.Option("--position", metavar="NAMES", help="A vector, or two fields.")
    ] = "x,y",
    velocity: Annotated[
        str, typer.Option("--velocity", metavar="NAMES", help="A vector, or two fields.")
    ] = "u,v",
    density: Annotated[
        str | None,
        typer.Option(
            "--density", metavar="NAME", help="Density; pressure follows.  [default: rho]"
        ),
    ] = None,
    pressure: Annotated[
        str | None,
        typer.Option("--pressure", metavar="NAME", help="Pressure; density follows."),
    ] = None,
    zero_mean_pressure: Annotated[
        bool, typer.Option("--zero-mean-pressure", help="Take the mean out of each pressure.")
    ] = False,
    sort_by: Annotated[
        str | None,
        typer.Option("--sort-by", metavar="NAME", help="Field that numbers the particles."),
    ] = None,
    length_unit: Annotated[
        str,
        typer.Option(
            "--length-unit", metavar="UNIT", help="m, cm, mm, um or km; or a number of m."
        ),
    ] = "m",
    time_unit: Annotated[
        str, typer.Option("--time-unit", metavar="UNIT", help="s, ms, us or min; or a number of s.")
    ] = "s",
    velocity_unit: Annotated[
        str,
        typer.Option(
            "--velocity-unit", metavar="UNIT", help="m/s, cm/s or mm/s; or a number of m/s."
        ),
    ] = "m/s",
    density_unit: Annotated[
        str,
        typer.Option(
            "--density-unit", metavar="UNIT", help="kg/m3 or g/cm3; or a number of kg/m3."
        ),
    ] = "kg/m3",
    pressure_unit: Annotated[
        str,
        typer.Option(
            "--pressure-unit", metavar="UNIT", help="Pa, kPa, MPa, mbar or bar; or a number of Pa."
        ),
    ] = "Pa",
    origin: Annotated[
        str,
        typer.Option(
            "--origin", metavar="X,Y", help="Where the scene's (0, 0) is, in the files' units."
        ),
    ] = "0,0",
    time_step: Annotated[
        float | None,
        typer.Option(
            "--time-step",
            metavar="TIME",
            help="Time from file to file, in the order of their names.  [default: as files tell]",
        ),
    ] = None,
    start: Annotated[
        float,
        typer.Option(
            "--start",
            metavar="TIME",
            help="The files' time at which the case begins; of earlier ones nothing is taken.",
        ),
    ] = 0.0,
    seconds: Annotated[
        float,
        typer.Option("--seconds", min=0.0, help="What the run cost; comparisons of speed need it."),
    ] = 0.0,
    out: Out = None,
    set_: Set = None,
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
    only: Only = None,
) -> None:
    """Take another program's snapshots as a full run: fom-<parameters>.h5.

    The case says what was simulated: scene, fluid, particles, and the instants that are kept; map
    and the stages after it go on from there.

    \b
    Example, Taylor-Green of PySPH, whose vortices are a quarter of the box from ours:
      sphrom import vortex.yaml taylor_green_output/*.hdf5 --only reynolds=100 --origin=-0.25,-0.25
    """
    names = ("length", "time", "velocity", "density", "pressure")
    units = (length_unit, time_unit, velocity_unit, density_unit, pressure_unit)
    commands.import_snapshots(
        files,
        Options(case, out, set_ or (), force, threads, quiet, only or ()),
        array=array,
        position=position,
        velocity=velocity,
        density=density,
        pressure=pressure,
        zero_mean_pressure=zero_mean_pressure,
        sort_by=sort_by,
        units=dict(zip(names, units, strict=True)),
        origin=origin,
        time_step=time_step,
        start=start,
        seconds=seconds,
    )


@app.command("export")
def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CASE|ARTIFACT",
            help="A case file, for all its artifacts, or one artifact (.h5).",
            show_default=False,
            autocompletion=completion.case_files,
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="vtkhdf: one file each; vtu: one file for each step, with a .pvd that lists them; "
            "csv: runs at some points.",
        ),
    ] = "vtkhdf",
    into: Annotated[
        Path | None,
        typer.Option(
            "--into",
            metavar="DIR",
            help="Folder of the files.  [default: export, beside the artifacts]",
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at", metavar="X,Y", help="A point [m] for csv; may be repeated.  [default: a line]"
        ),
    ] = None,
    out: Out = None,
    set_: Set = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    quiet: Quiet = False,
    only: Only = None,
) -> None:
    """Write fields into files of their own, for ParaView and other programs.

    ParaView's VTKHDF reader opens artifacts as they are: runs step through their snapshots, pod.h5
    through its modes. Files that are written here hold copies of the same numbers, and need no
    artifact beside them; ghosts of walls and Lagrangian modes get files too.

    \b
    Example, all that a case has, its runs at a point, and one for a program that reads VTU only:
      sphrom export cases/taylor_green_demo.yaml
      sphrom export cases/taylor_green_demo.yaml --to csv --at 0.25,0.5
      sphrom export runs/taylor_green_demo/fom-reynolds100.h5 --to vtu --into vtu
    """
    options = Options(source, out, set_ or (), force, None, quiet, only or ())
    commands.export(source, to, into, at or (), options)


@case_app.command()
def check(
    case: CaseFile, out: OutCheck = None, set_: Set = None, force: ForceCheck = False
) -> None:
    """Check a case, and tell what it would cost; exit code 5 if it would not fit this machine.

    \b
    Example, with a step to try:
      sphrom case check cases/taylor_green.yaml --set time.step=1e-3
    """
    commands.run_stage("check", Options(case, out, set_ or (), force))


@case_app.command()
def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help=KINDS, show_default=False, autocompletion=completion.kinds
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write there, not to the terminal."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Write a commented case file to start from, with the defaults of its scene.

    \b
    Example:
      sphrom case new lid-driven-cavity -o cavity.yaml
    """
    commands.new_case(kind, output, force=force)


@case_app.command()
def schema(
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Write there, not to the terminal."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Print the JSON schema of case files, by which editors complete and check them.

    An editor with the YAML language server finds it by a line at the top of a case file, which case
    new writes: # yaml-language-server: $schema=sphrom.schema.json

    \b
    Example, beside the case files:
      sphrom case schema --out sphrom.schema.json
    """
    commands.print_schema(out, force=force)
