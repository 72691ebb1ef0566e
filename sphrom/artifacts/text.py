"""Texts of fixed length.

HDF5 keeps texts of variable length in a heap without checksums, and one flipped bit there was seen
to send it into an endless loop. Of fixed length they lie where a checksum covers them.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray


def fixed_text(text: str) -> NDArray[Any]:
    """Return `text` as a scalar that HDF5 stores with its length."""
    encoded = text.encode()
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def plain_text(value: bytes) -> str:
    """Return a stored text; bytes that are none survive as escapes."""
    return bytes(value).decode("utf-8", "surrogateescape")
