"""The command line: its commands, and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sphrom.cli import commands, completion
from sphrom.cli.failures import Commands
from sphrom.cli.options import (
    CaseFile,
    ForceCheck,
    Options,
    OutCheck,
    Set,
)
from sphrom.cli.other_programs import add_other_programs
from sphrom.cli.stages import add_stages
from sphrom.console import tell
from sphrom.version import __version__

Output = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="Write there, not to the terminal."),
]
KINDS = "One of taylor-green, lid-driven-cavity, open-cavity, or custom: a flow of your own."

case_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Write, check and describe case files."
)


@case_app.command()
def check(
    case: CaseFile, out: OutCheck = None, set_: Set = None, force: ForceCheck = False
) -> None:
    """Check a case, and tell what it would cost; exit code 5 if it would not fit this machine.

    \b
    Example, with a step to try:
      sphrom case check cases/taylor_green_demo.yaml --set time.step=1e-3
    """
    commands.run_stage("check", Options(case, out, set_ or (), force))


@case_app.command()
def draw(
    case: CaseFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Where to, PNG or SVG by how it ends.  [default: <name of the case>.png]",
        ),
    ] = None,
    set_: Set = None,
    force: Annotated[
        bool,
        typer.Option("--force", help="Write over a file; insist on a step beyond its limit."),
    ] = False,
) -> None:
    """Draw a case before it runs: particles, ghosts, walls and their velocities, compared line.

    \b
    Example:
      sphrom case draw cases/gallery/cylinder.yaml -o cylinder.svg
    """
    commands.run_stage("draw", Options(case, None, set_ or (), force), output=output)


@case_app.command()
def show(case: CaseFile, set_: Set = None, force: ForceCheck = False) -> None:
    """Print every key of a case with its value, defaults and outlines of files included.

    \b
    Example:
      sphrom case show cases/lid_driven_cavity_demo.yaml
    """
    commands.show_case(case, set_ or (), force=force)


@case_app.command()
def new(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND", help=KINDS, show_default=False, autocompletion=completion.kinds
        ),
    ] = None,
    output: Output = None,
    full: Annotated[
        bool, typer.Option("--full", help="With every key, at its default, and what it means.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Write a short case file to start from, with a fast model, that runs in a minute or so.

    \b
    Example:
      sphrom case new lid-driven-cavity -o cavity.yaml
    """
    commands.new_case(kind, output, full=full, force=force)


@case_app.command()
def examples(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="The case to write; without it, all are listed.",
            show_default=False,
            autocompletion=completion.examples,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write there.  [default: NAME.yaml]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """List the cases that come with sphrom, or write one into a file.

    \b
    Example:
      sphrom case examples taylor_green_demo
      sphrom run taylor_green_demo.yaml
    """
    commands.copy_example(name, output, force=force)


@case_app.command()
def schema(
    output: Output = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Print the JSON schema of case files, by which editors complete and check them.

    An editor with the YAML language server finds it by a line at the top of a case file, which case
    new writes: # yaml-language-server: $schema=sphrom.schema.json

    \b
    Example, beside the case files:
      sphrom case schema -o sphrom.schema.json
    """
    commands.print_schema(output, force=force)


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
    them. Each reads artifacts (HDF5) from runs/<name of the case>/ and writes its own there. The
    command trade weighs the speed of models against their accuracy, sweep runs one model at
    thousands of parameter values, fit finds parameters from measurements, and train chooses the
    full runs that a model is trained on.

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
add_other_programs(app)
