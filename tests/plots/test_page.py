"""A page holds what it shows, escaped, and asks for nothing over a network."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np

from sphrom.report.page import animation, element, headline, legend, listing, picture, render, table
from sphrom.report.report import as_png, paint

HOSTILE = '<script>alert("1")</script> & "quoted"'
PNG = as_png([[np.zeros((2, 2, 3), dtype=np.uint8)]])
LEGEND = legend(HOSTILE, "0", "1", ("#000000", "#ffffff"))
PARTS = (
    element("p", HOSTILE),
    element("h3", HOSTILE),
    listing(HOSTILE, HOSTILE),
    picture(PNG, HOSTILE),
    table(HOSTILE, (HOSTILE, "b"), ((HOSTILE, "1.5"), ("x", "–"))),
    headline(((HOSTILE, HOSTILE),), (HOSTILE,)),
    animation((PNG, PNG, PNG), ("0", "1", HOSTILE), (HOSTILE,), (LEGEND,), HOSTILE, (HOSTILE,) * 4),
)


def test_control_characters_are_shown() -> None:
    """A mark of the direction of writing would turn what stands beside it."""
    turned = "a\x1b[2J\x9b\u202eb"
    parts = (
        element("p", turned),
        listing(turned, f"{turned}\n{turned}"),
        table(turned, ("b",), ((turned,),)),
    )
    page = render(turned, turned, [(turned, parts)], turned)
    assert page.replace("\n", "").isprintable()
    assert page.count(r"a\x1b[2J\x9b\u202eb") == 12


class Tags(HTMLParser):
    """Collects tags, attributes and text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.texts.append(data)


def page(*parts) -> str:
    """Return a page with one section."""
    return render("title", "lead", [("one", parts), ("empty", ())], "end")


def test_text_never_becomes_markup() -> None:
    found = Tags(page(*PARTS))
    assert found.open == []
    assert found.tags.count("script") == 2  # the animation's data, and the player
    assert HOSTILE in "".join(found.texts)
    assert ("alt", HOSTILE) in found.attributes


def test_nothing_leads_out_of_the_page() -> None:
    text = page(*PARTS)
    assert "http" not in text.replace("http-equiv", "")
    sources = [value for name, value in Tags(text).attributes if name in ("src", "href")]
    assert sources
    assert all(re.match(r"data:image/png;base64,|#s\d", value or "") for value in sources)
    assert "default-src 'none'" in text


def test_fields_are_painted_from_above_with_solid_grey() -> None:
    field = np.array([[0.0, 0.5], [1.0, np.nan]])
    pixels = paint(field, "gray", (0.0, 1.0))
    top_left, top_right, bottom_left = pixels[0, 0], pixels[0, -1], pixels[-1, 0]
    np.testing.assert_array_equal(top_left, [255, 255, 255])
    np.testing.assert_array_equal(top_right, [0xC9, 0xC9, 0xC9])
    np.testing.assert_array_equal(bottom_left, [0, 0, 0])
    assert pixels.dtype == np.uint8
