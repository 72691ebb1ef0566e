"""Command `report`: one HTML page of a case, its runs and their results.

The answer comes first, then what was predicted, and what was trained. The page holds the tables and
figures that `compare` and other commands wrote, and an animation of a reduced beside the full run.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO
from sphrom.compare.answer import DIGITS, Answer, find_answer, percent
from sphrom.compare.tables import RECORDS, SpectrumRow, Tables
from sphrom.plots.page import Html, element, headline, listing, picture, render, table
from sphrom.plots.tables import flat, format_figure, headings, read_csv
from sphrom.report.animation import animations
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.sweep.statistics import FIGURES, beside
from sphrom.text import counted, duration
from sphrom.trade.candidates import FOLDER as TRADE
from sphrom.train.outcome import FOLDER as TRAINING
from sphrom.whole_files import write_whole

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
    "measures": "Measured over time and along lines; errors are relative L2 norms, of a component "
    "over the whole force or velocity.",
    "walls": "Errors near walls and farther in.",
    "reference": "The full run, averaged over the window from time to time, against independent "
    "solutions; scatter is the standard deviation over that window.",
    "flow": "Properties of the flow: largest speed, drift, frequency.",
    "decay": "Decay of kinetic energy, fitted and exact.",
}
EQ41 = "_eq41_"
"""What the names of figures by Eq. 4.1 hold."""
EQ41_CAPTION = (
    "The same errors by Eq. 4.1, mean and peak over time: the mean error over the range on the "
    "line, or over that of the whole field, which makes the same error look smaller."
)
"""Caption of the table with figures by Eq. 4.1, which all others leave out."""


@dataclass(frozen=True)
class Study:
    """What another command leaves in a folder beside the comparison, if it has run."""

    title: str
    folder: str
    made_by: str
    figures: Mapping[str, str]
    tables: Mapping[str, str]


STUDIES = (
    Study(
        "The trade",
        TRADE,
        "sphrom trade CASE",
        {
            "trade.png": "Error against the cost of one run.",
            "extremes.png": "Stability and accuracy of models on the reference points.",
        },
        {
            "models": "All models that sphrom trade weighed, with relative L2 errors in percent.",
            "doing_nothing": "Alternatives without a model.",
        },
    ),
    Study(
        "The training",
        TRAINING,
        "sphrom train CASE",
        {
            "training.png": "Estimated errors over a region of one parameter, and the fall of the "
            "worst one, with the true errors of runs that the model hadn't seen.",
        },
        {
            "training": "The stages of the training: worst estimates, the factors on them, and the "
            "runs that were chosen, with their errors before the model learnt from them.",
        },
    ),
)
"""The studies that the page shows."""
COST_TABLES = {
    "timings": "Costs of the time steps of full and reduced runs, writing left out.",
    "stages": "Costs of each artifact, reading and writing included.",
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
    tables, about = Tables.read(workspace)
    case, answer = context.case, find_answer(workspace, tables)
    points = {"Predicted": case.plan.test_points, "Trained": case.plan.train_points}
    shown = {
        title: list(_figures_by_point(workspace, tables, some)) for title, some in points.items()
    }
    first = next((title for title, some in points.items() if some), "")
    shown[first] = [*animations(workspace), *shown[first]]
    if not case.compare.plots:
        shown[first].append(element("p", "No figures were drawn: compare.plots is off."))
    sections = [
        *shown.items(),
        ("Errors", list(_compared(tables, TABLES))),
        ("Modes", [*_figures_by_basis(workspace, tables), *_spectrum(tables)]),
        *((study.title, list(_study(workspace.out, study))) for study in STUDIES),
        ("Uncertainty", list(_uncertainty(workspace))),
        ("Costs", list(_compared(tables, COST_TABLES))),
        ("The case", _case_parts(case, workspace.case_text)),
    ]
    footer = (
        f"{about.get('software', 'sphrom')}, compared {about.get('date', '')} on "
        f"{about.get('threads', 1)} threads. All digits are in the tables beside this page."
    )
    first_parts = [] if answer is None else [_headline(answer)]
    page = render(case.name, _lead(case), sections, footer, first_parts).encode()
    path = workspace.out / PAGE
    write_whole(path, page)
    context.report.info(f"wrote {path} ({len(page) / 1e6:.1f} MB)")


def _lead(case: Case) -> str:
    reduced = sum(len(case.plan.rom_points(model)) for model in case.rom)
    return (
        f"{case.scene.title}: full runs at {len(case.plan.points)} parameter values, "
        f"{reduced} reduced runs, and how far they are from each other."
    )


def _headline(answer: Answer) -> Html:
    """Return the answer as figures that stand out, and sentences."""
    speed_up, pays = answer.speed_up, answer.pays_from
    figures = [
        ("velocity is off by", percent(answer.error[0])),
        ("pressure is off by", percent(answer.error[1])),
    ]
    if answer.seconds is not None:
        figures.append(("a run takes", duration(answer.seconds)))
    if speed_up is not None:
        figures.append(("the full run takes as long as", f"{format_figure(speed_up, DIGITS)} runs"))
    if pays is not None:
        figures.append(("it pays from", f"{pays} runs on"))
    return headline(figures, list(answer.sentences()))


def _case_parts(case: Case, text: str) -> list[Html]:
    steps = case.plan.steps
    facts = [
        ("particles", f"{case.plan.n_particles:,}"),
        ("particle spacing", f"{case.plan.particle_spacing:g} m"),
        ("smoothing length", f"{case.plan.smoothing_length:g} m"),
        ("speed of sound", f"{case.plan.sound_speed:g} m/s"),
        ("trained at", ", ".join(point.label for point in case.plan.train_points)),
        ("predicted at", ", ".join(point.label for point in case.plan.test_points) or "nothing"),
        ("recorded", f"t = {steps.start_time:g} s to {steps.end_time:g} s"),
        ("steps", f"{steps.n_steps:,} of {steps.time_step:.4g} s"),
        ("snapshots", f"{steps.n_snapshots:,} a run"),
        *(
            (f"model {m.name}", f"n_modes: {m.n_modes}, {m.projection}, {m.evaluation}")
            for m in case.rom
        ),
    ]
    return [table("Settings.", ("", " "), facts), listing("The whole case file", text)]


def _figures_by_point(
    workspace: Workspace, tables: Tables, points: Iterable[ParameterPoint]
) -> Iterator[Html]:
    captions = {**POINT_FIGURES, **_measure_figures(workspace.case)}
    for point in points:
        told = _told(workspace.case, tables, point)
        if pictures := list(_pictures(workspace, captions, point.file_label, told=told)):
            yield element("h3", point.label)
            yield from pictures


def _told(case: Case, tables: Tables, point: ParameterPoint) -> str:
    """Return how far each model is off at a point, in words for who can't see figures."""
    names = {model.name for model in case.rom}
    parts = [
        f"{row.compared} is off by {percent(error[0])} in velocity and {percent(error[1])} in "
        "pressure"
        for row in tables.errors
        if (row.parameters, row.against) == (point.label, "full")
        and row.compared in names
        and (error := row.in_field) is not None
    ]
    return f" At {point.label} {'; '.join(parts)}." if parts else f" At {point.label}."


def _measure_figures(case: Case) -> dict[str, str]:
    """Return the captions of the figures of what a case measures, by how their names begin."""
    captions = {}
    for name, measured in case.scene.measure.items():
        kind = "force" if measured.force_on is not None else "measure"
        what = "along the line at the end" if measured.line is not None else "over time"
        captions[f"{kind}-{name}"] = f"{name}, {what}: full and reduced."
    return captions


def _figures_by_basis(workspace: Workspace, tables: Tables) -> Iterator[Html]:
    for name in workspace.case.plan.bases:
        told = _told_spectrum(workspace.case, tables, name)
        yield from _pictures(workspace, BASIS_FIGURES, name, f"Basis {name}. ", told)


def _told_spectrum(case: Case, tables: Tables, basis: str) -> str:
    """Return how singular values fall, in words for who can't see figures."""
    values = [row.singular_value for row in tables.singular_values if row.basis == basis]
    if not values:
        return ""
    sizes = (case.plan.n_modes if model.n_modes == AUTO else model.size for model in case.rom)
    used = min(len(values), max(sizes, default=1))
    return (
        f" Of {counted(len(values), 'value')} that of mode {used} is "
        f"{format_figure(values[used - 1] / values[0])} times the first."
    )


def _pictures(
    workspace: Workspace, captions: dict[str, str], place: str, before: str = "", told: str = ""
) -> Iterator[Html]:
    """Yield the figures that were drawn; `told` is what is to be said of them in words."""
    for kind, caption in captions.items():
        path = workspace.out / "plots" / f"{kind}-{place}.png"
        if path.is_file():
            yield picture(path.read_bytes(), before + caption, before + caption + told)


def _compared(tables: Tables, captions: Mapping[str, str]) -> Iterator[Html]:
    """Yield tables of the comparison; figures by Eq. 4.1 have tables of their own."""
    for name, caption in captions.items():
        if rows := [[*flat(row).values()] for row in getattr(tables, name)]:
            names = headings(RECORDS[name])
            eq41 = [heading for heading in names if EQ41 in heading]
            yield _table(caption, names, rows, set(names).difference(eq41))
            if eq41:
                described = names[: names.index("status")]
                yield _table(EQ41_CAPTION, names, rows, {*described, *eq41})


def _spectrum(tables: Tables) -> Iterator[Html]:
    shown = [[*flat(row).values()] for row in tables.singular_values if row.n_modes in SHOWN_VALUES]
    if shown:
        caption = "Singular values, and the share of the first modes."
        yield _table(caption, headings(SpectrumRow), shown, digits=SHARE_DIGITS)


def _study(out: Path, study: Study) -> Iterator[Html]:
    """Yield figures and tables of a study, if it was made."""
    folder = out / study.folder
    for name, caption in study.figures.items():
        if (folder / name).is_file():
            yield picture((folder / name).read_bytes(), caption)
    for name, caption in study.tables.items():
        if (path := folder / f"{name}.csv").exists():
            yield _table(caption, *read_csv(path, study.made_by))


def _uncertainty(workspace: Workspace) -> Iterator[Html]:
    """Yield the figures of the case's sweep, if it has statistics."""
    path = workspace.sweep().path
    for kind, caption in FIGURES.items():
        file = beside(path, kind, "png")
        if file.is_file():
            yield picture(file.read_bytes(), caption)


def _table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[Any]],
    shown: Container[str] | None = None,
    digits: int = 3,
) -> Html:
    """Return some columns with figures of few digits, without those that hold nothing."""
    kept = [
        i
        for i, heading in enumerate(headings)
        if (shown is None or heading in shown) and any(row[i] not in (None, "") for row in rows)
    ]
    return table(
        caption,
        [headings[i].replace("_", " ") for i in kept],
        [[_cell(row[i], digits) for i in kept] for row in rows],
    )


def _cell(value: Any, digits: int) -> str:
    """Return a figure, or the text of a file that may be one, as a page shows it."""
    if not isinstance(value, str):
        return format_figure(value, digits)
    for kind in (int, float):
        try:
            return format_figure(kind(value), digits)
        except ValueError:
            continue
    return value or format_figure(None)
