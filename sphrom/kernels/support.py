"""How far the kernel reaches, for those who need to know it without compiling anything."""

from __future__ import annotations

SUPPORT_RATIO = 2.0
"""Support radius over smoothing length (kappa)."""
