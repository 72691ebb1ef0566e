"""One HTML page with all of its text, tables, figures and animations, and no links out.

The page asks for nothing over a network, and forbids it: `page.html` has its frame, style and
scripts. All text is escaped, and control characters, which could turn the direction of their
surroundings, are shown.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from html import escape as html_escape
from importlib.resources import files
from string import Template

from sphrom.text import visible


class Html(str):
    """A part of a page that is markup already; other texts are escaped."""


def element(tag: str, *content: str, **attributes: str) -> Html:
    """Return an element; content and the values of attributes are escaped unless they are Html.

    An attribute called like a word of Python ends in an underscore, and others stand for a dash.
    """
    named = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for name, value in attributes.items()
    )
    end = "" if tag in ("img", "input") else f"</{tag}>"
    return Html(f"<{tag}{named}>{''.join(map(escape, content))}{end}")


def escape(text: str, keep: str = "") -> Html:
    """Return a text as HTML that shows it as it is."""
    return text if isinstance(text, Html) else Html(html_escape(visible(text, keep)))


def listing(title: str, text: str) -> Html:
    """Return a text to be unfolded, such as a case file."""
    return element("details", element("summary", title), element("pre", escape(text, keep="\n")))


def picture(png: bytes, caption: str, described: str = "") -> Html:
    """Return a PNG file with its caption, and what it shows in words; it opens large."""
    button = {"type": "button", "class_": "zoom", "title": "show large"}
    image = element("button", _image(png, described or caption), **button)
    return element("figure", image, element("figcaption", caption))


def headline(figures: Sequence[tuple[str, str]], sentences: Sequence[str]) -> Html:
    """Return figures that stand out, each after its name, and sentences about them."""
    boxes = [element("div", element("dt", name), element("dd", value)) for name, value in figures]
    text = (element("p", sentence) for sentence in sentences)
    return Html(element("dl", *boxes, class_="headline") + "".join(text))


def table(caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    """Return a table of cells as they are to be shown; columns of text stand to the left."""
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
    """Return the colours of one scale of an animation."""
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
    """Return PNG files that are shown one after the other, under the heads of their columns.

    A slider and a button move it; without scripts the middle frame is shown. `extent` has the ends
    of both axes of each panel: left, right, lower, upper [m].
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
    """Return the page of sections, titles and parts; those without parts are left out.

    Parts that come `first` stand above all links.
    """
    shown = [(f"s{k}", *section) for k, section in enumerate(s for s in sections if s[1])]
    template = Template((files("sphrom.plots") / "page.html").read_text(encoding="utf-8"))
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
    """Return the ends of an axis, and its name between them, for so many panels."""
    ends = element("span", *(element("i", text) for text in (first, f"{name} [m]", last)))
    return element("div", *[ends] * number, class_=f"axis {name}", aria_hidden="true")


def _image(png: bytes, caption: str) -> Html:
    data = base64.b64encode(png).decode("ascii")
    return element("img", alt=caption, src=f"data:image/png;base64,{data}")
