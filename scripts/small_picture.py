"""Pictures of the documentation: small copies of what commands draw."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

COLOURS = 256
"""Colours of a copy: a quarter of the size of all."""
ROUNDS = 3
"""Of moving those colours to where the picture needs them: fields have many that are alike."""
WIDTH = 1480
"""Of a copy, in pixels: twice what a page shows."""
QUALITY = 80
"""Of a copy as WebP: a quarter of the size of a PNG, and no difference that an eye finds."""


def write_small(source: Path, target: Path, width: int = WIDTH) -> None:
    """Write a copy of a picture, PNG or WebP, that is at most `width` pixels wide."""
    with Image.open(source) as picture:
        small = picture.convert("RGB")
    if small.width > width:
        height = round(small.height * width / small.width)
        small = small.resize((width, height), Image.Resampling.LANCZOS)
    content = io.BytesIO()
    if target.suffix == ".webp":
        small.save(content, "WEBP", quality=QUALITY, method=6)
    else:
        _few_colours(small).save(content, "PNG", optimize=True)
    target.write_bytes(content.getvalue())


def _few_colours(picture: Image.Image) -> Image.Image:
    return picture.quantize(
        COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=ROUNDS, dither=Image.Dither.NONE
    )
