"""`sphrom` and `python -m sphrom`."""

from __future__ import annotations

import os
import sys

# Only the kernels use threads. A BLAS that spreads small systems over its own threads is many times
# slower on busy cores, and its results depend on their number.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# No pydantic plugins are used, and searching for them takes a tenth of a short command's time.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")


def main() -> None:
    """Run the command line."""
    try:
        from sphrom.cli.app import app

        app(prog_name="sphrom")
    except KeyboardInterrupt:  # before a command has started
        sys.exit(130)


if __name__ == "__main__":
    main()
