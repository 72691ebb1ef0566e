"""Command `report`: one HTML page of a case, its runs and their results.

The page holds the tables and figures that `compare` and `trade` wrote, and an animation of a
reduced beside the full run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from sphrom.case.geometry import n_particles
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.compare.report import MADE_BY, RECORDS, SpectrumRow
from sphrom.plots.files import write_whole
from sphrom.plots.page import Heading, Listing, Part, Picture, Section, Table, Text, render
from sphrom.plots.tables import format_figure, read_csv, read_json
from sphrom.report.animation import animations
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.trade.report import FOLDER as TRADE
from sphrom.train.report import FOLDER as TRAINING

PAGE = "report.html"
SHOWN_VALUES = (1, 2, 3, 5, 10, 15, 20, 30, 50)
"""Singular values that the table shows, counted from one."""
SHARE_DIGITS = 7
"""Shares of modes differ from all in their last digits."""
POINT_FIGURES = {
    "overview": "Speed of the full and of a reduced run half-way through, their difference, and "
    "how far reduced runs are from the full one over time.",
    "fields": "Speed and pressure half-way through: full, reduced, and their difference.",
    "centrelines": "Speed and pressure half-way through, along the line of comparison.",
    "errors": "Errors over time, over the field and on that line (relative L2 norm; Eq. 4.1 by the "
    "line's range), beside the best that the basis could do.",
    "profiles": "The full run beside independent solutions.",
    "history": "Velocity at a place in the shear layer over time.",
}
"""Captions of the figures of one parameter value, by how the names of their files begin."""
BASIS_FIGURES = {
    "singular-values": "Singular values and their shares (Eq. 4.3), dashed the modes in use.",
    "modes": "Modes: density and both components of velocity.",
}
"""Captions of the figures of one basis."""
TABLES = {
    "errors": "Errors in percent, on the line and over the whole field: the relative L2 norm over "
    "points and time, and at the worst instant (peak); pressure less its mean. Without sound, "
    "pressures are averaged over the time that sound takes to cross and return.",
    "estimates": "Errors that models on the reference points estimate themselves; effectivity "
    "is estimate over error. Extrapolated: outside of the trained values or times, where estimates "
    "are orders of magnitude.",
    "forces": "Forces on walls: means over time, and root mean square errors over the full run's "
    "force, those of the torque over its torque.",
    "measures": "Measured in the fluid, over time and along lines; errors are relative L2 norms, "
    "of a velocity's component over the whole velocity.",
    "walls": "Errors near walls and farther in.",
    "reference": "The full run, averaged over the window from time to time, against independent "
    "solutions; scatter is the standard deviation over that window.",
    "flow": "Properties of the flow: largest speed, drift, frequency.",
    "decay": "Decay of kinetic energy, fitted and exact.",
}
EQ41 = "_eq41_"
"""What the names of figures by Eq. 4.1 hold."""
EQ41_CAPTIONS = {
    "errors": "The same errors by Eq. 4.1, mean and peak over time: the mean error over the range "
    "on the line, or over that of the whole field, which makes the same error look smaller.",
}
"""Captions of second tables with figures by Eq. 4.1, which all others leave out."""
TRADE_FIGURES = {
    "trade.png": "Error against the cost of one run.",
    "extremes.png": "Stability and accuracy of models on the reference points.",
}
TRADE_TABLES = {
    "models": "All models that sphrom trade weighed, with relative L2 errors in percent.",
    "doing_nothing": "Alternatives without a model.",
}
COST_TABLES = {
    "timings": "Costs of the time steps of full and reduced runs, writing left out.",
    "stages": "Costs of each artifact, reading and writing included.",
}

TRAINING_FIGURE = (
    "Estimated errors over the region after each stage with the full runs that were made, and the "
    "fall of the worst with the true errors of runs that the model hadn't seen."
)
TRAINING_TABLES = {
    "training": "The stages of the training: worst estimates, the factors on them, and the runs "
    "that were chosen, with their errors before the model learnt from them.",
}


def run(context: StageContext) -> None:
    """Write the page beside the artifacts.

    Raises
    ------
    ArtifactError
        When the comparison or a table is missing, damaged or no longer that of the case, or the
        page can't be written.
    """
    workspace = Workspace(context)
    workspace.require(workspace.comparison())
    about = read_json(workspace.out / "compare.json", MADE_BY)["about"]
    case = context.case
    sections = [
        Section("The case", _case_parts(case, workspace.case_text)),
        Section("Full against reduced", [*animations(workspace), *_figures_by_point(workspace)]),
        Section("Errors", list(_tables(workspace.out / "tables", TABLES))),
        Section("Modes", [*_figures_by_basis(workspace), *_spectrum(workspace)]),
        Section("The trade", list(_trade(workspace.out / TRADE))),
        Section("The training", list(_training(workspace.out / TRAINING))),
        Section("Costs", list(_tables(workspace.out / "tables", COST_TABLES))),
    ]
    footer = (
        f"{about.get('software', 'sphrom')}, compared {about.get('date', '')} on "
        f"{about.get('threads', 1)} threads. All digits are in the tables beside this page."
    )
    page = render(case.name, _lead(case), sections, footer).encode()
    path = workspace.out / PAGE
    write_whole(path, page)
    context.report.info(f"wrote {path} ({len(page) / 1e6:.1f} MB)")


def _lead(case: Case) -> str:
    reduced = sum(len(case.rom_points(model)) for model in case.rom)
    return (
        f"{case.scene.title}: full runs at {len(case.points)} parameter values, "
        f"{reduced} reduced runs, and how far they are from each other."
    )


def _case_parts(case: Case, text: str) -> list[Part]:
    plan = step_plan(case)
    facts = [
        ("particles", f"{n_particles(case):,}"),
        ("particle spacing", f"{case.particle_spacing:g} m"),
        ("smoothing length", f"{case.smoothing_length:g} m"),
        ("speed of sound", f"{case.sound_speed:g} m/s"),
        ("trained at", ", ".join(point.label for point in case.train_points)),
        ("predicted at", ", ".join(point.label for point in case.test_points) or "nothing"),
        ("recorded", f"t = {plan.start_time:g} s to {plan.end_time:g} s"),
        ("steps", f"{plan.n_steps:,} of {plan.time_step:.4g} s"),
        ("snapshots", f"{plan.n_snapshots:,} a run"),
        *(
            (f"model {m.name}", f"{m.n_modes} modes, {m.projection}, {m.evaluation}")
            for m in case.rom
        ),
    ]
    return [Table("Settings.", ("", " "), facts), Listing("The whole case file", text)]


def _figures_by_point(workspace: Workspace) -> Iterator[Part]:
    for point in workspace.case.points:
        pictures = [
            *_pictures(workspace, POINT_FIGURES, point.file_label),
            *_pictures(workspace, _measure_figures(workspace.case), point.file_label),
        ]
        if pictures:
            yield Heading(point.label)
            yield from pictures
    if not workspace.case.compare.plots:
        yield Text("No figures were drawn: compare.plots is off.")


def _measure_figures(case: Case) -> dict[str, str]:
    """Return the captions of the figures of what a case measures, by how their names begin."""
    captions = {}
    for name, measured in case.scene.measure.items():
        kind = "force" if measured.force_on is not None else "measure"
        what = "along the line at the end" if measured.line is not None else "over time"
        captions[f"{kind}-{name}"] = f"{name}, {what}: full, projected onto the basis, and reduced."
    return captions


def _figures_by_basis(workspace: Workspace) -> Iterator[Part]:
    for name in workspace.case.bases:
        yield from _pictures(workspace, BASIS_FIGURES, name, f"Basis {name}. ")


def _pictures(
    workspace: Workspace, captions: dict[str, str], place: str, before: str = ""
) -> Iterator[Part]:
    """Yield the figures that were drawn."""
    for kind, caption in captions.items():
        path = workspace.out / "plots" / f"{kind}-{place}.png"
        if path.is_file():
            yield Picture(path.read_bytes(), before + caption)


def _tables(folder: Path, captions: dict[str, str], made_by: str = MADE_BY) -> Iterator[Table]:
    for name, caption in captions.items():
        path = folder / f"{name}.csv"
        if path.exists():
            headings, rows = read_csv(path, made_by, RECORDS.get(name))
            kept = [heading for heading in headings if EQ41 not in heading]
            yield _table(caption, kept, _columns(headings, rows, kept))
            if name in EQ41_CAPTIONS:
                described = headings[: headings.index("status")]
                kept = described + [heading for heading in headings if EQ41 in heading]
                yield _table(EQ41_CAPTIONS[name], kept, _columns(headings, rows, kept))


def _columns(headings: list[str], rows: list[list[str]], kept: Sequence[str]) -> list[list[str]]:
    """Return the columns of some headings."""
    indices = [headings.index(heading) for heading in kept]
    return [[row[i] for i in indices] for row in rows]


def _spectrum(workspace: Workspace) -> Iterator[Table]:
    path = workspace.out / "tables" / "singular_values.csv"
    if path.exists():
        headings, rows = read_csv(path, MADE_BY, SpectrumRow)
        number = headings.index("n_modes")
        shown = [row for row in rows if row[number] in map(str, SHOWN_VALUES)]
        caption = "Singular values, and the share of the first modes."
        yield _table(caption, headings, shown, SHARE_DIGITS)


def _trade(folder: Path) -> Iterator[Part]:
    """Yield figures and tables of `trade`, if it has run."""
    for name, caption in TRADE_FIGURES.items():
        if (folder / name).is_file():
            yield Picture((folder / name).read_bytes(), caption)
    yield from _tables(folder, TRADE_TABLES, "sphrom trade CASE")


def _training(folder: Path) -> Iterator[Part]:
    """Yield the figure and the table of `train`, if it has run."""
    if (folder / "training.png").is_file():
        yield Picture((folder / "training.png").read_bytes(), TRAINING_FIGURE)
    yield from _tables(folder, TRAINING_TABLES, "sphrom train CASE")


def _table(
    caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]], digits: int = 3
) -> Table:
    """Return a table with figures of few digits, without columns that hold nothing."""
    kept = [i for i in range(len(headings)) if any(row[i] for row in rows)]
    return Table(
        caption,
        [headings[i].replace("_", " ") for i in kept],
        [[_cell(row[i], digits) for i in kept] for row in rows],
    )


def _cell(text: str, digits: int) -> str:
    """Return a CSV's cell as a page shows it."""
    for kind in (int, float):
        try:
            return format_figure(kind(text), digits)
        except ValueError:
            continue
    return text or format_figure(None)
