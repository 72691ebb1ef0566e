"""What this machine has."""

from __future__ import annotations

import os


def physical_memory() -> int:
    """Return the memory of this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
