"""Commands that bring in other programs' snapshots, and write files for other programs."""

from __future__ import annotations

from dataclasses import fields
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from sphrom.cli import commands, completion
from sphrom.cli.options import Options, command
from sphrom.exchange.meaning import Meaning

Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILES",
        help="One file a snapshot: PySPH's .hdf5, .vtu, .vtp, .vtk, .npz; or a .pvd or .vtkhdf.",
        show_default=False,
    ),
]
WriteCase = Annotated[
    Path | None,
    typer.Option(
        "--write-case",
        metavar="FILE",
        help="Write a case with the files' times and resolution, and import for that one.",
    ),
]
Source = Annotated[
    Path,
    typer.Argument(
        metavar="CASE|ARTIFACT",
        help="A case file, for all its artifacts, or one artifact (.h5).",
        show_default=False,
        autocompletion=completion.case_files,
    ),
]
ForceExport = Annotated[bool, typer.Option("--force", help="Write over files.")]
TAKEN = ("out", "overrides", "force", "threads", "quiet", "only")
"""Common options of `import`; `export` takes a case or an artifact, and no threads."""


def add_other_programs(app: typer.Typer) -> None:
    """Add the commands `import` and `export`."""
    kinds = get_type_hints(Meaning)
    own = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=Annotated[
                kinds[field.name],
                typer.Option(f"--{field.name.replace('_', '-')}", **field.metadata),
            ],
        )
        for field in fields(Meaning)
    ]
    command(app, "import", ("case", *TAKEN), own=own)(import_)
    without = tuple(name for name in TAKEN if name != "threads")
    command(app, "export", ("case", *without), force=ForceExport, case=Source)(export)


def import_(
    options: Options,
    files: Files,
    write_case: WriteCase = None,
    **meaning: Any,
) -> None:
    """Take another program's snapshots as a full run: fom-<parameters>.h5.

    The case says what was simulated: scene, fluid, particles, and the instants that are kept; map
    and the stages after it go on from there. If there are more files than instants, those at the
    instants are taken; where there is none, snapshots are interpolated in time.

    \b
    Example, Taylor-Green of PySPH, whose vortices are a quarter of the box from ours; others with
    the times of the files:
      sphrom import vortex.yaml taylor_green_output/*.hdf5 --only reynolds=100 --origin=-0.25,-0.25
      sphrom import vortex.yaml theirs/*.vtp --write-case theirs.yaml --units length=mm,time=ms
    """
    commands.import_snapshots(files, options, Meaning(**meaning), write_case)


def export(
    options: Options,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="vtu: a .pvd that lists one file for each step, for ParaView; csv: runs at some "
            "points.",
        ),
    ] = "vtu",
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
) -> None:
    """Write fields into files of their own, for ParaView and other programs.

    Any ParaView opens the .pvd files: runs step through their snapshots, pod.pvd through its modes.
    The fields of runs that store coordinates alone are computed on the way. ParaView from 5.12 on
    opens artifacts that hold fields as they are, with its VTKHDF reader.

    \b
    Example, all that a case has, its runs at a point, and one run:
      sphrom export cases/taylor_green_demo.yaml
      sphrom export cases/taylor_green_demo.yaml --to csv --at 0.25,0.5
      sphrom export runs/taylor_green_demo/fom-reynolds100.h5 --into vtu
    """
    commands.export(to, into, at or (), options)
