"""Commands that bring in other programs' snapshots, and write files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sphrom.cli import commands, completion
from sphrom.cli.options import Options, command


def _option(flag: str, metavar: str, text: str) -> Any:
    return typer.Option(flag, metavar=metavar, help=text)


Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILES",
        help="One file a snapshot: PySPH's .hdf5, .vtu, .vtp, .vtk, .npz; or a .pvd or .vtkhdf.",
        show_default=False,
    ),
]
ParticleArray = Annotated[
    str | None, _option("--array", "NAME", "PySPH's name of the particles to take.")
]
Position = Annotated[str, _option("--position", "NAMES", "A vector, or two fields.")]
Velocity = Annotated[
    str | None,
    _option(
        "--velocity", "NAMES", "A vector, or two fields.  [default: u,v, or the vector velocity]"
    ),
]
Density = Annotated[
    str | None,
    _option(
        "--density", "NAME", "Density; pressure follows.  [default: rho, or density_fluctuation]"
    ),
]
Pressure = Annotated[str | None, _option("--pressure", "NAME", "Pressure; density follows.")]
ZeroMean = Annotated[
    bool, typer.Option("--zero-mean-pressure", help="Take the mean out of each pressure.")
]
SortBy = Annotated[str | None, _option("--sort-by", "NAME", "Field that numbers the particles.")]
Units = Annotated[
    str,
    _option(
        "--units",
        "UNITS",
        "Of length, time, velocity, density and pressure, like length=mm,velocity=cm/s; a number "
        "is one of SI units.  [default: SI]",
    ),
]
Origin = Annotated[
    str, _option("--origin", "X,Y", "Where the scene's (0, 0) is, in the files' units.")
]
TimeStep = Annotated[
    float | None,
    _option(
        "--time-step",
        "TIME",
        "Time from file to file, in the order of their names.  [default: as files tell]",
    ),
]
Start = Annotated[
    float,
    _option(
        "--start",
        "TIME",
        "The files' time at which the case begins; of earlier ones nothing is taken.",
    ),
]
WriteCase = Annotated[
    Path | None,
    _option(
        "--write-case",
        "FILE",
        "Write a case with the files' times and resolution, and import for that one.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        "--seconds", min=0.0, help="What the run cost; unless it is given, no speed-up is known."
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
    command(app, "import", ("case", *TAKEN))(import_)
    without = tuple(name for name in TAKEN if name != "threads")
    command(app, "export", ("case", *without), force=ForceExport, case=Source)(export)


def import_(
    options: Options,
    files: Files,
    array: ParticleArray = None,
    position: Position = "x,y",
    velocity: Velocity = None,
    density: Density = None,
    pressure: Pressure = None,
    zero_mean_pressure: ZeroMean = False,
    sort_by: SortBy = None,
    units: Units = "",
    origin: Origin = "0,0",
    time_step: TimeStep = None,
    start: Start = 0.0,
    write_case: WriteCase = None,
    seconds: Seconds = None,
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
    commands.import_snapshots(
        files,
        options,
        array=array,
        position=position,
        velocity=velocity,
        density=density,
        pressure=pressure,
        zero_mean_pressure=zero_mean_pressure,
        sort_by=sort_by,
        units=units,
        origin=origin,
        time_step=time_step,
        start=start,
        write_case=write_case,
        seconds=seconds,
    )


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
