"""Draw the logo: particles that mix on the left lie on a lattice of fixed points on the right.

python scripts/logo.py    writes docs/static/logo.svg
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

TARGET = Path(__file__).parents[1] / "docs" / "static" / "logo.svg"
ACROSS = 5
SIZE, RADIUS = 96, 6.5
SEED = 3134  # of directions in which no two particles overlap
SHIFT = 6.5
"""Shift of the leftmost particles from the lattice; the rightmost ones are on it."""


def main() -> None:
    """Shift the points of a lattice, each in another direction, less and less to the right."""
    lattice = np.linspace(RADIUS + 5.5, SIZE - RADIUS - 5.5, ACROSS)
    x, y = (each.ravel() for each in np.meshgrid(lattice, lattice))
    shift = SHIFT * (1.0 - np.arange(ACROSS**2) % ACROSS / (ACROSS - 1))
    angle = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, ACROSS**2)
    colours = colormaps["viridis"](0.1 + 0.75 * x / SIZE)
    circles = [
        f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="{RADIUS}" fill="{to_hex(colour)}"/>'
        for cx, cy, colour in zip(
            x + shift * np.cos(angle), y + shift * np.sin(angle), colours, strict=True
        )
    ]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}">'
    text = "\n".join((head, "<title>sphrom</title>", *circles, "</svg>\n"))
    TARGET.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
