"""The command line: its commands, and help."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from sphrom.cli import commands, other_programs, studies
from sphrom.cli.case_app import case_app
from sphrom.cli.commands import Options
from sphrom.cli.failures import Commands
from sphrom.cli.options import (
    CaseFile,
    CheckpointEvery,
    ForceRun,
    Log,
    Out,
    Quiet,
    Resume,
    Set,
    Threads,
    Verbose,
)
from sphrom.cli.stages import add_stages
from sphrom.console import tell
from sphrom.version import __version__

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
    a model's speed costs in accuracy, trade tells; thousands of runs of it, sweep makes; train
    chooses the full runs that a model learns from.

    \b
    Example, from a case file to a comparison:
      sphrom case new taylor-green -o vortex.yaml
      sphrom case check vortex.yaml
      sphrom run vortex.yaml

    \b
    Exit codes: 0 done, 2 wrong usage or invalid case, 3 an artifact is missing or damaged,
    4 a run became unstable, 5 it would not fit this machine, 130 interrupted, 143 terminated.
    """


add_stages(app)


@app.command("run")
def run(
    case: CaseFile,
    out: Out = None,
    set_: Set = None,
    force: ForceRun = False,
    threads: Threads = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    log: Log = None,
    resume: Resume = False,
    checkpoint_every: CheckpointEvery = 60.0,
) -> None:
    """Run all stages that are needed, keeping what is there and valid.

    \b
    Example, the whole pipeline on a coarser grid, in a folder of its own:
      sphrom run cases/taylor_green_demo.yaml --set discretization.resolution=40 --out runs/coarse
    """
    options = Options(case, out, set_ or (), force, threads, quiet, verbose=verbose, log=log)
    commands.run_stage("pipeline", replace(options, resume=resume, every=checkpoint_every))


app.command("trade")(studies.trade)
app.command("sweep")(studies.sweep)
app.command("fit")(studies.fit)
app.command("train")(studies.train)
app.command("import")(other_programs.import_)
app.command("export")(other_programs.export)
