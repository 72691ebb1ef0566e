"""Command `report`: one HTML page about a case, its runs and their results.

The page begins with the main result, followed by predicted and by trained points. It contains the
tables and figures listed in `contents.yaml`, which `compare` and other commands write, and an
animation of a reduced run beside the full run. It makes no network requests, and its policy forbids
them; `page.html` has the frame, style and scripts. All text is escaped, and control characters,
which could reverse the direction of the text around them, are shown.
"""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape as html_escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts import open_artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.answer import DIGITS, Answer, find_answer, percent
from sphrom.compare.comparison_figures import QUANTITIES, frame_of, side_by_side
from sphrom.compare.comparison_tables import RECORDS, Tables
from sphrom.models.stored_run import StoredRun
from sphrom.plots.panels import SHOWN, SOLID_COLOUR, colour_scale
from sphrom.plots.tables import format_figure, read_csv
from sphrom.setup.context import StageContext
from sphrom.setup.cost import described_run
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace
from sphrom.sweep.batches import COMPLETE
from sphrom.sweep.statistics import FIGURES, beside
from sphrom.text import counted, duration, visible
from sphrom.whole_files import write_whole


class Html(str):
    """A part of a page that is already markup; other texts are escaped."""


def element(tag: str, *content: str, **attributes: str) -> Html:
    """Return an element; content and the values of attributes are escaped unless they are Html.

    A final underscore, for names that are Python keywords, is removed; others become dashes.
    """
    named = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for name, value in attributes.items()
    )
    end = "" if tag in ("img", "input") else f"</{tag}>"
    return Html(f"<{tag}{named}>{''.join(map(escape, content))}{end}")


def escape(text: str, keep: str = "") -> Html:
    """Return HTML that shows a text unchanged."""
    return text if isinstance(text, Html) else Html(html_escape(visible(text, keep)))


def listing(title: str, text: str) -> Html:
    """Return a text that unfolds on a click, such as a case file."""
    return element("details", element("summary", title), element("pre", escape(text, keep="\n")))


def picture(png: bytes, caption: str, described: str = "") -> Html:
    """Return a PNG image with its caption and a description; a click enlarges it."""
    button = {"type": "button", "class_": "zoom", "title": "show large"}
    image = element("button", _image(png, described or caption), **button)
    return element("figure", image, element("figcaption", caption))


def headline(figures: Sequence[tuple[str, str]], sentences: Sequence[str]) -> Html:
    """Return highlighted figures, each with its name, and sentences about them."""
    boxes = [element("div", element("dt", name), element("dd", value)) for name, value in figures]
    text = (element("p", sentence) for sentence in sentences)
    return Html(element("dl", *boxes, class_="headline") + "".join(text))


def table(caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    """Return a table; columns of text are aligned left."""
    columns = list(zip(*rows, strict=True)) or [()] * len(headings)
    first = (next((cell for cell in column if cell.strip("– ")), "") for column in columns)
    kinds = [{} if re.match(r"-?\d", cell) else {"class_": "text"} for cell in first]

    def line(tag: str, cells: Sequence[str]) -> Html:
        each = zip(cells, kinds, strict=True)
        return element("tr", *(element(tag, cell, **kind) for cell, kind in each))

    head = element("thead", line("th", headings))
    whole = element("table", head, element("tbody", *(line("td", row) for row in rows)))
    return element("figure", element("figcaption", caption), element("div", whole, class_="wide"))


def legend(label: str, low: str, high: str, colours: Sequence[str]) -> Html:
    """Return the legend of a colour scale of an animation."""
    bar = element("i", style=f"background: linear-gradient(to right, {', '.join(colours)})")
    return element("span", f"{label}: {low}", bar, high, class_="scale")


def animation(
    frames: Sequence[bytes],
    times: Sequence[str],
    heads: Sequence[str],
    legends: Sequence[Html],
    caption: str,
    extent: Sequence[str] = ("", "", "", ""),
) -> Html:
    """Return an animation of PNG images, with a head above each column of panels.

    A slider and a button control it; without scripts, the middle frame is shown. `extent` has the
    ends of the axes of each panel: left, right, lower, upper [m].
    """
    middle, (left, right, lower, upper) = len(frames) // 2, extent
    encoded = [base64.b64encode(frame).decode("ascii") for frame in frames]
    data = json.dumps({"frames": encoded, "times": list(times)}).replace("<", "\\u003c")
    slider = {"type": "range", "aria_label": "time", "min": "0", "max": f"{len(frames) - 1}"}
    return element(
        "figure",
        element(
            "div",
            element("div", *(element("span", head) for head in heads), class_="heads"),
            _axis("y", upper, lower, 2),
            _image(frames[middle], caption),
            _axis("x", left, right, len(heads)),
            class_="panels",
        ),
        element(
            "div",
            element("button", "Play", type="button"),
            element("input", **slider, value=f"{middle}"),
            element("output"),
            class_="controls",
        ),
        element("div", *legends),
        element("figcaption", caption),
        element("script", Html(data), type="application/json"),
        class_="animation",
    )


def render(
    title: str,
    lead: str,
    sections: Sequence[tuple[str, Sequence[Html]]],
    footer: str,
    first: Sequence[Html] = (),
) -> str:
    """Return a page of sections, each a title with parts; sections without parts are left out.

    The parts `first` are above the links to the sections.
    """
    shown = [(f"s{k}", *section) for k, section in enumerate(s for s in sections if s[1])]
    template = Template((files("sphrom.report") / "page.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=escape(title),
        lead=escape(lead),
        first="".join(first),
        links="".join(element("a", name, href=f"#{place}") for place, name, _ in shown),
        body="\n".join(
            element("section", element("h2", name), *parts, id=place)
            for place, name, parts in shown
        ),
        footer=escape(footer),
    )


def _axis(name: str, first: str, last: str, number: int) -> Html:
    """Return the ends of an axis, with its name between them, for a number of panels."""
    ends = element("span", *(element("i", text) for text in (first, f"{name} [m]", last)))
    return element("div", *[ends] * number, class_=f"axis {name}", aria_hidden="true")


def _image(png: bytes, caption: str) -> Html:
    data = base64.b64encode(png).decode("ascii")
    return element("img", alt=caption, src=f"data:image/png;base64,{data}")


Pixels = NDArray[np.uint8]

PAGE = "report.html"
SHOWN_VALUES = (1, 2, 3, 5, 10, 15, 20, 30, 50)
"""Numbers of the singular values in the table, counted from one."""
SHARE_DIGITS = 7
"""Digits of shares of modes, which differ from 100 % only in their last digits."""
SHORT = 10
"""Number of characters from which on a figure is rounded."""
N_FRAMES = 25
GAP = 1
"""Width of the white gap between panels, in pixels."""


def run(context: StageContext) -> None:
    """Write the page beside the artifacts.

    Raises ArtifactError when the page can't be written, or a table is missing or of another case.
    """
    workspace = Workspace(context)
    workspace.require(workspace.comparison())
    tables, about = Tables.read(workspace)
    case = context.case
    answer = find_answer(workspace, tables)
    out = workspace.out
    made_by = f"sphrom compare {context.words}"
    contents = yaml.safe_load((files("sphrom.report") / "contents.yaml").read_text("utf-8"))
    captions = contents["points"] | _measure_captions(case)
    points = {"Predicted": case.plan.test_points, "Trained": case.plan.train_points}
    shown: dict[str, list[Html]] = {title: [] for title in points}
    for title, point in ((title, point) for title, some in points.items() for point in some):
        named = _named(captions, point.file_label)
        words = _errors_of(case, tables, point)
        if pictures := list(_pictures(out / "plots", named, words=words)):
            shown[title] += element("h3", point.label), *pictures
    first = next((title for title, some in points.items() if some), "")
    shown[first] = [*animations(workspace), *shown[first]]
    if not case.compare.plots:
        shown[first].append(element("p", "No figures were drawn: compare.plots is off."))
    modes = [
        part
        for name in case.plan.bases
        for part in _pictures(out / "plots", _named(contents["bases"], name), f"Basis {name}. ")
    ]
    runs = (element("p", described_run(case, point)) for point in case.plan.points)
    sections = [
        *shown.items(),
        ("Errors", list(_tables(out / "tables", contents["tables"], made_by))),
        ("Modes", [*modes, *_tables(out / "tables", contents["modes"], made_by)]),
        *((study["title"], _study(context, study)) for study in contents["studies"]),
        ("Sweeps", list(_sweeps(workspace))),
        ("Costs", list(_tables(out / "tables", contents["costs"], made_by))),
        ("The case", [*runs, listing("The whole case file", case.text)]),
    ]
    footer = (
        f"{about.get('software', 'sphrom')}, compared {about.get('date', '')} on "
        f"{about.get('threads', 1)} threads. All digits are in the tables beside this page."
    )
    reduced = sum(len(case.plan.rom_points(model)) for model in case.rom)
    lead = (
        f"{case.scene.title}: full runs at {len(case.plan.points)} parameter values, "
        f"{reduced} reduced runs, and their differences."
    )
    first_parts = [] if answer is None else [_headline(answer)]
    page = render(case.name, lead, sections, footer, first_parts).encode()
    write_whole(out / PAGE, page)
    context.report.info(f"wrote {out / PAGE} ({len(page) / 1e6:.1f} MB)")


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
        kind = "force" if measured.force_on is not None else "measure"
        axis = "along the line at the end" if measured.line is not None else "over time"
        captions[f"{kind}-{name}"] = f"{name}, {axis}: full and reduced runs."
    return captions


def _errors_of(case: Case, tables: Tables, point: ParameterPoint) -> str:
    """Describe the errors of each model at a point, for readers who can't see figures."""
    names = {model.name for model in case.rom}
    parts = [
        f"{row.compared} is off by {percent(error[0])} in velocity and {percent(error[1])} in "
        "pressure"
        for row in tables.errors
        if (row.parameters, row.against) == (point.label, "full")
        and row.compared in names
        and (error := row.in_field) is not None
    ]
    return f" At {point.label} {'; '.join(parts)}."


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


def _study(context: StageContext, study: Mapping[str, Any]) -> list[Html]:
    folder, made_by = context.out / study["folder"], f"{study['made_by']} {context.words}"
    tables = _tables(folder, study["tables"], made_by)
    return [*_pictures(folder, study["figures"]), *tables]


def _sweeps(workspace: Workspace) -> Iterator[Html]:
    """Yield a summary and the figures of every sweep in the folder."""
    for path in sorted(workspace.out.glob("sweep-*.h5")):
        target = replace(workspace.sweep(), path=path)
        with open_artifact(path, target.schema, made_by=target.made_by) as artifact:
            model = artifact.text("model")
            status = artifact.read("status")
        counts = f"{counted(len(status), 'run')}, {np.count_nonzero(status == COMPLETE):,} complete"
        note = "; the case has other settings now" * bool(workspace.reason_to_make(target))
        yield element("h3", path.stem)
        yield element("p", f"{model}: {counts}; {path.stem}.csv has each{note}.")
        figures = {beside(path, kind, "png").name: text for kind, text in FIGURES.items()}
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
            [headings[i].replace("_", " ") for i in kept],
            [[_cell(row[i], digits) for i in kept] for row in rows],
        )


def _cell(text: str, digits: int) -> str:
    """Format a cell of a CSV file; short figures, such as parameters, are not rounded."""
    for kind in (int, float):
        try:
            figure = format_figure(kind(text), digits)
        except ValueError:
            continue
        return text.removesuffix(".0") if "." in text and len(text) < SHORT else figure
    return text or format_figure(None)


def gradient(colours: str, n_colours: int = 9) -> list[str]:
    """Return colours of a colour map of matplotlib, from low to high values, for CSS."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(c) for c in colormaps[colours](np.linspace(0.0, 1.0, n_colours))]


def paint(field: Array, colours: str, ends: tuple[float, float]) -> Pixels:
    """Return a field (ny, nx), with rows from below, as pixels (ny, nx, 3), with rows from above.

    NaN means no fluid.
    """
    from matplotlib import colormaps
    from matplotlib.colors import Normalize, to_rgba

    shown = colormaps[colours].with_extremes(bad=to_rgba(SOLID_COLOUR))
    values = Normalize(*ends)(np.ma.masked_invalid(field[::-1]))
    return np.asarray(shown(values, bytes=True))[..., :3]


def as_png(rows: Sequence[Sequence[Pixels]]) -> bytes:
    """Return a PNG image with rows of panels of equal size, with white gaps."""
    from matplotlib.image import imsave

    gap = ((0, GAP), (0, GAP), (0, 0))
    padded = [[np.pad(panel, gap, constant_values=255) for panel in row] for row in rows]
    content = io.BytesIO()
    imsave(content, np.vstack([np.hstack(row) for row in padded])[:-GAP, :-GAP], format="png")
    return content.getvalue()


def animations(workspace: Workspace) -> Iterator[Html]:
    """Yield an animation of the first complete reduced run, if there is one.

    Predicted points come before trained ones, and fast models before others.
    """
    plan = workspace.case.plan
    for point in (*plan.test_points, *plan.train_points):
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
        chosen = np.unique(np.linspace(0, len(times) - 1, N_FRAMES).round().astype(int))
        both = [run.sampled(probes.grid, chosen.tolist()) for run in (full, reduced)]
    rows, legends = [], []
    for quantity in QUANTITIES:
        fields = side_by_side(name, quantity, *(getattr(samples, quantity) for samples in both))
        scale = colour_scale(fields[:2])
        of_difference = colour_scale(fields[2:])
        rows.append([*zip(fields, (scale, scale, of_difference), strict=True)])
        for field, (colours, ends) in rows[-1][1:]:
            low, high = map(format_figure, ends)
            legends.append(legend(field.label, low, high, gradient(colours)))
    return animation(
        frames=[
            as_png([[paint(probes.picture(f.values[i]), *s) for f, s in row] for row in rows])
            for i in range(len(chosen))
        ],
        times=[f"{times[snapshot]:.4g}" for snapshot in chosen],
        heads=("full", name, "difference"),
        extent=[f"{end:g}" for end in frame_of(workspace.case).extent],
        legends=legends,
        caption=f"{point.label}: speed above, pressure below; full run, {name}, and their "
        f"difference, from t = {times[chosen[0]]:.4g} s to {times[chosen[-1]]:.4g} s. All frames "
        f"have the same colour scale; the extreme {SHOWN[0]:g} % at either end share one colour.",
    )
