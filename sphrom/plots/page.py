"""One HTML page with all of its text, tables, figures and animations, and no links out.

The page asks for nothing over a network, and forbids it. All text is escaped, and control
characters, which could turn the direction of their surroundings, are shown.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape as html_escape

from sphrom.text import visible

CONTENT = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""The page may load its own content alone."""
FRAMES_PER_SECOND = 8

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto;
  max-width: 72rem; padding: 1rem 1.5rem 4rem; }
h1 { font-size: 1.8rem; margin: 1rem 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.5rem 0 .5rem; border-bottom: 1px solid #ddd; }
h3 { font-size: 1.05rem; margin: 1.5rem 0 .3rem; }
p.lead { color: #444; margin-top: 0; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1rem; }
h1, h2, h3, p, figcaption, summary { overflow-wrap: anywhere; }
dl.headline { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.2rem 0; }
dl.headline div { flex: 1 1 9rem; border: 1px solid #ddd; border-radius: .4rem;
  padding: .6rem .9rem; }
dl.headline dt { color: #444; font-size: .9rem; }
dl.headline dd { margin: 0; font-size: 1.6rem; font-weight: 600; }
figure { margin: 1rem 0 1.5rem; }
figure img { max-width: 100%; height: auto; display: block; }
button.zoom { display: block; border: 0; padding: 0; background: none; cursor: zoom-in; }
dialog { max-width: 100vw; max-height: 100vh; padding: .5rem; border: 0; }
dialog div { overflow: auto; max-width: 96vw; max-height: 88vh; }
dialog img { display: block; max-width: none; }
dialog::backdrop { background: rgba(0, 0, 0, .7); }
figcaption { color: #444; font-size: .9rem; max-width: 60rem; }
div.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; margin: .3rem 0 1rem;
  font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #eee; }
th { border-bottom: 1px solid #999; vertical-align: bottom; font-weight: 600; }
td.text, th.text { text-align: left; white-space: nowrap; }
pre { background: #f6f6f6; padding: .8rem; overflow-x: auto; font-size: .8rem; }
.animation img { width: 100%; image-rendering: pixelated; }
.animation .panels { display: grid; grid-template-columns: auto minmax(0, 1fr); gap: .1rem .3rem; }
.animation .heads { grid-column: 2; display: flex; font-size: .9rem; }
.animation .heads span { flex: 1; text-align: center; overflow-wrap: anywhere; }
.axis { display: flex; gap: 4px; font-size: .75rem; color: #555; }
.axis.y { flex-direction: column; }
.axis.x { grid-column: 2; }
.axis span { flex: 1; display: flex; justify-content: space-between; }
.axis.x span { padding: 0 .2rem; }
.axis.y span { flex-direction: column; align-items: flex-end; }
.axis i { font-style: normal; }
.axis.y i:nth-child(2) { writing-mode: vertical-rl; transform: rotate(180deg); }
@media (max-width: 40rem) { .axis.y i:nth-child(2) { display: none; } }
.animation .controls { display: flex; gap: .8rem; align-items: center; margin: .4rem 0; }
.animation input { flex: 1; }
.animation output { min-width: 7rem; font-variant-numeric: tabular-nums; }
.scale { display: inline-block; margin: 0 1.5rem .3rem 0; font-size: .85rem; white-space: nowrap; }
.scale i { display: inline-block; width: min(8rem, 22vw); height: .7rem; margin: 0 .4rem; }
footer { margin-top: 3rem; color: #666; font-size: .85rem; }
@media (max-width: 40rem) { body { padding: .5rem .8rem 2rem; } h1 { font-size: 1.4rem; } }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav, .controls, dialog { display: none; }
  figure, dl.headline div { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  div.wide { overflow: visible; }
  table { font-size: 6.5pt; }
  td.text, th.text { white-space: normal; }
  th, td { padding: 1pt 2pt; overflow-wrap: anywhere; }
  .scale i { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""

PLAYER = """
for (const box of document.querySelectorAll('.animation')) {
  const data = JSON.parse(box.querySelector('script').textContent);
  const image = box.querySelector('img'), slider = box.querySelector('input');
  const button = box.querySelector('button'), time = box.querySelector('output');
  const show = () => {
    image.src = 'data:image/png;base64,' + data.frames[slider.value];
    time.textContent = 't = ' + data.times[slider.value] + ' s';
  };
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; button.textContent = 'Play'; };
  button.onclick = () => {
    if (timer !== null) { stop(); return; }
    button.textContent = 'Pause';
    timer = setInterval(() => {
      slider.value = (Number(slider.value) + 1) % data.frames.length; show();
    }, 1000 / RATE);
  };
  slider.oninput = () => { stop(); show(); };
  show();
}
const large = document.querySelector('dialog');
for (const button of document.querySelectorAll('button.zoom')) {
  button.onclick = () => {
    const image = button.querySelector('img'), copy = large.querySelector('img');
    copy.src = image.src; copy.alt = image.alt;
    large.showModal();
  };
}
large.onclick = () => large.close();
"""


def escape(text: str, keep: str = "") -> str:
    """Return a text as HTML that shows it as it is."""
    return html_escape(visible(text, keep))


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str

    def html(self) -> str:
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    text: str

    def html(self) -> str:
        return f"<h3>{escape(self.text)}</h3>"


@dataclass(frozen=True)
class Listing:
    """A text to be unfolded, such as a case file."""

    title: str
    text: str

    def html(self) -> str:
        text = escape(self.text, keep="\n")
        return f"<details><summary>{escape(self.title)}</summary><pre>{text}</pre></details>"


@dataclass(frozen=True)
class Picture:
    """A PNG file with its caption, and what it shows in words; it opens large."""

    png: bytes
    caption: str
    described: str = ""
    """What it shows, where the caption doesn't say all."""

    def html(self) -> str:
        image = _image(self.png, self.described or self.caption)
        return (
            f'<figure><button type="button" class="zoom" title="show large">{image}</button>'
            f"<figcaption>{escape(self.caption)}</figcaption></figure>"
        )


@dataclass(frozen=True)
class Headline:
    """Figures that stand out, each with what it is, and sentences about them."""

    figures: Sequence[tuple[str, str]]
    """What it is, and the figure."""
    sentences: Sequence[str]

    def html(self) -> str:
        boxes = "".join(
            f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
            for name, value in self.figures
        )
        text = "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        return f'<dl class="headline">{boxes}</dl>{text}'


@dataclass(frozen=True)
class Table:
    """Cells as they are to be shown; a column without figures is set to the left."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]

    def html(self) -> str:
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.headings)
        kinds = ["" if _has_figures(column) else ' class="text"' for column in columns]
        head = _row("th", self.headings, kinds)
        body = "".join(_row("td", row, kinds) for row in self.rows)
        return (
            f'<figure><figcaption>{escape(self.caption)}</figcaption><div class="wide">'
            f"<table><thead>{head}</thead><tbody>{body}</tbody></table></div></figure>"
        )


@dataclass(frozen=True)
class Legend:
    """The colours of one scale of an animation."""

    label: str
    low: str
    high: str
    colours: Sequence[str]

    def html(self) -> str:
        stops = ", ".join(self.colours)
        return (
            f'<span class="scale">{escape(self.label)}: {escape(self.low)}'
            f'<i style="background: linear-gradient(to right, {escape(stops)})"></i>'
            f"{escape(self.high)}</span>"
        )


@dataclass(frozen=True)
class Animation:
    """PNG files that are shown one after the other, under the heads of their columns.

    A slider and a button move it; without scripts the middle frame is shown.
    """

    frames: Sequence[bytes]
    times: Sequence[str]
    heads: Sequence[str]
    legends: Sequence[Legend]
    caption: str
    extent: tuple[str, str, str, str] = ("", "", "", "")
    """The ends of both axes of each panel: left, right, lower, upper [m]."""
    n_rows: int = 2
    described: str = ""
    """What it shows, where the caption doesn't say all."""

    def html(self) -> str:
        frames = [base64.b64encode(frame).decode("ascii") for frame in self.frames]
        middle = len(frames) // 2
        data = json.dumps({"frames": frames, "times": list(self.times)}).replace("<", "\\u003c")
        heads = "".join(f"<span>{escape(head)}</span>" for head in self.heads)
        left, right, lower, upper = self.extent
        return (
            f'<figure class="animation"><div class="panels"><div class="heads">{heads}</div>'
            f"{_axis('y', upper, lower, self.n_rows)}"
            f"{_image(self.frames[middle], self.described or self.caption)}"
            f"{_axis('x', left, right, len(self.heads))}</div>"
            '<div class="controls"><button type="button">Play</button>'
            f'<input type="range" aria-label="time" min="0" max="{len(frames) - 1}" '
            f'value="{middle}"><output></output></div>'
            f"<div>{''.join(legend.html() for legend in self.legends)}</div>"
            f"<figcaption>{escape(self.caption)}</figcaption>"
            f'<script type="application/json">{data}</script></figure>'
        )


Part = Text | Heading | Headline | Listing | Picture | Table | Animation


@dataclass(frozen=True)
class Section:
    """A part of the page with a title."""

    title: str
    parts: Sequence[Part]


def render(
    title: str, lead: str, sections: Sequence[Section], footer: str, first: Sequence[Part] = ()
) -> str:
    """Return the page, what comes `first` above all links; sections without parts are left out."""
    shown = [section for section in sections if section.parts]
    links = "".join(
        f'<a href="#s{number}">{escape(section.title)}</a>' for number, section in enumerate(shown)
    )
    body = "\n".join(
        f'<section id="s{number}"><h2>{escape(section.title)}</h2>'
        + "\n".join(part.html() for part in section.parts)
        + "</section>"
        for number, section in enumerate(shown)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{CONTENT}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f'<body><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>'
        f"{''.join(part.html() for part in first)}<nav>{links}</nav>\n"
        f"{body}\n"
        '<dialog aria-label="figure"><form method="dialog"><button>Close</button></form>'
        '<div><img alt=""></div></dialog>\n'
        f"<footer>{escape(footer)}</footer>\n"
        f"<script>{PLAYER.replace('RATE', str(FRAMES_PER_SECOND))}</script></body></html>\n"
    )


def _axis(name: str, first: str, last: str, number: int) -> str:
    """Return the ends of an axis, and its name between them, for so many panels."""
    ends = f"<i>{escape(first)}</i><i>{name} [m]</i><i>{escape(last)}</i>"
    return f'<div class="axis {name}" aria-hidden="true">{f"<span>{ends}</span>" * number}</div>'


def _image(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return f'<img alt="{escape(caption)}" src="data:image/png;base64,{data}">'


def _row(tag: str, cells: Sequence[str], kinds: Sequence[str]) -> str:
    each = zip(cells, kinds, strict=True)
    return f"<tr>{''.join(f'<{tag}{kind}>{escape(cell)}</{tag}>' for cell, kind in each)}</tr>"


def _has_figures(column: Sequence[str]) -> bool:
    """Whether the first cell that holds anything begins like a number."""
    first = next((cell for cell in column if cell.strip("– ")), "")
    return first[:1].isdigit() or first[:2] in {f"-{digit}" for digit in range(10)}
