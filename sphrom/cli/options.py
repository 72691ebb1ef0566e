"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sphrom.cli import completion

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
Verbose = Annotated[bool, typer.Option("--verbose", help="Show details and all tables.")]
Log = Annotated[
    Path | None,
    typer.Option(
        "--log",
        metavar="FILE",
        help="Add what the command says, with details, to this file.  [default: sphrom.log, beside "
        "the artifacts]",
    ),
]
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
        metavar="NAME=VALUE[,...]",
        help="At these parameter values only; with rom also a MODEL's name, for this model only. "
        "May be repeated.",
        autocompletion=completion.values,
    ),
]
