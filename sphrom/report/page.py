"""The elements of an HTML page, from texts, figures and images, without a case.

A page makes no network requests, and its policy forbids them; `page.html` has the frame, style and
scripts. All text is escaped, and control characters, which could reverse the direction of the text
around them, are shown.
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
    """Return a PNG image with its caption and a description.

    A click enlarges it. On a narrow screen it scrolls, because its labels would be too small.
    """
    button = {"type": "button", "class_": "zoom", "title": "show large"}
    image = element("button", _image(png, described or caption), **button)
    scrolling = element("div", image, class_="wide")
    return element("figure", scrolling, element("figcaption", caption))


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
        styled = zip(cells, kinds, strict=True)
        return element("tr", *(element(tag, cell, **kind) for cell, kind in styled))

    head = element("thead", line("th", headings))
    content = element("table", head, element("tbody", *(line("td", row) for row in rows)))
    return element("figure", element("figcaption", caption), element("div", content, class_="wide"))


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
    labels: Sequence[str] = ("x [m]", "y [m]"),
    first: int = 0,
) -> Html:
    """Return an animation of PNG images, with a head above each column of panels.

    A slider and a button control it; `first` is the frame that is shown at first. `extent` has the
    ends of the axes of each panel: left, right, lower, upper [m]; `labels` are those of the axes.
    """
    left, right, lower, upper = extent
    encoded = [base64.b64encode(frame).decode("ascii") for frame in frames]
    data = json.dumps({"frames": encoded, "times": list(times)}).replace("<", "\\u003c")
    slider = {"type": "range", "aria_label": "time", "min": "0", "max": f"{len(frames) - 1}"}
    return element(
        "figure",
        element(
            "div",
            element("div", *(element("span", head) for head in heads), class_="heads"),
            _axis("y", (upper, labels[1], lower), 2),
            _image(frames[first], caption),
            _axis("x", (left, labels[0], right), len(heads)),
            class_="panels",
        ),
        element(
            "div",
            element("button", "Play", type="button"),
            element("input", **slider, value=f"{first}"),
            element("output"),
            class_="controls",
        ),
        element("div", Html("".join(legends))),
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


def _axis(name: str, texts: Sequence[str], number: int) -> Html:
    """Return the ends of an axis, with its label between them, for a number of panels."""
    ends = element("span", *(element("i", text) for text in texts))
    return element("div", *[ends] * number, class_=f"axis {name}", aria_hidden="true")


def _image(png: bytes, caption: str) -> Html:
    data = base64.b64encode(png).decode("ascii")
    return element("img", alt=caption, src=f"data:image/png;base64,{data}")
