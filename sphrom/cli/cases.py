"""The commands `case ...`: write, check and describe case files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sphrom.cli.options import (
    Command,
    Options,
    argument,
    command,
    complete_kinds,
    option,
    run_stage,
    stage_command,
)
from sphrom.console import tell
from sphrom.errors import CaseError
from sphrom.whole_files import open_to_write

cases = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Write, check and describe case files."
)
KINDS = (
    "One of taylor-green, lid-driven-cavity, open-cavity and custom (a flow of your own), and in "
    "three dimensions taylor-green-3d and lid-driven-cube."
)
Output = Annotated[Path | None, option("FILE", "Write to this file.", "--output", "-o")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")]


def write_new(target: Path | None, text: str, next_step: str, *, force: bool) -> None:
    """Write a file, an existing one only with `force`, or print the text if no file is named."""
    if target is None:
        print(text, end="")
        return
    try:
        with open_to_write(target, "w" if force else "x") as file:
            file.write(text)
    except FileExistsError as error:
        raise CaseError(f"{target}: exists already; --force overwrites it") from error
    tell(f"wrote {target}{next_step}")


@stage_command(cases, "check", ("case", "out", "overrides", "force"))
def check(options: Options) -> None:
    """Check a case and estimate its cost; exit code 5 if it does not fit this machine.

    \b
    Example, with another time step:
      sphrom case check cases/taylor_green_demo.yaml --set time.step=1e-3
    """


@command(cases, "draw", ("case", "out", "overrides", "force"))
def draw(
    options: Options,
    output: Annotated[
        Path | None,
        option(
            "FILE",
            "The picture, .png or .svg.  [default: NAME.png, in --out if given]",
            "--output",
            "-o",
        ),
    ] = None,
) -> None:
    """Draw a case before it runs: particles, ghosts, moving walls, the line that is compared.

    \b
    Example:
      sphrom case draw cases/gallery/cylinder.yaml -o cylinder.svg
    """
    run_stage("draw", options, output=output, folder=options.out)


@command(cases, "show", ("case", "overrides", "force"))
def show(options: Options) -> None:
    """Print every key of a case with its value, including defaults and outlines read from files.

    \b
    Example:
      sphrom case show cases/lid_driven_cavity_demo.yaml
    """
    from sphrom.case.loader import load_case
    from sphrom.case.models import moved
    from sphrom.case.yaml_reader import dump_yaml

    case = load_case(options.case, options.overrides or (), options.force)
    print(dump_yaml(moved(case.model_dump(mode="json"), case.folder, None)), end="")


@cases.command(cls=Command)
def new(
    kind: Annotated[str | None, argument("KIND", KINDS, autocompletion=complete_kinds)] = None,
    output: Output = None,
    full: Annotated[
        bool, typer.Option("--full", help="Write every key, with its default and its meaning.")
    ] = False,
    force: Force = False,
) -> None:
    """Write a short case file with a fast model to start from; it runs in about a minute.

    \b
    Example:
      sphrom case new lid-driven-cavity -o cavity.yaml
    """
    from sphrom.case import template

    text = template.new_case(kind, full=full)
    write_new(output, text, f"; next: sphrom case check {output}", force=force)


@cases.command(cls=Command)
def examples(
    name: Annotated[
        str | None, argument("[NAME]", "The case to write; without a name, list all.")
    ] = None,
    output: Output = None,
    force: Force = False,
) -> None:
    """List the example cases, or write one of them to a file, by default NAME.yaml.

    \b
    Example:
      sphrom case examples taylor_green_demo
      sphrom run taylor_green_demo.yaml
    """
    from sphrom.case import template

    if name is None:
        paths = template.examples()
        width = max(map(len, paths))
        for example, path in paths.items():
            tell(f"{example:{width}}  {template.title(path)}", indent=width + 2)
        return
    source = template.example(name)
    target = output or Path(source.name)
    text = source.read_text(encoding="utf-8")
    write_new(target, text, f"; next: sphrom run {target}", force=force)


@cases.command(cls=Command)
def schema(output: Output = None, force: Force = False) -> None:
    """Print the JSON schema of case files, for editors that complete and check keys.

    An editor with the YAML language server finds the schema by the first line of a case file, which
    `case new` writes: # yaml-language-server: $schema=sphrom.schema.json

    \b
    Example, in the folder of the case files:
      sphrom case schema -o sphrom.schema.json
    """
    from sphrom.case.schema import json_schema

    write_new(output, json.dumps(json_schema(), indent=2) + "\n", "", force=force)
