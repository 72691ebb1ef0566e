"""A trained model as one HTML page that runs it in the browser, without a network.

`page.html` has the frame and the style, `model.js` the numbers and `page.js` the controls. The page
contains the document of the model with the fields of its modes on a grid, as whole numbers with a
scale for each field of each mode. Names are escaped here, or shown as texts by the scripts.
"""

from __future__ import annotations

import json
import math
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from sphrom.errors import CaseError
from sphrom.metrics.grids import Slices
from sphrom.models.contract import Model
from sphrom.plots.panels import SIGNED_MAP, SPEED_MAP, line_of
from sphrom.portable import document
from sphrom.text import visible
from sphrom.version import __version__

MOST_COLUMNS = 160
"""Largest number of columns of a picture's grid if the user gives no number."""
MOST_BYTES, FOR_FIELDS = 1_400_000, 400_000
"""Largest number of bytes of the page in that case, and of the fields of modes on any page."""
WRITTEN = 8.0 / 3.0
"""Bytes of a number of 16 bits in base64."""
LEAST_COLUMNS, GREATEST_COLUMNS = 8, 500
"""Least number of columns that shows a flow, and greatest number that browsers still load."""
LARGEST = 32767
"""The largest number of 16 bits."""
ROUNDING = 1e-10
"""Pressures below this share of the largest one are rounding errors."""


def content(model: Model[Any], n_columns: int | None = None) -> bytes:
    """Return the page of a model.

    Parameters
    ----------
    n_columns : number of columns of the picture's grid; by default as many as `MOST_BYTES` allow.

    Raises CaseError if a page can't represent the model.
    """
    found = document.document(model)
    if n_columns is None:
        box = model.workspace.case.scene.domain
        first, last, low, high = Slices(box.lower, box.upper).extent
        width, height = last - first, high - low
        left = max(FOR_FIELDS, MOST_BYTES - len(json.dumps(document.encoded(found))))
        n_cells = left / (WRITTEN * ((box.n_dim + 1) * found["n_modes"] + found["n_own"] + 1))
        n_columns = min(MOST_COLUMNS, max(LEAST_COLUMNS, int(math.sqrt(n_cells * width / height))))
    fields = document.fields(model, n_columns)
    found = document.with_digest({**found, "fields": fields | _rounded(fields["modes"])})
    case = model.workspace.case
    name = found["name"]
    template = Template(_text("page.html"))
    page = template.substitute(
        title=escape(visible(f"{found['case']}: {name}")),
        lead=escape(visible(f"{case.scene.title}. The sliders run the model within this page.")),
        colour=line_of(case.rom.index(model.section))["color"],
        colours=json.dumps({"plain": gradient(SPEED_MAP), "signed": gradient(SIGNED_MAP)}),
        document=json.dumps(document.encoded(found)).replace("<", "\\u003c"),
        code=_text("model.js") + _text("page.js"),
        footer=escape(f"sphrom {__version__}, sphrom export --to page"),
    )
    return page.encode()


def require_columns(n_columns: int) -> None:
    """Raise CaseError unless a page can have a grid with so many columns."""
    if not LEAST_COLUMNS <= n_columns <= GREATEST_COLUMNS:
        raise CaseError(
            f"--columns: must be from {LEAST_COLUMNS} to {GREATEST_COLUMNS}; got {n_columns}"
        )


def gradient(colours: str, n_colours: int = 9) -> list[str]:
    """Return colours of a colour map of matplotlib, from low to high values, for CSS."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(c) for c in colormaps[colours](np.linspace(0.0, 1.0, n_colours))]


def _rounded(modes: Any) -> dict[str, Any]:
    """Return modes (n_dim + 1, n_columns, ny, nx) as rows of whole numbers with a scale each.

    A row of velocity has a component and a column; columns without velocity are left out. The
    pressure of a state is a small difference of large contributions, so rounding of these would
    cause large errors. Its rows are therefore orthogonal, and `mix` has their factors in each
    column.
    """
    n_dim = len(modes) - 1
    moving = np.flatnonzero(modes[:n_dim].any(axis=(0, 2, 3)))
    component = np.repeat(np.arange(n_dim), len(moving))
    column = np.tile(moving, n_dim)
    flat = modes.reshape(*modes.shape[:2], -1).astype(np.float64)
    left, sizes, orthogonal = np.linalg.svd(flat[n_dim], full_matrices=False)
    kept = sizes > ROUNDING * sizes[0]
    rows = np.vstack((flat[component, column], orthogonal[kept]))
    largest = np.abs(rows).max(axis=1)
    scale = np.where(largest > 0.0, largest, 1.0) / LARGEST
    whole = np.round(rows / scale[:, None]).astype(np.int16)
    n_pressure = int(kept.sum())
    return {
        "modes": whole.reshape(-1, *modes.shape[2:]),
        "scale": scale,
        "field": [*component.tolist(), *[n_dim] * n_pressure],
        "column": [*column.tolist(), *range(1, 1 + n_pressure)],
        "mix": (left * sizes)[:, kept],
    }


def _text(name: str) -> str:
    return (files("sphrom.portable") / name).read_text(encoding="utf-8")
