"""Command `report`: one HTML page about a case, its runs and their results.

The page begins with the main result, followed by predicted and by trained points, that of the
result first. It contains the
tables and figures listed in `contents.yaml`, which `compare` and other commands write, and an
animation of a reduced run beside the full run. It links to the exported pages of models.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import chain
from pathlib import Path
from urllib.parse import quote

import numpy as np
import yaml
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts import open_artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.answer import DIGITS, Answer, find_answer, percent
from sphrom.compare.basis_figures import frame_of
from sphrom.compare.comparison_figures import (
    QUANTITIES,
    draw_comparison,
    pictured_snapshot,
    side_by_side,
)
from sphrom.compare.comparison_tables import RECORDS, Tables
from sphrom.exchange.export import FOLDER
from sphrom.models.stored_run import StoredRun
from sphrom.plots.panels import SHOWN, SOLID_COLOUR, colour_scale, empty_colour
from sphrom.plots.tables import format_figure, read_csv
from sphrom.portable.page import gradient
from sphrom.report.page import (
    Html,
    animation,
    element,
    headline,
    legend,
    listing,
    picture,
    render,
    table,
)
from sphrom.setup.assembly import without_air
from sphrom.setup.context import StageContext
from sphrom.setup.cost import described_run
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace
from sphrom.sweep.batches import COMPLETE, doubts_in_words, read_outcomes
from sphrom.sweep.curves import CAPTION
from sphrom.sweep.statistics import FIGURES, beside, regimes_in_words
from sphrom.text import counted, duration
from sphrom.whole_files import write_whole

Pixels = NDArray[np.uint8]

PAGE = "report.html"
SHOWN_VALUES = (1, 2, 3, 5, 10, 15, 20, 30, 50)
"""Numbers of the singular values in the table, counted from one."""
SHARE_DIGITS = 7
"""Digits of shares of modes, which differ from 100 % only in their last digits."""
SHORT = 10
"""Number of characters from which a figure is rounded."""
WORDS = {"n_modes": "modes", "eq41": "Eq. 4.1", "speed_up": "speed-up", "_": " "}
"""Replacements in headings of tables."""
N_FRAMES = 25
GAP = 1
"""Width of the white gap between panels, in pixels."""


def run(context: StageContext) -> None:
    """Write the page beside the artifacts, and draw the missing figures of the comparison.

    Raises ArtifactError when the page can't be written, or a table is missing or of another case.
    """
    workspace = Workspace(context)
    workspace.require(workspace.comparison())
    tables, metadata = Tables.read(workspace)
    case = context.case
    plan = case.plan
    contents = yaml.safe_load((files("sphrom.report") / "contents.yaml").read_text("utf-8"))
    captions = contents["points"] | _measure_captions(case)
    parts: dict[str, list[Html]] = {title: [] for title in contents["sections"]}
    answer = find_answer(workspace, tables)
    points = {
        "Predicted": _answered_first(plan.test_points, answer),
        "Trained": _answered_first(plan.train_points, answer),
    }
    first = next((title for title, some in points.items() if some), "Predicted")
    if case.compare.plots is not False:
        draw_comparison(workspace, tables)
    parts[first] += animations(workspace, chain.from_iterable(points.values()))
    for title, some in points.items():
        for point in some:
            parts[title] += _figures_at(workspace, tables, point, captions)
    if case.compare.plots is False:
        parts[first].append(element("p", "No figures were drawn: compare.plots is off."))
    for basis in plan.bases:
        named = _named(contents["bases"], basis)
        parts["Modes"] += _pictures(workspace.out / "plots", named, f"Basis {basis}. ")
    parts["Sweeps"] += _sweeps(workspace)
    parts["The case"] += (element("p", described_run(case, point)) for point in plan.points)
    parts["The case"].append(listing("The whole case file", case.text))
    for title, listed in contents["sections"].items():
        parts[title] += _listed(context, **(listed or {}))
    footer = (
        f"{metadata.get('software', 'sphrom')}, compared {metadata.get('date', '')} on "
        f"{metadata.get('threads', 1)} threads. All digits are in the tables beside this page."
    )
    reduced = sum(len(plan.rom_points(model)) for model in case.rom)
    lead = (
        f"{case.scene.title}: full runs at {len(plan.points)} parameter values, "
        f"{reduced} reduced runs, and their differences."
    )
    head = [] if answer is None else [_headline(answer)]
    head += _links(workspace)
    page = render(case.name, lead, list(parts.items()), footer, head).encode()
    path = workspace.out / PAGE
    write_whole(path, page)
    context.report.info(f"wrote {path} ({len(page) / 1e6:.1f} MB)")


def _answered_first(
    points: Iterable[ParameterPoint], answer: Answer | None
) -> list[ParameterPoint]:
    """Return points in order, except that the one of the answer comes first."""
    return sorted(points, key=lambda p: answer is None or p.label != answer.row.parameters)


def _links(workspace: Workspace) -> Iterator[Html]:
    """Yield links to those exported pages that are not older than their models."""
    for model in workspace.case.rom:
        trained = workspace.model(model).path
        path = workspace.out / FOLDER / f"model-{model.name}.html"
        if not (trained.exists() and path.exists()):
            continue
        if path.stat().st_mtime_ns >= trained.stat().st_mtime_ns:
            address = quote(path.relative_to(workspace.out).as_posix())
            yield element("p", element("a", f"Run {path.stem} in the browser", href=address))


def _headline(answer: Answer) -> Html:
    figures = [
        ("velocity is off by", percent(answer.error[0])),
        ("pressure is off by", percent(answer.error[1])),
    ]
    timing = answer.timing
    if timing is not None and timing.reduced_seconds is not None:
        figures.append(("a run takes", duration(timing.reduced_seconds)))
    if timing is not None and timing.speed_up is not None:
        runs = f"{format_figure(timing.speed_up, DIGITS)} runs"
        figures.append(("the full run takes as long as", runs))
    if answer.pays_from is not None:
        figures.append(("it pays from", f"{answer.pays_from} runs on"))
    return headline(figures, list(answer.sentences()))


def _measure_captions(case: Case) -> dict[str, str]:
    """Return the captions of the figures of measurements, by the prefix of their file names."""
    captions = {}
    for name, measured in case.scene.recorded.items():
        axis = "over time" if measured.quantities else "along the line at the end"
        captions[f"{measured.folder}-{name}"] = f"{name}, {axis}: full and reduced runs."
    return captions


def _figures_at(
    workspace: Workspace, tables: Tables, point: ParameterPoint, captions: Mapping[str, str]
) -> list[Html]:
    """Return the figures at a point, with the errors of models for readers who can't see them."""
    names = {model.name for model in workspace.case.rom}
    errors = [
        f"{row.compared} is off by {percent(error[0])} in velocity and {percent(error[1])} in "
        "pressure"
        for row in tables.errors
        if (row.parameters, row.against) == (point.label, "full")
        and row.compared in names
        and (error := row.in_field) is not None
    ]
    title = workspace.case.plan.title(point)
    words = f" At {title} {'; '.join(errors)}."
    named = _named(captions, point.file_label)
    pictures = list(_pictures(workspace.out / "plots", named, words=words))
    return [element("h3", title), *pictures] if pictures else []


def _named(captions: Mapping[str, str], place: str) -> dict[str, str]:
    return {f"{kind}-{place}.png": caption for kind, caption in captions.items()}


def _pictures(
    folder: Path, captions: Mapping[str, str], before: str = "", words: str = ""
) -> Iterator[Html]:
    """Yield the existing figures; `words` is added to their descriptions."""
    for name, caption in captions.items():
        if (folder / name).is_file():
            content = (folder / name).read_bytes()
            yield picture(content, before + caption, before + caption + words)


def _listed(
    context: StageContext,
    folder: str = "tables",
    made_by: str = "sphrom compare",
    figures: Mapping[str, str] = {},
    tables: Mapping[str, str] = {},
) -> Iterator[Html]:
    """Yield the figures and tables that the contents list for a section."""
    yield from _pictures(context.out / folder, figures)
    yield from _tables(context.out / folder, tables, f"{made_by} {context.words}")


def _sweeps(workspace: Workspace) -> Iterator[Html]:
    """Yield a summary and the figures of every sweep in the folder."""
    for path in sorted(workspace.out.glob("sweep-*.h5")):
        target = replace(workspace.sweep(), path=path)
        with open_artifact(path, target.schema, made_by=target.made_by) as artifact:
            model = artifact.text("model")
            runs = read_outcomes(artifact)
            found = artifact.read("regime").tolist() if "regime" in artifact.datasets else []
        n_complete = sum(run.status == COMPLETE for run in runs)
        counts = f"{counted(len(runs), 'run')}, {n_complete:,} complete"
        told = f"; regimes: {regimes_in_words(found)}" * bool(found)
        note = "; the case has other settings now" * bool(workspace.reason_to_make(target))
        yield element("h3", path.stem)
        yield element("p", f"{model}: {counts}; {path.stem}.csv has each{told}{note}.")
        if (doubts := doubts_in_words(runs)) is not None:
            yield element("p", f"{doubts}.")
        figures = {path.with_suffix(".png").name: CAPTION}
        figures |= {beside(path, kind, "png").name: text for kind, text in FIGURES.items()}
        yield from _pictures(path.parent, figures)


def _tables(folder: Path, captions: Mapping[str, str], made_by: str) -> Iterator[Html]:
    """Yield tables with rounded figures, without empty columns."""
    for key, caption in captions.items():
        name, _, part = key.partition(" ")
        path, digits = folder / f"{name}.csv", 3
        if not path.exists():
            continue
        headings, rows = read_csv(path, made_by, RECORDS.get(name))
        if name == "singular_values":
            number = headings.index("n_modes")
            digits = SHARE_DIGITS
            rows = [row for row in rows if row[number] in map(str, SHOWN_VALUES)]
        described = range(headings.index("status") if part else 0)
        chosen = [i for i, heading in enumerate(headings) if ("_eq41_" in heading) == bool(part)]
        kept = [i for i in (*described, *chosen) if any(row[i] for row in rows)]
        yield table(
            caption,
            [_heading(headings[i]) for i in kept],
            [[_cell(row[i], digits) for i in kept] for row in rows],
        )


def _heading(column: str) -> str:
    """Return the heading of a column in words."""
    name, bracket, unit = column.partition(" [")
    for text, word in WORDS.items():
        name = name.replace(text, word)
    return name + bracket + unit


def _cell(text: str, digits: int) -> str:
    """Format a cell of a CSV file; short figures, such as parameters, are not rounded."""
    for kind in (int, float):
        try:
            figure = format_figure(kind(text), digits)
        except ValueError:
            continue
        return text.removesuffix(".0") if "." in text and len(text) < SHORT else figure
    return text or format_figure(None)


def paint(
    field: Array, colours: str, ends: tuple[float, float], empty: str = SOLID_COLOUR
) -> Pixels:
    """Return a field (ny, nx), with rows from below, as pixels (ny, nx, 3), with rows from above.

    NaN means no fluid, which has the colour `empty`.
    """
    from matplotlib import colormaps
    from matplotlib.colors import Normalize, to_rgba

    shown = colormaps[colours].with_extremes(bad=to_rgba(empty))
    low, high = ends
    values = Normalize(low, high)(np.ma.masked_invalid(field[::-1]))
    return np.asarray(shown(values, bytes=True))[..., :3]


def as_png(rows: Sequence[Sequence[Pixels]]) -> bytes:
    """Return a PNG image with rows of panels of equal size, with white gaps."""
    from matplotlib.image import imsave

    gap = ((0, GAP), (0, GAP), (0, 0))
    padded = [[np.pad(panel, gap, constant_values=255) for panel in row] for row in rows]
    content = io.BytesIO()
    imsave(content, np.vstack([np.hstack(row) for row in padded])[:-GAP, :-GAP], format="png")
    return content.getvalue()


def animations(workspace: Workspace, points: Iterable[ParameterPoint]) -> Iterator[Html]:
    """Yield an animation of the first complete reduced run at some points, if there is one.

    Fast models come before others.
    """
    plan = workspace.case.plan
    for point in points:
        for model in plan.models_by_speed:
            if point in plan.rom_points(model):
                with StoredRun.opened(workspace, point, model) as run:
                    if run.is_complete:
                        yield _animation(workspace, model.name, point, run)
                        return


def _animation(workspace: Workspace, name: str, point: ParameterPoint, reduced: StoredRun) -> Html:
    probes = probes_of(workspace.case)
    with StoredRun.opened(workspace, point) as full:
        times = full.time
        shown = times[pictured_snapshot(full.kinetic_energy)]
        chosen = np.unique(np.linspace(0, len(times) - 1, N_FRAMES).round().astype(int))
        full_samples = without_air(workspace.case, full.sampled(probes.pictured, chosen.tolist()))
    samples = without_air(workspace.case, reduced.sampled(probes.pictured, chosen.tolist()))
    frame = frame_of(workspace.case)
    title = workspace.case.plan.title(point)
    empty = empty_colour(frame)
    rows, legends = [], []
    for quantity in QUANTITIES:
        fields = side_by_side(
            name, quantity, getattr(full_samples, quantity), getattr(samples, quantity)
        )
        scale = colour_scale(fields[:2])
        of_difference = colour_scale(fields[2:])
        rows.append([*zip(fields, (scale, scale, of_difference), strict=True)])
        for field, (colours, ends) in rows[-1][1:]:
            low, high = map(format_figure, ends)
            legends.append(legend(field.label, low, high, gradient(colours)))
    return animation(
        frames=[
            as_png(
                [
                    [
                        paint(probes.picture(f.values[i]), colours, ends, empty)
                        for f, (colours, ends) in row
                    ]
                    for row in rows
                ]
            )
            for i in range(len(chosen))
        ],
        times=[f"{times[snapshot]:.4g}" for snapshot in chosen],
        first=int(np.argmin(np.abs(times[chosen] - shown))),
        heads=("full", name, f"{name} - full"),
        extent=[f"{end:g}" for end in frame.ends],
        labels=frame.labels,
        legends=legends,
        caption=f"{title}: speed above, pressure below; full run, {name}, and the difference "
        f"{name} - full, from t = {times[chosen[0]]:.4g} s to {times[chosen[-1]]:.4g} s. All "
        f"frames have the same colour scale; the extreme {SHOWN[0]:g} % at either end share one "
        "colour.",
    )
